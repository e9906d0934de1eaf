"""Features of images: each image is encoded once, whatever histories it stands in, and forgotten when it is old."""

from __future__ import annotations

import numpy as np
import pytest

from revnm_server.frame import RobotSighting
from revnm_server.observation import Image32, ImagePose, ObservationSpec
from revnm_server.ports import PlanRequest
from revnm_server.stages.feature_memory import FeatureMemory

SECOND_NS = 1_000_000_000
SPEC = ObservationSpec(
    history=3,
    history_interval_s=0.5,
    disparity_hw=(24, 32),
    exo_hw=(8, 8),
    crop_px=8,
    crop_span=0.4,
    crop_heading_up=False,
    ego_px=4,
    ego_hfov_rad=2.0,
    ego_height_m=0.3,
    ego_range_m=6.0,
    waypoints=5,
    spacing_m=0.4,
)


class Encoder:
    """Features of an image are the means of its rows, one token; counts what it encodes."""

    def __init__(self) -> None:
        self.batches: list[int] = []

    def run(self, *, images: Image32) -> dict[str, Image32]:
        self.batches.append(len(images))
        return {"features": images.mean(axis=3)}  # (K, 1, 8)


def images(*values: float, side: int) -> Image32:
    return np.stack([np.full((side, side), value, dtype=np.float32) for value in values])


def request(robot: str, stamp_s: float, exo: Image32, ego: Image32) -> PlanRequest:
    sighting = RobotSighting(robot, 0, np.zeros(2), np.array([1.0, 0.0]), np.zeros((4, 2)))
    pose = ImagePose(np.zeros(2), np.array([1.0, 0.0]))
    return PlanRequest(robot, round(stamp_s * SECOND_NS), sighting, pose, np.zeros(2), "g", exo, ego)


@pytest.fixture
def encoder() -> Encoder:
    return Encoder()


@pytest.fixture
def memory(encoder: Encoder) -> FeatureMemory:
    return FeatureMemory(encoder, SPEC)  # type: ignore[arg-type]


def test_an_image_is_encoded_once_and_all_new_ones_in_one_batch(memory: FeatureMemory, encoder: Encoder) -> None:
    exo = images(1, 2, 3, side=8)
    a, b = images(10, 11, 12, side=4), images(20, 20, 20, side=4)  # b is new: its history repeats one image
    seen_exo, seen_ego = memory.recall([request("a", 0.0, exo, a), request("b", 0.0, exo, b)])
    assert encoder.batches == [3 + 3 + 1]
    assert seen_exo.shape == seen_ego.shape == (2, 3, 1, 8)
    assert seen_exo[:, :, 0, 0].tolist() == [[1, 2, 3], [1, 2, 3]]
    assert seen_ego[:, :, 0, 0].tolist() == [[10, 11, 12], [20, 20, 20]]

    later, a = images(2, 3, 4, side=8), images(11, 12, 13, side=4)
    seen_exo, seen_ego = memory.recall([request("a", 0.5, later, a)])
    assert encoder.batches[1:] == [1 + 1]
    assert seen_exo[0, :, 0, 0].tolist() == [2, 3, 4]
    assert seen_ego[0, :, 0, 0].tolist() == [11, 12, 13]
    memory.recall([request("a", 0.5, later, a)])
    assert len(encoder.batches) == 2  # nothing was new


def test_a_film_that_begins_anew_with_other_images_at_the_same_times(memory: FeatureMemory) -> None:
    for exo in (images(1, 1, 1, side=8), images(5, 5, 5, side=8)):
        seen, _ = memory.recall([request("a", 0.0, exo, images(0, 0, 0, side=4))])
        assert seen[0, :, 0, 0].tolist() == exo[:, 0, 0].tolist()


def test_what_is_too_old_for_any_history_is_forgotten(memory: FeatureMemory, encoder: Encoder) -> None:
    ego = images(0, 0, 0, side=4)
    memory.recall([request("a", 0.0, images(1, 1, 1, side=8), ego)])
    memory.recall([request("a", 1.5, images(1, 1, 2, side=8), ego)])  # 3 · 0.5 s: just still needed
    assert encoder.batches == [2, 1]
    memory.recall([request("a", 1.6, images(1, 2, 3, side=8), ego)])
    assert encoder.batches[2:] == [2 + 1]  # 1 and the ego depth of second 0 again, and 3


def test_ego_depth_is_enlarged_as_torch_does_it(memory: FeatureMemory) -> None:
    ego = np.random.default_rng(0).random((3, 4, 4), dtype=np.float32)
    _, seen = memory.recall([request("a", 0.0, images(1, 1, 1, side=8), ego)])
    # From 4 to 8 with pixel centres at halves: the first is the first, the second 3/4 of it and 1/4 of the next.
    second = 0.75 * ego[0, 0] + 0.25 * ego[0, 1]
    np.testing.assert_allclose(seen[0, 0, 0, 0], _widened(ego[0, 0]).mean(), rtol=1e-6)
    np.testing.assert_allclose(seen[0, 0, 0, 1], _widened(second).mean(), rtol=1e-6)


def _widened(row: Image32) -> Image32:
    """Four values made eight: weights 3/4 and 1/4 of the two nearest."""
    padded = np.concatenate([row[:1], row, row[-1:]])
    left = 0.25 * padded[:-2] + 0.75 * padded[1:-1]
    right = 0.75 * padded[1:-1] + 0.25 * padded[2:]
    return np.stack([left, right], axis=1).ravel()
