"""What a trial is: a world, a camera, and where the robot starts and must go.

Must not import PyBullet: training draws its pairs here too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray, Pose2
from revnm_sim.camera import Camera
from revnm_sim.expert.planner import INSCRIBED_M, CostToGo, Expert
from revnm_sim.generation.generator import demo_room
from revnm_sim.occupancy import OccupancyGrid
from revnm_sim.rays.raycast import visible
from revnm_sim.robot import RobotSpec
from revnm_sim.site import GOAL_RADIUS_M, Pair
from revnm_sim.world import PrimitiveArrays, World, primitive_arrays

_CLEARANCE_M = 0.35
_LONGEST_WAY_M = 20.0  # 40 s at full speed
_PLACES = 400
_ATTEMPTS = 50
_GOALS = 25
_STARTS_PER_GOAL = 4
_TAG_LEAST_PX = 20.0
_DEMO_BORDER_PX = 40.0
_DEMO_SEEN_SHARE = 0.6

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Scenario:
    """One trial.

    Attributes:
        world: Where it happens.
        camera: The remote camera.
        start: ``world_from_robot`` at the beginning.
        goal_m: (x, y) on the floor.
        seed: For everything random in the trial: sensor noise, drift, controller.
        goal_radius_m: So near to the goal the robot has arrived.
        robot: The robot, with its tag.
    """

    world: World
    camera: Camera
    start: Pose2
    goal_m: tuple[float, float]
    seed: int
    goal_radius_m: float = GOAL_RADIUS_M
    robot: RobotSpec = field(default_factory=RobotSpec)


def sample_pair(
    world: World,
    expert: Expert,
    rng: np.random.Generator,
    *,
    detour_m: float,
    cameras: Sequence[Camera] = (),
    distance_m: tuple[float, float] = (5.0, 10.0),
) -> Pair | None:
    """Draw a start, of any heading, and a goal that the robot can reach from there, both clear of obstacles.

    Args:
        world: Where.
        expert: Of the same world.
        rng: Decides the draws.
        detour_m: The straight way must be blocked, and the shortest one so much longer; 0 takes pairs as they come.
        cameras: Each of them must see the tag on a robot at the start, and the floor of the goal.
        distance_m: Least and greatest distance between the two.

    Returns:
        The pair, or None if this draw found none.
    """
    starts = goals = free_places(expert.grid, rng, count=_PLACES)
    arrays = primitive_arrays(world.obstacles)
    for camera in cameras:
        starts = starts[tag_seen(arrays, camera, starts, RobotSpec())]
        goals = goals[visible(arrays, camera, at_height(goals, 0.0))]
    for goal in goals[:_GOALS]:
        fitting = starts[_apart(starts, goal, distance_m)]
        if detour_m > 0.0:
            fitting = fitting[segment_blocked(expert.grid, fitting, goal)]
        if not len(fitting):
            continue
        to_goal = expert.field(goal)
        fitting = fitting[to_goal.reachable(fitting)]
        if detour_m > 0.0:
            fitting = fitting[_detours_m(expert.shortest(goal), fitting) >= detour_m]
        for start in fitting[:_STARTS_PER_GOAL]:
            if _drivable(to_goal, to_goal.path(start)):
                return _pair(start, goal, rng)
    return None


def _detours_m(shortest: CostToGo, starts_m: FloatArray) -> FloatArray:
    """Return how much longer than the straight way the shortest way from starts (M, 2) to the goal is, (M,)."""
    lengths: list[float] = [shortest.length_m(start) for start in starts_m]
    return np.asarray(np.array(lengths) - np.hypot(*(starts_m - shortest.goal_m).T))


def free_places(grid: OccupancyGrid, rng: np.random.Generator, *, count: int) -> FloatArray:
    """Draw points (M, 2), M ≤ ``count``, metres, where the robot may stand in any heading."""
    span = np.array(grid.occupied.shape[::-1]) * grid.resolution_m
    points = np.array(grid.origin_m) + rng.random((count, 2)) * span
    return np.asarray(points[grid.clearance_m(points) >= _CLEARANCE_M])


def segment_blocked(grid: OccupancyGrid, starts_m: FloatArray, goal_m: FloatArray) -> BoolArray:
    """Return for which starts (M, 2) a robot that goes straight to the goal (2,) touches something."""
    fractions = np.linspace(0.0, 1.0, 256)[:, None, None]
    points = starts_m + fractions * (goal_m - starts_m)  # (256, M, 2)
    return np.asarray((grid.clearance_m(points) < INSCRIBED_M).any(axis=0))


def tag_seen(arrays: PrimitiveArrays, camera: Camera, places_m: FloatArray, robot: RobotSpec) -> BoolArray:
    """Return at which places (M, 2) the camera sees the middle of a robot's tag and the circle of its corners."""
    points = tag_points(places_m, robot)  # (M, 5, 3)
    return np.asarray(visible(arrays, camera, points.reshape(-1, 3)).reshape(points.shape[:2]).all(axis=1))


def tag_points(places_m: FloatArray, robot: RobotSpec) -> FloatArray:
    """Return (M, 5, 3), metres: the middle of the tag at places (M, 2), and four points of its corners' circle."""
    reach = robot.tag_m / math.sqrt(2.0)
    offsets = np.array([[0.0, 0.0], [reach, 0.0], [-reach, 0.0], [0.0, reach], [0.0, -reach]])
    return at_height(places_m[:, None] + offsets, robot.top_m)


def tag_side_px(camera: Camera, places_m: FloatArray, robot: RobotSpec) -> FloatArray:
    """Return the mean length (M,) of the sides of the tag at places (M, 2), pixels, in its worst heading of two."""
    sides = []
    for yaw in (0.0, math.pi / 4.0):
        half = robot.tag_m / 2.0
        corners = Pose2(0.0, 0.0, yaw).apply(half * np.array([[1.0, 1], [1, -1], [-1, -1], [-1, 1]]))
        pixels, _ = camera.project(at_height(places_m[:, None] + corners, robot.top_m))  # (M, 4, 2)
        sides.append(np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=2).mean(axis=1))
    return np.asarray(np.minimum(*sides))


def demo_scenario(seed: int) -> Scenario:
    """Return the demo of a seed: a small room, a high camera, and a tag that stays at least 20 px wide.

    The camera sees the robot all along the expert's way; something may or may not stand in the straight way.

    Raises:
        ConfigError: The seed is negative.
        ContractError: The room has no place for such a camera.
    """
    world, robot = demo_room(seed), RobotSpec()
    expert, rng = Expert(world), np.random.default_rng([seed, 2])
    arrays = primitive_arrays(world.obstacles)
    for _ in range(_ATTEMPTS):
        camera = _wall_camera(world, rng)
        places = free_places(expert.grid, rng, count=_PLACES)
        seen = places[tag_seen(arrays, camera, places, robot)]
        if len(seen) < _DEMO_SEEN_SHARE * len(places) or tag_side_px(camera, seen, robot).min() < _TAG_LEAST_PX:
            continue
        pixels, _ = camera.project(at_height(seen, robot.top_m))
        edge = np.minimum(pixels, np.array([camera.width_px, camera.height_px]) - pixels).min(axis=1)
        central = seen[edge >= _DEMO_BORDER_PX]
        for goal in central[:_STARTS_PER_GOAL]:
            to_goal = expert.field(goal)
            for start in central[_apart(central, goal, (2.5, 5.0)) & to_goal.reachable(central)]:
                way = to_goal.path(start)
                if _drivable(to_goal, way) and tag_seen(arrays, camera, way, robot).all():
                    return Scenario(world, camera, *_pair(start, goal, rng), seed=seed)
    raise ContractError(f"world {world.name!r}: no camera sees a start, a goal and the way between")


def _wall_camera(world: World, rng: np.random.Generator) -> Camera:
    """Draw a camera 3.0 to 3.5 m up on a wall that looks at the middle of the room."""
    bounds = world.bounds
    half = np.array([bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m]) / 2.0
    middle = np.array([bounds.x_min_m, bounds.y_min_m]) + half
    side = int(rng.integers(2))
    place = rng.uniform(-0.4, 0.4, size=2) * half
    place[side] = (half[side] - 0.1) * rng.choice([-1.0, 1.0])
    x, y, z = (*(middle + place), rng.uniform(3.0, 3.5))
    aim = middle + rng.uniform(-0.3, 0.3, size=2)
    ahead = aim - (x, y)
    yaw, pitch = math.atan2(ahead[1], ahead[0]), math.atan2(z, float(np.hypot(*ahead)))
    hfov = math.radians(rng.uniform(75.0, 80.0))
    return Camera(1280, 960, hfov, (float(x), float(y), float(z)), yaw, pitch)


def _apart(points_m: FloatArray, goal_m: FloatArray, distance_m: tuple[float, float]) -> BoolArray:
    distance = np.hypot(*(points_m - goal_m).T)
    return np.asarray((distance >= distance_m[0]) & (distance <= distance_m[1]))


def _drivable(to_goal: CostToGo, way_m: FloatArray) -> bool:
    """Tell whether a way is wide and short enough for a trial."""
    length = float(np.hypot(*np.diff(way_m, axis=0).T).sum())
    return length <= _LONGEST_WAY_M and float(to_goal.grid.clearance_m(way_m).min()) > INSCRIBED_M


def _pair(start: FloatArray, goal: FloatArray, rng: np.random.Generator) -> Pair:
    heading = rng.uniform(-math.pi, math.pi)
    return Pair(Pose2(float(start[0]), float(start[1]), heading), (float(goal[0]), float(goal[1])))


def at_height(points_m: FloatArray, height_m: float) -> FloatArray:
    """Append a height to points (..., 2)."""
    return np.concatenate([points_m, np.full((*points_m.shape[:-1], 1), height_m)], axis=-1)
