"""A tag that stands in the picture while its robot drives is told of; one that moves, or a robot that stands, not."""

from __future__ import annotations

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.tick.standing_tag import StandingTag

from .service_parts import sighting


def noted(steps: list[tuple[float, Pose2, int]], *, noise_px: float = 0.3) -> list[bool]:
    """Show a tag at columns, with odometry and the number of the drive; return what is told of each."""
    watch, rng = StandingTag(), np.random.default_rng(0)
    told = []
    for k, (column, pose, drive) in enumerate(steps):
        seen = sighting("rover", (column, 100.0), k)
        seen.corners[:] += rng.normal(0.0, noise_px, (4, 2))
        told.append(watch.note(seen, pose, drive))
    return told


@pytest.mark.parametrize("step", [Pose2(0.05, 0.0, 0.0), Pose2(-0.05, 0.0, 0.0), Pose2(0.0, 0.0, 0.1)])
def test_a_tag_that_stands_while_its_robot_drives_is_told_of_and_watched_anew(step: Pose2) -> None:
    pose, steps = Pose2(3.0, 1.0, 0.5), []
    for _ in range(30):
        steps.append((100.0, pose, 0))
        pose = pose @ step
    told = noted(steps)
    assert 6 <= told.index(True) <= 9
    assert sum(told) == 3


def test_a_tag_that_moves_and_a_robot_that_stands_are_honest() -> None:
    assert not any(noted([(100.0 + 2.0 * k, Pose2(0.05 * k, 0.0, 0.0), 0) for k in range(60)]))
    assert not any(noted([(100.0, Pose2(0.01 * (k % 2), 0.0, 0.0), 0) for k in range(200)]))


def test_odometry_that_jumps_proves_nothing() -> None:
    assert not any(noted([(100.0, Pose2(float(k), 0.0, 0.0), k) for k in range(20)]))
