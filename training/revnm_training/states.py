"""Chooses the robot states and goals that a policy learns from in one world seen by one camera.

Three kinds, after what a learner meets when it errs: near the expert's way with wrong heading and offset, anywhere,
and almost touching an obstacle. Unless asked for, no states are kept in which the tag is hidden; goals are what an
operator could click. Imports neither torch nor PyBullet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_sim.camera import Camera
from revnm_sim.expert.planner import INSCRIBED_M, CostToGo
from revnm_sim.occupancy import OccupancyGrid
from revnm_sim.rays.raycast import visible
from revnm_sim.robot import RobotSpec
from revnm_sim.scenario import tag_seen
from revnm_sim.world import PrimitiveArrays, World, primitive_arrays
from revnm_training.episodes import StateKind

SHARES = {StateKind.EXPERT: 0.60, StateKind.RANDOM: 0.25, StateKind.NEAR: 0.15}
NEAR_M = 0.15
_GOAL_CLEARANCE_M = 0.30
_NEAREST_GOAL_M = 0.3
_POOL = 3000
_PATHS = 4
_OFFSET_M = 0.12
_TURN_RAD = 0.6
_HISTORY_V_MPS = 0.5
_HISTORY_W_RADPS = 0.7


@dataclass(frozen=True, slots=True)
class Scene:
    """One world seen by one camera, with a pool of places where a robot may be.

    Attributes:
        camera: The remote camera.
        arrays: The world's primitives.
        grid: The world's occupancy.
        robot: The robot.
        hidden: Whether the robot may be where its tag is not seen.
        pool_m: (P, 2) places, world frame, evenly random.
        pool_clearance_m: (P,) their distance from obstacles.
    """

    camera: Camera
    arrays: PrimitiveArrays
    grid: OccupancyGrid
    robot: RobotSpec
    hidden: bool
    pool_m: FloatArray
    pool_clearance_m: FloatArray

    def fits(self, points_m: FloatArray) -> NDArray[np.bool_]:
        """Return at which of the points (M, 2) the robot touches nothing and, unless it may be hidden, is seen."""
        fits = self.grid.clearance_m(points_m) > INSCRIBED_M
        if not self.hidden:
            fits[fits] = tag_seen(self.arrays, self.camera, points_m[fits], self.robot)
        return fits


def make_scene(
    world: World,
    camera: Camera,
    grid: OccupancyGrid,
    robot: RobotSpec,
    rng: np.random.Generator,
    *,
    hidden: bool = False,
) -> Scene:
    """Draw the pool of places of a scene."""
    bounds = world.bounds
    low, high = np.array(bounds[:2]), np.array(bounds[2:])
    points = low + (high - low) * rng.random((_POOL, 2))
    arrays = primitive_arrays(world.primitives)
    scene = Scene(camera, arrays, grid, robot, hidden, points, grid.clearance_m(points))
    kept = scene.fits(points)
    return replace(scene, pool_m=points[kept], pool_clearance_m=scene.pool_clearance_m[kept])


def draw_goals(scene: Scene, count: int, rng: np.random.Generator) -> FloatArray:
    """Return up to ``count`` goals (G, 2), metres: free floor that is seen."""
    candidates = scene.pool_m[scene.pool_clearance_m > _GOAL_CLEARANCE_M]
    floor = np.column_stack([candidates, np.zeros(len(candidates))])
    candidates = candidates[visible(scene.arrays, scene.camera, floor)]
    chosen = rng.permutation(len(candidates))[:count]
    return np.asarray(candidates[chosen])


def draw_states(
    scene: Scene, field: CostToGo, count: int, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Draw up to ``count`` states for one goal.

    Returns:
        Poses (S, 3), x, y in metres and yaw in radians, world frame; and their :class:`StateKind` (S,).
    """
    distance = np.hypot(*(scene.pool_m - field.goal_m).T)
    usable = field.reachable(scene.pool_m) & (distance > _NEAREST_GOAL_M)
    pool, clearance = scene.pool_m[usable], scene.pool_clearance_m[usable]
    wanted = {kind: round(share * count) for kind, share in SHARES.items()}
    near = _pick(pool[clearance < INSCRIBED_M + NEAR_M], wanted[StateKind.NEAR], rng)
    expert = _near_paths(scene, field, pool, wanted[StateKind.EXPERT], rng)
    anywhere = _pick(pool, count - len(near) - len(expert), rng)
    kinds = [(StateKind.EXPERT, expert), (StateKind.RANDOM, anywhere), (StateKind.NEAR, near)]
    poses = np.concatenate([poses for _, poses in kinds])
    return poses, np.concatenate([np.full(len(poses), kind, dtype=np.uint8) for kind, poses in kinds])


def draw_history(scene: Scene, pose: Pose2, *, frames: int, interval_s: float, rng: np.random.Generator) -> FloatArray:
    """Return a short past (N, 3) of a robot that drove along an arc, the newest pose last.

    Where the arc would have begun in an obstacle, the oldest possible pose is repeated.
    """
    v, w = rng.uniform(0.0, _HISTORY_V_MPS), rng.uniform(-_HISTORY_W_RADPS, _HISTORY_W_RADPS)
    turn = w * interval_s
    reach = v * interval_s * float(np.sinc(turn / math.tau))  # chord of the arc: sin(turn / 2) / (turn / 2)
    now_from_before = Pose2(reach * math.cos(turn / 2), reach * math.sin(turn / 2), turn).inverse()
    poses = [pose]
    for _ in range(frames - 1):
        before = poses[-1] @ now_from_before
        free = scene.grid.clearance_m(np.array(before[:2])) > INSCRIBED_M
        poses.append(before if free else poses[-1])
    return np.array(poses[::-1])


def _pick(points_m: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Return up to ``count`` of the points as poses (S, 3) with random headings."""
    chosen = points_m[rng.permutation(len(points_m))[: max(0, count)]]
    return np.column_stack([chosen, rng.uniform(-math.pi, math.pi, len(chosen))])


def _near_paths(scene: Scene, field: CostToGo, pool_m: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Return up to ``count`` poses (S, 3) beside the expert's ways from a few places."""
    if not len(pool_m):
        return np.empty((0, 3))
    starts = pool_m[rng.integers(len(pool_m), size=_PATHS)]
    places: list[FloatArray] = []
    for start in starts:
        path = field.path(start)
        if len(path) > 2:
            tangent = np.diff(path, axis=0)
            places.append(np.column_stack([path[:-1], np.arctan2(tangent[:, 1], tangent[:, 0])]))
    if not places:
        return np.empty((0, 3))
    poses = np.concatenate(places)
    poses = poses[rng.integers(len(poses), size=4 * count)]
    poses[:, :2] += _OFFSET_M * rng.standard_normal((len(poses), 2))
    poses[:, 2] += _TURN_RAD * rng.standard_normal(len(poses))
    kept = scene.fits(poses[:, :2]) & field.reachable(poses[:, :2])
    kept &= np.hypot(*(poses[:, :2] - field.goal_m).T) > _NEAREST_GOAL_M
    return np.asarray(poses[kept][:count])
