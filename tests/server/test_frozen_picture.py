"""A picture that stands while a robot in it drives is no camera to steer by; and robots must be able to start again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import zenoh
from numpy.typing import NDArray

from revnm_client.link import open_client
from revnm_server.calibration.calibrator import Calibrator
from revnm_server.camera.content import FIRST_HOLD_S, FROZEN_AFTER_S, ContentWatch, digest
from revnm_server.camera.pyav_reader import PyavReader
from revnm_server.camera.url import NetworkCamera, parse_camera_url
from revnm_server.robots.mission import Mission
from revnm_server.service import NavigationService
from revnm_server.tick.site_report import SiteReport
from revnm_sim.live.rtsp_server import RtspServer, filming

from .service_parts import FakePipeline, RobotEnd
from .waiting import eventually

STEP_S = 0.1
SIZE = (160, 96)


def picture(level: int) -> NDArray[np.uint8]:
    return np.full((96, 160, 3), level, np.uint8)


class Clock:
    """Runs a watch on pictures ten times a second."""

    def __init__(self) -> None:
        self.watch, self.now_s = ContentWatch(), 100.0

    def run(self, duration_s: float, *, moves: bool, changes: bool = False) -> None:
        for _ in range(round(duration_s / STEP_S)):
            self.now_s += STEP_S
            self.watch.note_motion("rover" if moves else None, self.now_s)
            self.watch.see(round(self.now_s / STEP_S) if changes else 7, self.now_s)

    @property
    def frozen(self) -> bool:
        return self.watch.frozen(self.now_s) is not None


def test_a_small_change_anywhere_is_a_change() -> None:
    still = np.full((1080, 1920, 3), 90, np.uint8)
    for row, column in ((0, 0), (537, 900), (1062, 1910)):
        changed = still.copy()
        changed[row : row + 10, column : column + 10] += 1  # far smaller than a tag that can be read
        assert digest(changed) != digest(still) == digest(still.copy())


def test_a_still_scene_stops_nobody() -> None:
    clock = Clock()
    clock.run(60.0, moves=False)
    assert not clock.frozen
    assert "not changed at all for 60 s" in str(clock.watch.odd(clock.now_s))
    clock.run(FROZEN_AFTER_S - 2 * STEP_S, moves=True)  # it starts, and its picture lags behind
    assert not clock.frozen
    clock.run(20.0, moves=True, changes=True)
    assert not clock.frozen
    assert clock.watch.odd(clock.now_s) is None


def test_a_picture_that_stands_while_a_robot_drives_is_frozen_until_it_changes() -> None:
    clock = Clock()
    clock.run(3.0, moves=True, changes=True)
    clock.run(FROZEN_AFTER_S + 2 * STEP_S, moves=True)
    assert clock.frozen
    assert clock.watch.frozen(clock.now_s) == "the picture is frozen: unchanged for 1 s, while rover drove"
    clock.run(2.0, moves=False)  # it got no more plans
    assert clock.frozen
    clock.run(STEP_S, moves=False, changes=True)
    assert not clock.frozen


def test_robots_may_try_again_and_ever_more_seldom() -> None:
    clock = Clock()
    clock.run(1.0, moves=False)
    hold_s = FIRST_HOLD_S
    for _ in range(3):
        clock.run(FROZEN_AFTER_S + 2 * STEP_S, moves=True)
        assert clock.frozen
        clock.run(hold_s - STEP_S, moves=False)
        assert clock.frozen
        clock.run(3 * STEP_S, moves=False)
        assert not clock.frozen
        hold_s *= 2.0
    clock.run(STEP_S, moves=True, changes=True)  # it was honest: the next time is a first one again
    clock.run(FROZEN_AFTER_S + 3 * STEP_S, moves=True)
    assert clock.frozen
    clock.run(FIRST_HOLD_S + 3 * STEP_S, moves=False)
    assert not clock.frozen


def test_a_stream_that_pauses_is_not_frozen_when_it_goes_on() -> None:
    clock = Clock()
    clock.run(1.0, moves=True, changes=True)
    clock.now_s += 5.0  # no pictures, and the robot stands soon
    clock.watch.note_motion(None, clock.now_s)
    clock.run(1.0, moves=False)
    assert not clock.frozen


def test_a_picture_that_changes_but_shows_a_robot_standing_that_drives_is_frozen_for_a_while() -> None:
    clock = Clock()
    clock.run(3.0, moves=True, changes=True)
    clock.watch.note_standing("rover", clock.now_s)
    clock.run(1.0, moves=True, changes=True)  # until it has no plan any more
    assert clock.watch.frozen(clock.now_s) == (
        "rover drives, but the picture shows it standing: it is frozen, or the wheels slip"
    )
    clock.run(FIRST_HOLD_S - STEP_S, moves=False, changes=True)
    assert clock.frozen
    clock.run(3 * STEP_S, moves=False, changes=True)
    assert not clock.frozen


@contextmanager
def driven(
    router: zenoh.Session,
    endpoint: str,
    folder: Path,
    scene: Callable[[int], NDArray[np.uint8]],
    pipeline: FakePipeline,
) -> Iterator[tuple[NavigationService, RobotEnd]]:
    """Run a service whose camera films a scene, and a robot that has a goal and gets plans."""
    mission = Mission(["rover"], state_file=folder / "state.json")
    with RtspServer() as server, filming(server, scene, fps=15), open_client([endpoint]) as client:
        source = parse_camera_url(server.url)
        assert isinstance(source, NetworkCamera)
        camera = PyavReader(source)
        service = NavigationService(router, camera=camera, pipeline=pipeline, mission=mission, tick_hz=50)
        service.start()
        try:
            with RobotEnd(client) as robot:
                eventually(lambda: service.camera.latest())
                mission.set_goal("rover", 100, 50, size_px=SIZE)
                eventually(lambda: len(robot.plans) >= 3)
                yield service, robot
        finally:
            service.close()
            camera.close()


def assert_no_more_plans(service: NavigationService, robot: RobotEnd) -> None:
    """Pictures go on, plans do not."""
    count, seq = len(robot.plans), service.camera.latest().seq  # type: ignore[union-attr]
    eventually(lambda: service.camera.latest().seq > seq + 5)  # type: ignore[union-attr]
    assert len(robot.plans) == count


def test_a_picture_that_shows_a_driving_robot_standing_gives_no_plan(
    router: zenoh.Session, endpoint: str, tmp_path: Path
) -> None:
    pipeline = FakePipeline()
    with driven(router, endpoint, tmp_path, lambda index: picture(60 + 20 * (index % 5)), pipeline) as (service, robot):
        pipeline.site = SiteReport(1, Calibrator(SIZE).state, None, {}, {}, (), {}, standing="rover")
        eventually(lambda: service.view().camera.state == "stale")
        assert "rover drives, but the picture shows it standing" in str(service.view().camera.reason)
        assert_no_more_plans(service, robot)


def test_a_frozen_camera_gives_no_plan_while_its_robot_drives(
    router: zenoh.Session, endpoint: str, tmp_path: Path
) -> None:
    pictures = {"standing": False}

    def scene(index: int) -> NDArray[np.uint8]:
        return picture(60 if pictures["standing"] else 60 + 20 * (index % 5))

    with driven(router, endpoint, tmp_path, scene, FakePipeline()) as (service, robot):
        pictures["standing"] = True
        eventually(lambda: service.view().warnings)  # the robot stands: a still picture is only odd
        assert service.view().camera.state == "running"

        eventually(lambda: robot.say(moving=True) or service.view().camera.state == "stale")
        assert "frozen" in str(service.view().camera.reason)
        eventually(lambda: "frozen" in str(service.view().robots[0].reason))
        assert_no_more_plans(service, robot)

        count = len(robot.plans)
        pictures["standing"] = False
        eventually(lambda: len(robot.plans) > count)
        assert service.view().camera.state == "running"
