"""What can be wrong with the cameras and pairs of a site though every number in its file is in range."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from revnm_client.geometry import Pose2
from revnm_server.yaml_document import Place
from revnm_sim.camera import Camera
from revnm_sim.expert.planner import Expert
from revnm_sim.generation.placement import distances_m
from revnm_sim.rays.raycast import visible
from revnm_sim.robot import RobotSpec
from revnm_sim.scenario import tag_seen
from revnm_sim.site import Pair, Site
from revnm_sim.world import FLAT_M, Primitive, Shape, World, primitive_arrays

_CAMERA_CLEAR_M = 0.1
_DRIVEN_UNDER_M = 0.40


def flaws(site: Site) -> Iterator[tuple[Place, str]]:
    """Yield what no trial could run with: the place in the file, and what is wrong there.

    Cameras must be over the floor and 0.1 m clear of everything. The robot must fit at every start, every goal
    must be free floor and farther away than its radius, there must be a way between the two, and every camera must
    see the tag at every start and the floor of every goal.
    """
    for i, camera in enumerate(site.cameras):
        problem = _camera_problem(site.world, camera)
        if problem:
            yield ("cameras", i), problem
    expert = Expert(site.world) if site.pairs else None
    for i, pair in enumerate(site.pairs):
        assert expert is not None
        yield from ((("pairs", i, *key), problem) for key, problem in _pair_problems(site.world, expert, pair))
        start, goal = pair
        if math.hypot(start.x_m - goal[0], start.y_m - goal[1]) <= site.goal_radius_m:
            yield ("pairs", i), f"the start lies within the goal's radius of {site.goal_radius_m:g} m"
        for number, camera in enumerate(site.cameras):
            unseen = _unseen(site.world, camera, pair)
            if unseen:
                yield ("pairs", i, unseen), f"is not seen by cameras[{number}]"


def robot_touches(primitives: tuple[Primitive, ...], pose: Pose2, spec: RobotSpec) -> bool:
    """Tell whether the robot's rectangle at ``world_from_robot`` overlaps anything 0.02 to 0.40 m over the floor."""
    arrays = primitive_arrays(tuple(p for p in primitives if p.bottom_m < _DRIVEN_UNDER_M and p.top_m > FLAT_M))
    robot = np.array([spec.length_m, spec.width_m]) / 2.0
    half = arrays.half_m[:, :2]
    c, s = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
    offset = (arrays.centre_m[:, :2] - (pose.x_m, pose.y_m)) @ np.array([[c, -s], [s, c]])  # in the robot's frame
    outside = np.maximum(np.abs(offset) - robot, 0.0)
    disc = np.hypot(*outside.T) < half[:, 0]
    # Two rectangles are apart if one of the four axes separates them.
    axis = arrays.axis @ np.array([[c, -s], [s, c]])
    x, y = axis[:, :1], axis[:, 1:]
    turn = np.abs(np.stack([np.hstack([x, -y]), np.hstack([y, x])], axis=1))  # (P, 2, 2)
    own = np.abs(np.hstack([x * offset[:, :1] + y * offset[:, 1:], x * offset[:, 1:] - y * offset[:, :1]]))
    box = (np.abs(offset) < robot + np.einsum("pij,pj->pi", turn, half)).all(axis=1)
    box &= (own < half + np.einsum("pji,j->pi", turn, robot)).all(axis=1)
    return bool(np.where(arrays.shape == Shape.CYLINDER, disc, box).any())


def _unseen(world: World, camera: Camera, pair: Pair) -> str | None:
    """Return what of a pair a camera does not see: the tag of a robot at the ``start``, or the ``goal``."""
    arrays, (start, goal) = primitive_arrays(world.obstacles), pair
    if not tag_seen(arrays, camera, np.array([[start.x_m, start.y_m]]), RobotSpec())[0]:
        return "start"
    return None if visible(arrays, camera, np.array([[*goal, 0.0]]))[0] else "goal"


def _camera_problem(world: World, camera: Camera) -> str | None:
    x, y, z = camera.position_m
    bounds = world.bounds
    if z <= 0.0 or not (bounds[0] <= x <= bounds[2] and bounds[1] <= y <= bounds[3]):
        return f"expected a camera over the floor within the bounds, got ({x:g}, {y:g}, {z:g}) m"
    if not world.primitives:
        return None
    distances = distances_m(primitive_arrays(world.primitives), np.array([camera.position_m]))[0]
    nearest = int(distances.argmin())
    if distances[nearest] >= _CAMERA_CLEAR_M:
        return None
    what = _named(world.primitives[nearest])
    if distances[nearest] == 0.0:
        return f"expected a camera {_CAMERA_CLEAR_M} m clear of everything, it is inside {what}"
    return f"expected a camera {_CAMERA_CLEAR_M} m clear of everything, it is {distances[nearest]:.3f} m from {what}"


def _pair_problems(world: World, expert: Expert, pair: Pair) -> Iterator[tuple[Place, str]]:
    """Yield the keys within the pair and what is wrong there; that no way exists only if both ends are right."""
    start, goal = pair
    spec, bounds = RobotSpec(), world.bounds
    x, y = spec.length_m / 2.0, spec.width_m / 2.0
    corners = start.apply(np.array([[x, y], [x, -y], [-x, -y], [-x, y]]))
    inside = (corners >= bounds[:2]) & (corners <= bounds[2:])
    found = False
    if not inside.all():
        yield ("start",), f"expected the robot's {spec.length_m} × {spec.width_m} m within the bounds"
        found = True
    elif robot_touches(world.primitives, start, spec):
        yield ("start",), f"the robot's {spec.length_m} × {spec.width_m} m overlap an obstacle there"
        found = True
    if not (bounds[0] < goal[0] < bounds[2] and bounds[1] < goal[1] < bounds[3]):
        yield ("goal",), "lies outside the bounds"
    elif expert.grid.clearance_m(np.array(goal)) <= 0.0:
        yield ("goal",), f"lies in an obstacle, or within the {expert.grid.resolution_m} m cell of its edge"
    elif not found and not expert.field(goal).reachable(np.array([[start.x_m, start.y_m]]))[0]:
        yield (), "there is no way for the robot from the start to the goal"


def _named(primitive: Primitive) -> str:
    x, y, z = primitive.centre_m
    return f"the {primitive.shape.name.lower()} around ({x:.2f}, {y:.2f}, {z:.2f}) m"
