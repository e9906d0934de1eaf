"""The map pipeline on simulated pictures: its plans, its report, and other sizes of the picture."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Scan
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.calibration.keeper import CalibrationKeeper
from revnm_server.calibration.places import PlaceKeeper
from revnm_server.calibration.prior import wide_prior
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import Frame, RobotSighting
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.mapping.map_window import WindowSpec, map_window
from revnm_server.mapping.site_map import SiteMap
from revnm_server.observation import Image32
from revnm_server.planning.kept_way import Carry
from revnm_server.planning.map_planner import MapPlanner
from revnm_server.planning.way import at_lengths
from revnm_server.ports import BeliefRequest, EgoRequest, Heard
from revnm_server.tick.map_beliefs import MapBeliefs
from revnm_server.tick.map_pipeline import MapPipeline, way_in_picture
from revnm_server.tick.map_route import MapRoute, NavigatorTick
from revnm_server.tick.pipeline import TickResult
from revnm_training.preset import load_preset

from .map_room import CAMERA, GOAL_M, HW, SHAPE, SIZE_PX, Click, Room, Told, pixel_of

SPEC = load_preset("edge").observation
SECOND_NS = 1_000_000_000
BELIEVER = Pose2(6.0, 0.0, 0.5)
CAMERA_BELIEF = FloorCamera(SIZE_PX, CAMERA.focal_px, CAMERA.pitch_rad, 0.0, 2.6)
TICK_NS = 200_000_000
U, V = pixel_of(*GOAL_M)
GOALS = {"rover": Click("g", (U / SIZE_PX[0], V / SIZE_PX[1]))}


class Drive:
    """A map pipeline that drives the room's robot."""

    def __init__(
        self,
        keeper: CalibrationKeeper | None = None,
        beliefs: MapBeliefs | None = None,
        place_keeper: PlaceKeeper | None = None,
    ) -> None:
        self.room, self.told = Room(), Told()
        self.pipeline = MapPipeline(
            depth=self.room,
            disparity_hw=HW,
            tags=self.room,
            senses={"rover": self.told},
            shape=SHAPE,
            beliefs=beliefs,
            keeper=keeper,
            place_keeper=place_keeper,
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


def test_a_new_calibration_takes_the_way_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    taken, carry = [], MapPlanner.carry

    def seen(planner: MapPlanner, onto: Carry) -> None:
        carry(planner, onto)
        taken.append(bool(onto(np.array([GOAL_M]))[1].all()))

    monkeypatch.setattr(MapPlanner, "carry", seen)
    drive = Drive()
    drive.until_led()
    for _ in range(10):
        drive.tick()
    assert taken[0] is False  # there was no frame before the first
    assert sum(taken) >= 2


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


class Together:
    """The room's depth, which is not seen before its tags were looked for."""

    def __init__(self, room: Room) -> None:
        self._room, self._looked = room, threading.Event()

    def disparity(self, frame: Frame) -> Image32:
        assert self._looked.wait(20.0), "nobody looks for tags while the depth network runs"
        return self._room.disparity(frame)

    def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> Sequence[RobotSighting]:
        self._looked.set()
        return self._room.sightings(frame, expected)


def test_tags_are_found_while_the_depth_network_runs() -> None:
    room, told = Room(), Told()
    both = Together(room)
    pipeline = MapPipeline(depth=both, disparity_hw=HW, tags=both, senses={"rover": told}, shape=SHAPE)
    told.heard = Heard(odometry=(room.odometry(1),))
    result = pipeline.step(Frame(np.zeros((480, 640, 3), np.uint8), 1, 1), {})
    assert [sighting.robot for sighting in result.sightings] == ["rover"]
    assert result.disparity.shape == HW


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


def restarted(folder: Path, first: Drive) -> Drive:
    """Return a drive of another server, whose camera does not see the robot where it stands."""
    again = Drive(CalibrationKeeper(folder, "hall"), place_keeper=PlaceKeeper(folder, "hall"))
    again.room.pose, again.stamp_ns, again.room.hidden = first.room.pose, first.stamp_ns, True
    return again


def test_a_robot_that_nobody_sees_after_a_restart_is_led_from_where_it_was(tmp_path: Path) -> None:
    first = Drive(CalibrationKeeper(tmp_path, "hall"), place_keeper=PlaceKeeper(tmp_path, "hall"))
    while first.tick().site.calibration.status != "good":  # type: ignore[union-attr]
        assert first.stamp_ns < 60 * TICK_NS
    first.pipeline.close()
    assert first.room.distance_m() > 1.0

    again = restarted(tmp_path, first)
    for _ in range(100):
        result = again.tick()
        assert result.site is not None
        route = result.site.routes["rover"]
        assert not route.arrived  # which only the camera can say
        if again.room.distance_m() < 0.3:
            break
        assert "where the robot was before the restart" in route.reason
    assert again.room.distance_m() < 0.3
    again.room.hidden = False
    for _ in range(5):
        result = again.tick()
    assert result.site is not None
    assert (result.site.routes["rover"].reason, result.site.routes["rover"].arrived) == ("", True)


@pytest.mark.parametrize("change", ["driven far", "late", "jumped", "begun anew", "learnt anew"])
def test_where_a_robot_was_is_forgotten_where_it_may_be_elsewhere(tmp_path: Path, change: str) -> None:
    first = Drive(CalibrationKeeper(tmp_path, "hall"), place_keeper=PlaceKeeper(tmp_path, "hall"))
    while first.tick().site.calibration.status != "good":  # type: ignore[union-attr]
        assert first.stamp_ns < 60 * TICK_NS
    first.pipeline.close()

    again = restarted(tmp_path, first)
    if change == "driven far":
        again.room.pose @= Pose2(1.7, 0.0, 0.0)
    if change == "late":
        again.stamp_ns += 400 * SECOND_NS
    if change == "jumped":
        assert again.tick().plans != ()
        again.room.pose @= Pose2(0.0, 0.0, 2.0)
    if change == "learnt anew":  # as when another robot shows that the camera was turned
        assert again.tick().plans != ()
        again.pipeline._calibrator._start_over("the camera has jumped", wide_prior())
    if change == "begun anew":
        again.room.begun = again.room.pose
    result = again.tick()
    assert result.plans == ()
    assert result.site is not None
    assert result.site.routes["rover"].reason == "the camera has not seen the robot yet"
    again.pipeline.close()
    assert PlaceKeeper(tmp_path, "hall").load() == {}  # nor is it believed after the next restart


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


def test_a_picture_in_which_a_robot_that_drives_stands_is_told_of() -> None:
    drive = Drive()
    told = [drive.until_led()] + [drive.tick() for _ in range(10)]
    assert {result.site.standing for result in told if result.site is not None} == {None}
    drive.room.frozen = drive.room.pose
    for _ in range(12):
        drive.room.drive(np.array([[1.0, 0.3]]))  # by an older plan, or by hand
        result = drive.tick()
        assert result.site is not None
        if result.site.standing is not None:
            break
    assert result.site.standing == "rover"
    assert drive.room.pose != drive.room.frozen


class Failing:
    """Stands for both networks; they fail."""

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        raise ContractError("no ego depth")

    def believe(self, requests: Sequence[BeliefRequest]) -> Image32:
        raise ContractError("no belief")


def test_a_failing_policy_is_a_fault_and_the_camera_is_learnt_on() -> None:
    networks = Failing()
    drive = Drive(beliefs=MapBeliefs(SPEC, exo2ego=networks, policy=networks, tag_height_m=SHAPE.mount.height_m))
    before = drive.until_led().site
    faults = 0
    for _ in range(30):
        try:
            site = drive.tick().site
        except ContractError:  # of the picture before: no plan
            faults += 1
    assert faults >= 10
    assert before is not None
    assert site is not None
    assert site.calibration.keyframes > before.calibration.keyframes + 4


def test_a_tag_detector_that_fails_leaves_no_depth_network_running() -> None:
    room, running = Room(), threading.Semaphore(1)

    class Blind:
        def disparity(self, frame: Frame) -> Image32:
            assert running.acquire(blocking=False), "the depth network runs beside itself"
            try:
                return room.disparity(frame)
            finally:
                running.release()

        def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> list[RobotSighting]:
            raise ContractError("no tags")

    both = Blind()
    pipeline = MapPipeline(depth=both, disparity_hw=HW, tags=both, senses={"rover": Told()}, shape=SHAPE)
    for stamp in range(1, 6):
        room.odometry(stamp)
        with pytest.raises(ContractError, match="no tags"):
            pipeline.step(Frame(np.zeros((480, 640, 3), np.uint8), stamp, stamp), {})
        assert running.acquire(blocking=False), "the depth network runs on"
        running.release()


class Scripted:
    """Stands for both networks: an empty view, ways turned a little to the left, and a belief about all around."""

    def __init__(self, belief: float = 0.1) -> None:
        self.belief = belief
        self.egos: list[EgoRequest] = []
        self.asked: list[BeliefRequest] = []

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        self.egos = list(requests)
        return np.ones((len(requests), SPEC.ego_px, SPEC.ego_px), dtype=np.float32)

    def believe(self, requests: Sequence[BeliefRequest]) -> Image32:
        self.asked = list(requests)
        side = WindowSpec().side
        return np.full((len(requests), side, side), self.belief, dtype=np.float32)


def test_a_policy_sees_the_way_the_map_and_what_the_robot_would_see() -> None:
    networks = Scripted()
    drive = Drive(beliefs=MapBeliefs(SPEC, exo2ego=networks, policy=networks, tag_height_m=SHAPE.mount.height_m))
    assert set(drive.until_led().timings_ms) == {"depth", "tag", "map", "tick", "learn"}  # nobody waited for the policy
    result = drive.tick()
    drive.pipeline.close()
    (seen,), (ego,) = networks.asked, networks.egos
    assert result.site is not None
    route, place = result.site.routes["rover"], result.site.places["rover"]
    assert route.way_m is not None
    np.testing.assert_allclose(result.plans[0].waypoints_m, seen.way[: SPEC.waypoints], atol=1e-9)
    np.testing.assert_allclose(place.apply(seen.way), at_lengths(route.way_m, 0.4 * np.arange(1, 13)), atol=1e-9)
    np.testing.assert_allclose(place.apply(seen.goal), route.goal_m)
    assert result.site.grid is not None
    np.testing.assert_array_equal(seen.window[0], map_window(result.site.grid, place)[0])
    assert set(result.timings_ms) == {"depth", "tag", "map", "exo2ego", "policy", "tick", "learn"}
    assert set(result.ego_depths) == {"rover"}
    # Where the tag is in the picture, by calibration and odometry alone.
    shown = result.sightings[0]
    assert np.hypot(*(ego.pose.p_rob * np.array(SIZE_PX) - shown.pixel)) < 8.0
    assert ego.pose.q_rel @ shown.heading > 0.99
    assert ego.prior is not None
    assert ego.prior.shape == (2, SPEC.ego_px, SPEC.ego_px)


def test_of_many_robots_a_few_are_judged_at_a_time_and_all_in_turn() -> None:
    networks = Scripted()
    beliefs = MapBeliefs(SPEC, exo2ego=networks, policy=networks, tag_height_m=SHAPE.mount.height_m)
    tick, site, disparity = many_led(9)
    judged, shown = [], []
    for stamp_ns in range(5):
        shown.append(set(beliefs.renew(tick, site, disparity, stamp_ns, {})))
        judged.append([request.robot for request in networks.egos])
    assert [len(each) for each in judged] == [4] * 5
    assert set().union(*judged[:3]) == set(tick.routes)
    assert (len(shown[0]), len(shown[1])) == (4, 8)
    assert shown[2] == set(tick.routes)  # of their last turn
    waiting = replace(tick, routes={"r0": tick.routes["r0"]})
    assert set(beliefs.renew(waiting, site, disparity, 5, {})) == {"r0"}


def test_the_robot_arrives_with_a_policy_that_believes_the_best_and_with_one_that_believes_the_worst() -> None:
    for belief in (0.0, 1.0):
        networks = Scripted(belief)
        drive = Drive(beliefs=MapBeliefs(SPEC, exo2ego=networks, policy=networks, tag_height_m=SHAPE.mount.height_m))
        for _ in range(90):
            result = drive.tick()
            assert result.site is not None
            if result.site.routes["rover"].arrived:
                break
        assert drive.room.distance_m() < 0.35


def calibrated(camera: FloorCamera, *, restarts: int = 0) -> CalibrationState:
    return CalibrationState("good", camera, np.zeros((5, 5)), 0.0, 0.0, 1.0, 9, 3.0, None, restarts)


def many_led(count: int) -> tuple[NavigatorTick, SiteMap, Image32]:
    """Robots beside each other on a map, all on their ways, and what the camera sees."""
    site, room = SiteMap(SIZE_PX, HW), Room()
    room.odometry(0)
    disparity = room.disparity(Frame(np.zeros((480, 640, 3), np.uint8), 0, 0))
    state = calibrated(CAMERA_BELIEF)
    site.recalibrate(state)
    site.see(0, disparity, (), ())
    way_m = np.column_stack([np.arange(4.0, 8.0, 0.05), np.zeros(80)])
    route = MapRoute(np.zeros((5, 2)), way_m, "", way_m[-1], aim_m=way_m[-1])
    places = {f"r{number}": Pose2(4.0, 0.3 * number, 0.0) for number in range(count)}
    return NavigatorTick(dict.fromkeys(places, route), places, site.grid(0), state), site, disparity


def believing_site() -> tuple[SiteMap, FloorGrid]:
    """A map of which a strip was just seen, and the best and the worst that were believed at second 10."""
    site = SiteMap(SIZE_PX, HW)
    site.recalibrate(calibrated(CAMERA_BELIEF))
    grid = site.grid(0)
    assert grid is not None
    grid.obstacle[:, :100], grid.age_s[:, :100] = 0.2, 0.0
    side, beside = WindowSpec().side, BELIEVER @ Pose2(20.0, 0.0, 0.0)
    worst, best = (np.full((side, side), each, dtype=np.float32) for each in (0.97, 0.03))
    site.believe([(worst, BELIEVER), (best, beside)], 10 * SECOND_NS)
    return site, grid


def cell(grid: FloorGrid, point_m: FloatArray) -> tuple[int, int]:
    row, column = np.rint(grid.cells(point_m)).astype(int)
    return int(row), int(column)


def test_beliefs_fill_what_nobody_saw_however_old_they_are() -> None:
    site, plain = believing_site()
    believed = site.believed_grid(plain, 60 * SECOND_NS)
    assert (believed.obstacle[:, :100] == np.float32(0.2)).all()  # what is known stays
    # Never sure: nothing is shut by it.
    assert believed.obstacle[cell(plain, BELIEVER.apply(np.array([3.0, 0.0])))] == pytest.approx(0.9)
    assert believed.obstacle[cell(plain, np.array([20.0, -9.0]))] == 0.5  # no window lay there
    assert believed.obstacle.min() == pytest.approx(0.03)
    np.testing.assert_array_equal(believed.floor, plain.floor)


def test_beliefs_of_now_take_the_place_of_what_the_camera_saw() -> None:
    site, plain = believing_site()
    here = cell(plain, np.array([6.5, 0.0]))
    assert plain.known[here]
    assert site.believed_grid(plain, 10 * SECOND_NS).obstacle[here] == pytest.approx(0.9)
    assert site.believed_grid(plain, 12 * SECOND_NS).obstacle[here] == np.float32(0.2)


def test_beliefs_and_points_are_carried_into_a_new_calibration_but_not_over_a_jump() -> None:
    for restarts in (0, 1):
        site, grid = believing_site()[0], MapSpec().unknown()
        before = site.believed_grid(grid, 10 * SECOND_NS).obstacle
        other = replace(CAMERA_BELIEF, focal_px=1.1 * CAMERA_BELIEF.focal_px)
        reframed = site.recalibrate(calibrated(other, restarts=restarts))
        assert reframed is not None
        (moved,), known = reframed.carry(np.array([[6.0, 0.0]]))
        believed = site.believed_grid(grid, 10 * SECOND_NS)
        if restarts:  # the camera may look elsewhere now
            assert not known.any()
            assert (believed.obstacle == 0.5).all()
        else:
            assert known.all()
            assert abs(moved[0] - 6.0) > 0.2
            assert believed.obstacle[cell(believed, moved)] == pytest.approx(0.9)
            assert (believed.obstacle != before).any()


def test_what_a_scan_has_met_stays() -> None:
    site, _ = believing_site()
    ranges = np.full(360, 2.0, dtype=np.float32)
    scan = Scan(0, -math.pi, math.tau / 360, 0.1, 8.0, ranges)
    for _ in range(10):
        site.hear_scan(scan, BELIEVER)
    scanned = site.grid(0)
    assert scanned is not None
    scanned.age_s[:] = 0.0
    believed = site.believed_grid(scanned, 10 * SECOND_NS)
    free, met = (cell(scanned, BELIEVER.apply(np.array([ahead_m, 0.0]))) for ahead_m in (1.0, 2.0))
    assert believed.obstacle[free] == pytest.approx(0.9)  # something lower than the beams, perhaps
    assert believed.obstacle[met] == scanned.obstacle[met] > 0.9
