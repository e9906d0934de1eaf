"""The map pipeline on simulated pictures: its plans, its report, and other sizes of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray, Pose2
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.calibration.keeper import CalibrationKeeper
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import Frame
from revnm_server.map_driver import MapDriver
from revnm_server.map_pipeline import MapPipeline, way_in_picture
from revnm_server.map_window import WindowSpec, map_window
from revnm_server.observation import Image32
from revnm_server.pipeline import TickResult
from revnm_server.ports import EgoRequest, Heard, WayRequest
from revnm_server.site_map import SiteMap
from revnm_server.way import at_lengths
from revnm_training.preset import load_preset

from .map_room import CAMERA, GOAL_M, HW, SHAPE, SIZE_PX, Click, Room, Told, pixel_of

SPEC = load_preset("edge").observation
CAMERA_BELIEF = FloorCamera(SIZE_PX, CAMERA.focal_px, CAMERA.pitch_rad, 0.0, 2.6)
TICK_NS = 200_000_000
U, V = pixel_of(*GOAL_M)
GOALS = {"rover": Click("g", (U / SIZE_PX[0], V / SIZE_PX[1]))}


class Drive:
    """A map pipeline that drives the room's robot."""

    def __init__(self, keeper: CalibrationKeeper | None = None, driver: MapDriver | None = None) -> None:
        self.room, self.told = Room(), Told()
        self.pipeline = MapPipeline(
            depth=self.room,
            disparity_hw=HW,
            tags=self.room,
            senses={"rover": self.told},
            shape=SHAPE,
            driver=driver,
            keeper=keeper,
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


class Scripted:
    """Stands for both networks: an empty view, ways turned a little to the left, and a belief about all around."""

    def __init__(self, belief: float = 0.1) -> None:
        self.belief = belief
        self.egos: list[EgoRequest] = []
        self.ways: list[WayRequest] = []

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        self.egos = list(requests)
        return np.ones((len(requests), SPEC.ego_px, SPEC.ego_px), dtype=np.float32)

    def correct(self, requests: Sequence[WayRequest]) -> tuple[FloatArray, Image32]:
        self.ways = list(requests)
        side = WindowSpec().side
        waypoints = np.stack([request.way[: SPEC.waypoints] + np.array([0.0, 0.01]) for request in requests])
        return waypoints, np.full((len(requests), side, side), self.belief, dtype=np.float32)


def test_a_policy_sees_the_way_and_the_map_and_has_the_last_word() -> None:
    networks = Scripted()
    drive = Drive(driver=MapDriver(SPEC, exo2ego=networks, policy=networks, tag_height_m=SHAPE.mount.height_m))
    result = drive.until_led()
    (seen,), (ego,) = networks.ways, networks.egos
    assert result.site is not None
    route, place = result.site.routes["rover"], result.site.places["rover"]
    assert route.way_m is not None
    np.testing.assert_allclose(result.plans[0].waypoints_m, seen.way[: SPEC.waypoints] + np.array([0.0, 0.01]))
    np.testing.assert_allclose(place.apply(seen.way), at_lengths(route.way_m, 0.4 * np.arange(1, 13)), atol=1e-9)
    np.testing.assert_allclose(place.apply(seen.goal), route.goal_m)
    assert result.site.grid is not None
    np.testing.assert_array_equal(seen.window[0], map_window(result.site.grid, place)[0])
    assert set(result.timings_ms) == {"depth", "tag", "map", "exo2ego", "policy", "tick"}
    assert set(result.ego_depths) == {"rover"}
    # Where the tag is in the picture, by calibration and odometry alone.
    shown = result.sightings[0]
    assert np.hypot(*(ego.pose.p_rob * np.array(SIZE_PX) - shown.pixel)) < 8.0
    assert ego.pose.q_rel @ shown.heading > 0.99
    assert ego.prior is not None
    assert ego.prior.shape == (2, SPEC.ego_px, SPEC.ego_px)


def test_the_robot_arrives_with_a_policy_that_believes_the_best_and_with_one_that_believes_the_worst() -> None:
    for belief in (0.0, 1.0):
        networks = Scripted(belief)
        drive = Drive(driver=MapDriver(SPEC, exo2ego=networks, policy=networks, tag_height_m=SHAPE.mount.height_m))
        for _ in range(90):
            result = drive.tick()
            assert result.site is not None
            if result.site.routes["rover"].arrived:
                break
        assert drive.room.distance_m() < 0.35


def test_beliefs_fill_what_nobody_saw_and_nothing_else() -> None:
    site = SiteMap(SIZE_PX, HW)
    state = CalibrationState("good", CAMERA_BELIEF, np.zeros((5, 5)), 0.0, 0.0, 1.0, 9, 3.0, None)
    site.recalibrate(state)
    plain = site.grid(0)
    assert plain is not None
    plain.obstacle[:, :100], plain.age_s[:, :100] = 0.2, 0.0
    place = Pose2(6.0, 0.0, 0.5)
    side = WindowSpec().side
    site.believe(np.full((side, side), 0.97, dtype=np.float32), place)
    site.believe(np.full((side, side), 0.03, dtype=np.float32), place @ Pose2(20.0, 0.0, 0.0))
    believed = site.believed_grid(plain)
    assert (believed.obstacle[:, :100] == np.float32(0.2)).all()  # what is known stays
    row, column = np.rint(plain.cells(place.apply(np.array([3.0, 0.0])))).astype(int)
    assert believed.obstacle[row, column] == pytest.approx(0.9)  # never sure: nothing is shut by it
    far = np.rint(plain.cells(np.array([20.0, -9.0]))).astype(int)
    assert believed.obstacle[far[0], far[1]] == 0.5  # no window lay there
    assert believed.obstacle.min() == pytest.approx(0.03)
    np.testing.assert_array_equal(believed.floor, plain.floor)
