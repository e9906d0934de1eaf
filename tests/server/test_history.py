from __future__ import annotations

import numpy as np
import pytest

from revnm_server.observation import Image32
from revnm_server.tick.history import ImageHistory

MS = 1_000_000


def _image(value: float) -> Image32:
    return np.full((2, 3), value, np.float32)


def _history(count: int, interval_s: float, stamps_ms: list[int]) -> list[float]:
    """Push one image per stamp, showing its stamp; return what the stack shows."""
    history = ImageHistory(count=count, interval_s=interval_s)
    for stamp in stamps_ms:
        history.push(_image(stamp), stamp * MS)
    stack = history.stack()
    assert stack.shape == (count, 2, 3)
    assert stack.dtype == np.float32
    return [float(image[0, 0]) for image in stack]


@pytest.mark.parametrize(
    ("count", "interval_s", "stamps_ms", "expected"),
    [
        (1, 0.2, [0, 100, 200], [200]),
        (5, 0.2, [7], [7, 7, 7, 7, 7]),  # young: the oldest is repeated
        (3, 0.2, [0, 100, 200], [0, 0, 200]),
        (3, 0.2, list(range(0, 1001, 100)), [600, 800, 1000]),
        (3, 0.2, list(range(0, 1001, 67)), [536, 737, 938]),  # 538 and 738 are wanted
        (3, 0.2, [0, 250, 500, 750], [250, 500, 750]),  # slower than the interval: the nearest older
        (3, 0.2, [0, 200, 400, 1500], [1500, 1500, 1500]),  # a gap starts anew
        (3, 0.2, [1000, 1200, 1400, 100, 300], [100, 100, 300]),  # time that goes back starts anew
        (2, 2.0, [0, 1900, 3800], [0, 3800]),  # a gap shorter than two intervals is none
    ],
)
def test_stack(count: int, interval_s: float, stamps_ms: list[int], expected: list[float]) -> None:
    assert _history(count, interval_s, stamps_ms) == expected


def test_an_image_with_the_stamp_of_the_last_replaces_it() -> None:
    history = ImageHistory(count=2, interval_s=0.1)
    history.push(_image(1), 0)
    history.push(_image(2), 0)
    assert history.stack()[:, 0, 0].tolist() == [2, 2]


def test_agrees_with_a_search_over_all_that_was_pushed() -> None:
    rng = np.random.default_rng(0)
    history = ImageHistory(count=5, interval_s=0.2)
    pushed: list[int] = []
    stamp = 0
    for _ in range(300):
        stamp += int(rng.integers(20, 400)) * MS
        pushed.append(stamp)
        history.push(_image(stamp / MS), stamp)
        wanted = [stamp - back * 200 * MS for back in (4, 3, 2, 1, 0)]
        expected = [max((p for p in pushed if p <= w), default=pushed[0]) / MS for w in wanted]
        assert history.stack()[:, 0, 0].tolist() == expected
