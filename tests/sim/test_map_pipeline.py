"""The map pipeline on simulated pictures: its plans, its report, and other sizes of the picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_server.calibration.keeper import CalibrationKeeper
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import Frame
from revnm_server.map_pipeline import MapPipeline, way_in_picture
from revnm_server.pipeline import TickResult
from revnm_server.ports import Heard

from .map_room import CAMERA, GOAL_M, HW, SHAPE, SIZE_PX, Click, Room, Told, pixel_of

TICK_NS = 200_000_000
U, V = pixel_of(*GOAL_M)
GOALS = {"rover": Click("g", (U / SIZE_PX[0], V / SIZE_PX[1]))}


class Drive:
    """A map pipeline that drives the room's robot."""

    def __init__(self, keeper: CalibrationKeeper | None = None) -> None:
        self.room, self.told = Room(), Told()
        senses = {"rover": self.told}
        self.pipeline = MapPipeline(
            depth=self.room, disparity_hw=HW, tags=self.room, senses=senses, shape=SHAPE, keeper=keeper
        )
        self.stamp_ns = 0

    def tick(self, *, size_px: tuple[int, int] = SIZE_PX, silent: bool = False) -> TickResult:
        self.stamp_ns += TICK_NS
        odometry = self.room.odometry(self.stamp_ns)
        self.told.heard = Heard() if silent else Heard(odometry=(odometry,))
        image = np.zeros((size_px[1], size_px[0], 3), np.uint8)
        result = self.pipeline.step(Frame(image, self.stamp_ns, self.stamp_ns), GOALS)
        for plan in result.plans:
            self.room.drive(plan.waypoints_m)
        return result

    def until_led(self) -> TickResult:
        for _ in range(60):
            result = self.tick()
            assert result.site is not None
            if result.site.calibration.leads and result.site.routes["rover"].way_m is not None:
                return result
        raise AssertionError("no calibration")


def test_the_robot_is_led_to_the_goal_and_the_report_says_how() -> None:
    drive = Drive()
    first = drive.tick()
    assert first.site is not None
    assert first.site.routes["rover"].reason.startswith("learning the camera")
    assert (first.plans[0].robot, first.plans[0].stamp_ns, first.plans[0].goal_id) == ("rover", TICK_NS, "g")
    assert [sighting.robot for sighting in first.sightings] == ["rover"]  # a stranger's tag is nobody's
    assert (first.ego_depths, set(first.timings_ms)) == ({}, {"depth", "tag", "map", "tick"})
    assert first.disparity.shape == HW
    assert first.site.rejected == {"rover/odom": 2}
    for _ in range(80):
        result = drive.tick()
        assert result.site is not None
        if result.site.routes["rover"].arrived:
            break
    assert drive.room.distance_m() < 0.35
    assert result.site.calibration.status == "good"
    assert result.site.grid is not None


def test_the_way_is_drawn_where_the_camera_shows_it() -> None:
    drive = Drive()
    for _ in range(8):
        result = drive.until_led()
    assert result.site is not None
    place, way_px = result.site.routes["rover"], result.site.routes["rover"].way_px
    assert way_px is not None
    assert place.way_m is not None
    # It begins below the robot's middle and ends at the clicked pixel.
    below, _ = CAMERA.project(np.array([drive.room.pose.x_m, drive.room.pose.y_m, 0.0]))
    assert np.hypot(*(way_px[0] - below)) < 40.0  # the robot has gone a step since
    assert np.hypot(*(way_px[-1] + 0.5 - (U, V))) < 12.0


def test_a_way_is_cut_where_it_would_pass_below_the_camera() -> None:
    camera = FloorCamera(SIZE_PX, CAMERA.focal_px, 0.6, 0.0, 2.6)
    way_m = np.column_stack([np.linspace(3.0, -3.0, 121), np.zeros(121)])
    pixels = way_in_picture(way_m, camera)
    assert 3 < len(pixels) < 21
    assert np.all(np.diff(pixels[:, 1]) > 0.0)


def test_a_hidden_robot_is_carried_on_by_its_odometry() -> None:
    drive = Drive()
    drive.until_led()
    drive.room.hidden = True
    before_m = drive.room.distance_m()
    for _ in range(8):
        result = drive.tick()
    assert result.plans
    assert result.sightings == ()
    assert drive.room.distance_m() < before_m - 0.3


def test_a_robot_whose_odometry_is_not_heard_gets_no_plan_and_the_reason() -> None:
    drive = Drive()
    result = drive.tick(silent=True)
    assert result.site is not None
    assert result.plans == ()
    assert result.site.routes["rover"].reason == "the server hears no odometry of the robot"


def test_a_picture_of_another_size_is_a_camera_to_learn_anew() -> None:
    drive = Drive()
    assert drive.until_led().site.warnings == ()  # type: ignore[union-attr]
    site = drive.tick(size_px=(1280, 960)).site
    assert site is not None
    assert "1280 × 960 now, not 640 × 480" in site.warnings[0]
    assert not site.calibration.leads


def test_depth_of_the_wrong_shape_is_a_fault() -> None:
    room = Room()
    pipeline = MapPipeline(depth=room, disparity_hw=(48, 64), tags=room, senses={"rover": Told()}, shape=SHAPE)
    room.odometry(1)
    with pytest.raises(ContractError, match=r"disparity: shape expected \(48, 64\)"):
        pipeline.step(Frame(np.zeros((480, 640, 3), np.uint8), 1, 1), {})


def test_what_was_learnt_of_the_camera_serves_after_a_restart(tmp_path: Path) -> None:
    first = Drive(CalibrationKeeper(tmp_path, "hall"))
    while first.tick().site.calibration.status != "good":  # type: ignore[union-attr]
        assert first.stamp_ns < 60 * TICK_NS
    first.pipeline.close()
    again = Drive(CalibrationKeeper(tmp_path, "hall"))
    site = again.tick().site
    assert site is not None
    assert site.calibration.status == "good"
    assert site.routes["rover"].reason == ""
    assert site.routes["rover"].way_m is not None


def test_a_damaged_file_is_named_and_nothing_is_believed_of_it(tmp_path: Path) -> None:
    (tmp_path / "hall.json").write_text("{")
    drive = Drive(CalibrationKeeper(tmp_path, "hall"))
    site = drive.tick().site
    assert site is not None
    assert "hall.json" in site.warnings[0]
    assert not site.calibration.leads
    while drive.tick().site.warnings:  # type: ignore[union-attr]
        assert drive.stamp_ns < 60 * TICK_NS
    drive.pipeline.close()
    assert (tmp_path / "hall.json.refused").read_text() == "{"
