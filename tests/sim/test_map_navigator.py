"""The map navigator drives a robot on rails through a room that the simulator's ray caster shows it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry
from revnm_server.calibration.calibrator import Calibrator
from revnm_server.calibration.keyframes import TagMount
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.mapping.site_map import SiteMap
from revnm_server.tick.map_navigator import MapNavigator
from revnm_server.tick.map_robot import RobotShape
from revnm_server.tick.map_route import NavigatorTick
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth, overlay_depth, robot_primitive
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.world import Primitive, Shape, primitive_arrays

SIZE_PX, HW = (640, 480), (96, 128)
SPEC = RobotSpec()
WALL = Primitive(Shape.BOX, (4.5, 0.0, 0.3), (0.3, 2.0, 0.6), 0.0, (90, 90, 90))
CAMERA = Camera(*SIZE_PX, math.radians(90.0), (0.0, 0.0, 2.6), 0.0, math.radians(32.0))
TICK_NS = 200_000_000
ORIGIN = Pose2(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Goal:
    id: str
    normalised: tuple[float, float]


def goal_at(x_m: float, y_m: float) -> Goal:
    pixel, _ = CAMERA.project(np.array([x_m, y_m, 0.0]))
    return Goal("g", (float(pixel[0] + 0.5) / SIZE_PX[0], float(pixel[1] + 0.5) / SIZE_PX[1]))


@dataclass
class Room:
    """A camera, a wall, and a robot that goes exactly where it is told, at 0.4 m/s."""

    pose: Pose2
    goal: Goal
    scans: bool = False
    spec: MapSpec = field(default_factory=MapSpec)
    camera: Camera = CAMERA
    odom_from_start: Pose2 = ORIGIN
    stamp_ns: int = 0
    ticks: list[NavigatorTick] = field(default_factory=list)
    noise: bool = False
    sees: bool = True

    def __post_init__(self) -> None:
        shape = RobotShape(TagMount(SPEC.tag_m, SPEC.top_m), SPEC.length_m, SPEC.width_m)
        site = SiteMap(SIZE_PX, HW, self.spec, scans=self.scans)
        self.navigator = MapNavigator({"rover": shape}, Calibrator(SIZE_PX), site)
        self.start = self.pose
        self.rng = np.random.default_rng(0)

    def tick(self) -> NavigatorTick:
        self.stamp_ns += TICK_NS
        odom = self.odom_from_start @ self.start.inverse() @ self.pose
        self.navigator.hear_odometry("rover", Odometry(self.stamp_ns, odom, STANDSTILL))
        seen = see_robot(self.camera, self.pose, SPEC, robot="rover", stamp_ns=self.stamp_ns)
        sightings = [replace(seen, corners=seen.corners + self.rng.normal(0.0, 0.3, (4, 2)))] if self.sees else []
        result = self.navigator.step(self.stamp_ns, self._disparity(), sightings, {"rover": self.goal})
        self.navigator.learn()
        self.ticks.append(result)
        self._move(result.routes["rover"].waypoints_m)
        return result

    def _disparity(self) -> np.ndarray:
        if self.noise:
            return self.rng.random(HW).astype(np.float32)
        depth = cast_depth(primitive_arrays((WALL,)), self.camera, HW)
        depth = overlay_depth(depth, self.camera, robot_primitive(self.pose, SPEC))
        return 3.0 * disparity_from_depth(depth) + np.float32(0.7)  # of any scale and shift

    def _move(self, waypoints: np.ndarray | None) -> None:
        if waypoints is None:
            return
        bearing = math.atan2(waypoints[0, 1], waypoints[0, 0])
        turn = float(np.clip(bearing, -0.14, 0.14))
        ahead = 0.08 if abs(bearing) < 0.6 else 0.0
        ahead = min(ahead, float(np.hypot(*waypoints[-1])))
        self.pose @= Pose2(ahead * math.cos(turn / 2.0), ahead * math.sin(turn / 2.0), turn)

    def distance_to(self, x_m: float, y_m: float) -> float:
        return math.hypot(self.pose.x_m - x_m, self.pose.y_m - y_m)


def test_a_camera_that_nobody_calibrated_leads_the_robot_round_the_wall():
    room = Room(Pose2(3.6, 0.2, 2.5), goal_at(5.9, 0.0))
    first = room.tick()
    assert first.routes["rover"].reason.startswith("learning the camera")
    closest = math.inf
    for _ in range(200):
        tick = room.tick()
        # the wall's footprint is 0.3 × 2.0 m about (4.5, 0)
        aside = max(abs(room.pose.x_m - 4.5) - 0.15, 0.0), max(abs(room.pose.y_m) - 1.0, 0.0)
        closest = min(closest, math.hypot(*aside))
        if room.distance_to(5.9, 0.0) < 0.35:
            break
    assert room.distance_to(5.9, 0.0) < 0.35
    assert closest > 0.15
    assert tick.calibration.status == "good"
    assert tick.calibration.camera.focal_px == pytest.approx(CAMERA.focal_px, rel=0.06)
    assert tick.routes["rover"].way_m is not None


def calibrated(**changes: object) -> Room:
    room = Room(Pose2(3.2, -1.2, 1.2), goal_at(3.2, 1.6), **changes)
    while not room.ticks or not room.ticks[-1].calibration.leads:
        room.tick()
        assert len(room.ticks) < 60
    return room


def test_a_picture_of_noise_makes_no_map_and_says_so():
    room = calibrated()
    room.noise = True
    for _ in range(12):  # a map of the last two seconds still serves
        tick = room.tick()
    route = tick.routes["rover"]
    assert tick.grid is None
    assert route.waypoints_m is None
    assert "noise" in route.reason or "floor" in route.reason
    room.noise = False
    for _ in range(8):
        tick = room.tick()
    assert tick.grid is not None
    assert tick.routes["rover"].waypoints_m is not None


def test_a_jump_of_odometry_is_not_believed():
    room = calibrated()
    room.odom_from_start = Pose2(5.0, 1.0, 0.5)
    tick = room.tick()
    place = tick.places.get("rover")
    before = Pose2(*room.pose)
    assert place is None or math.hypot(place.x_m - before.x_m, place.y_m - before.y_m) < 0.4
    for _ in range(30):
        tick = room.tick()
    place = tick.places["rover"]
    assert math.hypot(place.x_m - room.pose.x_m, place.y_m - room.pose.y_m) < 0.25


def test_a_knocked_camera_is_noticed_and_learnt_again():
    room = calibrated()
    good = room.ticks[-1].calibration
    assert good.event is None
    room.camera = replace(CAMERA, pitch_rad=CAMERA.pitch_rad + math.radians(5.0))
    routes = [room.tick().routes["rover"] for _ in range(40)]
    state = room.ticks[-1].calibration
    assert "jumped" in (state.event or "")
    assert any(route.way_m is None for route in routes[:10])  # no map of before is used
    assert state.camera.pitch_rad == pytest.approx(room.camera.pitch_rad, abs=math.radians(2.5))


def test_a_robot_that_is_out_of_sight_goes_on_by_its_odometry():
    room = calibrated()
    room.sees = False
    for _ in range(10):
        tick = room.tick()
    place = tick.places["rover"]
    assert math.hypot(place.x_m - room.pose.x_m, place.y_m - room.pose.y_m) < 0.25
    assert tick.routes["rover"].waypoints_m is not None


def test_a_hidden_robot_that_stands_beside_its_goal_looks_around_until_it_is_seen():
    room = calibrated()
    slipped = Pose2(0.1, -0.6, 0.0)  # which its odometry does not notice
    room.pose, room.start = slipped @ room.pose, slipped @ room.start
    reasons = set()
    for _ in range(300):
        room.sees = room.distance_to(3.2, 1.6) < 0.4
        route = room.tick().routes["rover"]
        reasons.add(route.reason)
        if route.arrived:
            break
    assert route.arrived
    assert any("looking around" in reason for reason in reasons)
    assert room.distance_to(3.2, 1.6) < 0.3


def test_a_robot_beyond_the_map_is_led_to_it_and_told_so():
    room = calibrated(spec=MapSpec(ahead_m=2.5))
    route = room.ticks[-1].routes["rover"]
    assert "beyond the map" in route.reason
    assert route.waypoints_m is not None
    for _ in range(60):  # the goal lies beyond it, too: out there the way is straight
        room.tick()
    assert room.distance_to(3.2, 1.6) < 0.3


def test_nothing_is_planned_before_the_robot_was_seen():
    room = Room(Pose2(3.6, 0.2, 2.5), goal_at(5.9, 0.0))
    room.sees = False
    tick = room.tick()
    assert tick.routes["rover"].reason == "the camera has not seen the robot yet"
    assert tick.calibration.status == "unknown"
    assert tick.grid is None
