"""Where robots were before a restart: when that is written, read, believed and forgotten."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry
from revnm_server.calibration.places import Anchor, Place, PlaceKeeper

from .waiting import eventually

SECOND_NS = 1_000_000_000
FLOOR, ODOM = Pose2(3.0, 1.0, 0.5), Pose2(0.6, -0.4, 0.7)
HERE = Place(100 * SECOND_NS, FLOOR, ODOM)


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def at(self, x_m: float) -> Place:
        return Place(int(self.now_s * SECOND_NS), Pose2(x_m, 0.0, 0.0), Pose2(x_m, 0.0, 0.0))


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def keeper(tmp_path: Path, clock: Clock) -> PlaceKeeper:
    return PlaceKeeper(tmp_path, "hall", now_s=clock)


def kept(folder: Path) -> dict[str, Place]:
    return PlaceKeeper(folder, "hall").load()


def odometry(pose: Pose2, *, after_s: float = 5.0) -> Odometry:
    return Odometry(HERE.stamp_ns + round(after_s * SECOND_NS), pose, STANDSTILL)


def test_it_is_written_when_it_says_something_else_and_not_too_often(
    keeper: PlaceKeeper, tmp_path: Path, clock: Clock
) -> None:
    assert keeper.offer({"rover": clock.at(0.0)})
    eventually(lambda: kept(tmp_path) == {"rover": clock.at(0.0)})
    clock.now_s += 0.4
    assert not keeper.offer({"rover": clock.at(0.3)})
    clock.now_s += 0.2
    eventually(lambda: keeper.offer({"rover": clock.at(0.3)}))  # once the writer has ended
    eventually(lambda: kept(tmp_path)["rover"] == clock.at(0.3))
    clock.now_s += 30.0
    eventually(lambda: not keeper.offer({"rover": clock.at(0.32)}))  # that is the same place
    clock.now_s += 40.0
    assert keeper.offer({"rover": clock.at(0.32)})  # it is still there


def test_what_nobody_knows_any_more_is_forgotten_and_who_is_silent_is_not(tmp_path: Path, clock: Clock) -> None:
    first = PlaceKeeper(tmp_path, "hall", now_s=clock)
    first.offer({"rover": clock.at(0.0), "crawler": clock.at(1.0)})
    first.close()
    second = PlaceKeeper(tmp_path, "hall", now_s=clock)
    second.load()
    second.offer({"rover": None})
    second.close()
    assert kept(tmp_path) == {"crawler": clock.at(1.0)}


def test_the_last_place_is_written_at_the_end(keeper: PlaceKeeper, tmp_path: Path, clock: Clock) -> None:
    keeper.offer({"rover": clock.at(0.0)})
    keeper.offer({"rover": clock.at(0.9)})
    keeper.close()
    assert kept(tmp_path) == {"rover": clock.at(0.9)}


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "{",
        lambda text: "[]",
        lambda text: "[" * 100_000,
        lambda text: text.replace("hall", "yard"),
        lambda text: text.replace("places 1", "places 2"),
        lambda text: text.replace("[100000000000, ", "["),
        lambda text: text.replace("100000000000", "1e999"),
        lambda text: text.replace("100000000000", "-1"),
        lambda text: text.replace("3.0", "NaN"),
        lambda text: text.replace("3.0", "1e308"),
        lambda text: text.replace("3.0", '"x"'),
        lambda text: '{"format": "revnm robot places 1", "camera": "hall", "places": []}',
        lambda text: '{"format": "revnm robot places 1", "camera": "hall", "places": null}',
    ],
)
def test_a_damaged_file_is_no_loss(tmp_path: Path, damage, caplog: pytest.LogCaptureFixture) -> None:  # type: ignore[no-untyped-def]
    keeper = PlaceKeeper(tmp_path, "hall")
    keeper.offer({"rover": HERE})
    keeper.close()
    path = tmp_path / "hall.places.json"
    assert kept(tmp_path) == {"rover": HERE}
    path.write_text(damage(path.read_text()))
    assert kept(tmp_path) == {}
    assert f"{path}: refused" in caplog.text


def test_a_disk_that_cannot_be_written_is_told_once(
    tmp_path: Path, clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "kept").write_text("a file where the folder should be")
    keeper = PlaceKeeper(tmp_path / "kept", "hall", now_s=clock)
    for step in range(5):
        clock.now_s += 31.0
        eventually(lambda: keeper.offer({"rover": clock.at(float(step))}))  # noqa: B023
    eventually(lambda: keeper.trouble is not None)
    (tmp_path / "kept").unlink()
    clock.now_s += 31.0
    eventually(lambda: keeper.offer({"rover": clock.at(9.0)}))
    eventually(lambda: keeper.trouble is None)
    assert caplog.text.count("hall.places.json") == 1


def test_a_robot_is_where_its_odometry_says_that_it_went() -> None:
    anchor = Anchor(HERE)
    assert not anchor.holds  # before it is heard
    anchor.hear(odometry(ODOM @ Pose2(0.3, 0.0, 0.0)), 7)
    assert anchor.holds
    place = anchor.floor_from_robot(ODOM @ Pose2(2.0, 0.0, 0.0), 7)
    assert place is not None
    np.testing.assert_allclose(place, FLOOR @ Pose2(2.0, 0.0, 0.0), atol=1e-9)
    assert anchor.floor_from_robot(ODOM, 6) is None


@pytest.mark.parametrize(
    "first",
    [
        odometry(ODOM @ Pose2(1.6, 0.0, 0.0)),
        odometry(ODOM @ Pose2(0.0, 0.0, 2.1)),
        odometry(ODOM, after_s=301.0),
        odometry(ODOM, after_s=-1.0),
        odometry(Pose2(0.0, 0.01, 0.0)),  # near enough, but that is how odometry begins
    ],
)
def test_odometry_that_does_not_go_on_from_there_tells_nothing(first: Odometry) -> None:
    anchor = Anchor(HERE)
    anchor.hear(first, 7)
    anchor.hear(odometry(ODOM), 7)
    assert not anchor.holds


def test_a_robot_that_was_at_the_origin_may_be_there_again() -> None:
    anchor = Anchor(HERE._replace(odom_from_robot=Pose2(0.0, 0.0, 0.0)))
    anchor.hear(odometry(Pose2(0.0, 0.0, 0.0)), 7)
    assert anchor.holds


def test_stamps_may_step_and_poses_may_not() -> None:
    anchor = Anchor(HERE)
    anchor.hear(odometry(ODOM), 7)
    anchor.hear(odometry(ODOM @ Pose2(0.01, 0.0, 0.0), after_s=4.0), 8)  # the robot's clock is known by now
    assert anchor.floor_from_robot(ODOM, 8) is not None
    anchor.hear(odometry(ODOM @ Pose2(0.5, 0.0, 0.0)), 9)
    assert not anchor.holds


def test_another_frame_takes_it_along_or_drops_it() -> None:
    shift = Pose2(1.0, 2.0, 0.25)
    anchor = Anchor(HERE)
    anchor.hear(odometry(ODOM), 7)
    anchor.carry(lambda points: (shift.apply(points), np.ones(len(points), dtype=np.bool_)))
    place = anchor.floor_from_robot(ODOM, 7)
    assert place is not None
    np.testing.assert_allclose(place, shift @ FLOOR, atol=1e-9)
    anchor.carry(lambda points: (points, np.zeros(len(points), dtype=np.bool_)))
    assert not anchor.holds
