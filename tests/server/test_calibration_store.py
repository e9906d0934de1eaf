"""A calibration on disk: the same after a restart, refused when it is damaged or another camera's."""

import json

import numpy as np
import pytest

from revnm_client.errors import FileError
from revnm_server.calibration.prior import wide_prior
from revnm_server.calibration.store import load_belief, save_belief


def test_it_comes_back_as_it_was(tmp_path):
    path = tmp_path / "cameras" / "hall.json"
    save_belief(path, "hall", (640, 480), wide_prior())
    belief = load_belief(path, "hall", (640, 480))
    assert belief is not None
    np.testing.assert_array_equal(belief.mean, wide_prior().mean)
    np.testing.assert_array_equal(belief.covariance, wide_prior().covariance)
    assert [entry.name for entry in path.parent.iterdir()] == ["hall.json"]


def test_nothing_was_kept_yet(tmp_path):
    assert load_belief(tmp_path / "hall.json", "hall", (640, 480)) is None


def altered(content, **changes):
    return json.dumps({**content, **changes})


@pytest.mark.parametrize(
    ("alter", "reason"),
    [
        (lambda c: "{", "Expecting property name"),
        (lambda c: "[]", "expected 'revnm camera calibration 1'"),
        (lambda c: altered(c, format="2"), "expected 'revnm camera calibration 1'"),
        (lambda c: altered(c, extra=1), "with the keys"),
        (lambda c: altered(c, camera="door"), "is of camera 'door', expected 'hall'"),
        (lambda c: altered(c, width_px=1280), "1280 × 480, expected 640 × 480"),
        (lambda c: altered(c, mean=[0.0]), "mean: expected finite numbers of shape"),
        (lambda c: altered(c, mean=["a"] * 5), "mean: could not convert"),
        (lambda c: altered(c, mean=[float("nan")] * 5), "mean: expected finite"),
        (lambda c: altered(c, mean=[9.0] * 5), "mean: expected values between"),
        (lambda c: altered(c, covariance=(-np.eye(5)).tolist()), "positive definite"),
        (lambda c: altered(c, covariance=np.triu(np.ones((5, 5))).tolist()), "symmetric"),
    ],
)
def test_a_wrong_file_is_refused_with_its_name_and_the_reason(tmp_path, alter, reason):
    path = tmp_path / "hall.json"
    save_belief(path, "hall", (640, 480), wide_prior())
    path.write_text(alter(json.loads(path.read_text())))
    with pytest.raises(FileError, match=reason) as caught:
        load_belief(path, "hall", (640, 480))
    assert str(path) in str(caught.value)


def test_a_folder_that_cannot_be_written_says_so(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="calibration"):
        save_belief(tmp_path / "file" / "hall.json", "hall", (640, 480), wide_prior())
