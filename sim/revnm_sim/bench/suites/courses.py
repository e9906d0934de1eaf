"""Courses for the controller: places where driving well is hard although the plan is right, drawn by seed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from revnm_client.errors import ContractError
from revnm_client.geometry import Pose2
from revnm_sim.bench.suites.walker import Walk
from revnm_sim.expert.planner import Expert
from revnm_sim.generation.features import Part
from revnm_sim.generation.generator import TRAINING_SEED_BASE, random_pillar
from revnm_sim.generation.room_builder import RoomBuilder
from revnm_sim.scenario import sample_pair
from revnm_sim.site import DETOUR_M, Pair
from revnm_sim.world import Shape, World

SLIT_M = 0.6
_ATTEMPTS = 20
_HEIGHT_M = 1.0
_ROBOT_MPS = 0.5
_SET_OUT_S = 0.9  # what the robot loses by waiting for its first plan and by speeding up

Rng = np.random.Generator


@dataclass(frozen=True, slots=True)
class Course:
    """A place to drive.

    Attributes:
        world: What stands there.
        pair: Start and goal.
        walk: Of the walker, of whom the planner knows nothing; None where there is none.
    """

    world: World
    pair: Pair
    walk: Walk | None = None


def draw_course(name: str, *, seed: int, number: int) -> Course:
    """Return a course; each number gives another one.

    Args:
        name: One of :data:`COURSES`.
        seed: Of the benchmark.
        number: Of the course among those of its name.

    Raises:
        ContractError: No draw had a start and a goal.
    """
    return COURSES[name](np.random.default_rng([seed, number, list(COURSES).index(name)]))


def random_scene(rng: Rng) -> Course:
    """Return an evaluation world of random pillars and walls with something in the straight way to the goal.

    Raises:
        ContractError: No draw had a start and a goal.
    """
    for _ in range(_ATTEMPTS):
        world = random_pillar(int(rng.integers(TRAINING_SEED_BASE)))
        pair = sample_pair(world, Expert(world), rng, detour_m=DETOUR_M)
        if pair is not None:
            return Course(world, pair)
    raise ContractError(f"no start and goal 5 to 10 m apart in {_ATTEMPTS} random scenes")


def slalom(rng: Rng) -> Course:
    """Return a hall of four barriers with gaps of 0.8 to 1.1 m on alternating sides, 1.3 to 1.8 m apart."""
    count, pitch_m, width_m = 4, rng.uniform(1.3, 1.8), rng.uniform(2.4, 3.0)
    builder = _room(rng, count * pitch_m + 2.0, width_m)
    side = float(rng.choice([-1.0, 1.0]))
    for number in range(count):
        length_m = width_m - rng.uniform(0.8, 1.1)
        x, y = (number - (count - 1) / 2.0) * pitch_m, side * (width_m - length_m) / 2.0
        builder.stand([Part(Shape.BOX, x, y, 0.0, rng.uniform(0.1, 0.3), length_m)], Pose2(0.0, 0.0, 0.0), _HEIGHT_M)
        side = -side
    end_m = builder.half_m[0] - 0.6
    start = Pose2(-end_m, rng.uniform(-0.4, 0.4), rng.uniform(-0.5, 0.5))
    return Course(builder.world("slalom"), Pair(start, (end_m, rng.uniform(-0.4, 0.4))))


def slit(rng: Rng) -> Course:
    """Return a room cut by a wall, up to 0.3 rad askew, whose only opening is 0.6 m wide and 0.05 to 0.4 m deep.

    The world frame's origin is in the opening.
    """
    builder = _room(rng, rng.uniform(6.0, 8.0), rng.uniform(4.0, 5.0))
    thick_m, length_m = rng.uniform(0.05, 0.4), 2.0 * builder.half_m[1]
    y = (SLIT_M + length_m) / 2.0
    wall = [Part(Shape.BOX, 0.0, side * y, 0.0, thick_m, length_m) for side in (-1.0, 1.0)]
    builder.stand(wall, Pose2(0.0, 0.0, rng.uniform(-0.3, 0.3)), _HEIGHT_M)
    aside_m = builder.half_m[1] - 0.6
    start, goal = ((sign * rng.uniform(1.6, 2.4), rng.uniform(-aside_m, aside_m)) for sign in (-1.0, 1.0))
    return Course(builder.world("slit"), Pair(Pose2(*start, rng.uniform(-math.pi, math.pi)), goal))


def dead_end(rng: Rng) -> Course:
    """Return a room with a pocket 0.9 to 1.4 m wide; the robot faces its closed end, the goal lies beyond that.

    The world frame's origin is on the inner face of the closed end, x leads out of the pocket's back.
    """
    builder = _room(rng, 8.0, 7.0)
    thick_m, width_m, depth_m = rng.uniform(0.08, 0.3), rng.uniform(0.9, 1.4), rng.uniform(0.9, 1.8)
    y = (width_m + thick_m) / 2.0
    pocket = [Part(Shape.BOX, thick_m / 2.0, 0.0, 0.0, thick_m, width_m + 2.0 * thick_m)]
    pocket += [Part(Shape.BOX, -depth_m / 2.0, side * y, 0.0, depth_m, thick_m) for side in (-1.0, 1.0)]
    builder.stand(pocket, Pose2(0.0, 0.0, 0.0), _HEIGHT_M)
    start = Pose2(-rng.uniform(0.45, 0.7), rng.uniform(-0.05, 0.05), rng.uniform(-0.3, 0.3))
    goal = (thick_m + rng.uniform(0.6, 2.0), rng.uniform(-0.8, 0.8))
    return Course(builder.world("dead_end"), Pair(start, goal))


def crossing(rng: Rng) -> Course:
    """Return an empty room in which a walker of 0.3 to 0.8 m/s crosses the robot's way, up to 35° askew.

    Left alone, both would be where their ways cross at times up to 1 s apart.
    """
    builder = _room(rng, rng.uniform(8.5, 9.5), rng.uniform(7.0, 8.0))
    start, goal = Pose2(-3.2, rng.uniform(-0.5, 0.5), 0.0), (3.2, rng.uniform(-0.5, 0.5))
    share = rng.uniform(0.35, 0.65)
    x, y = start.x_m + share * (goal[0] - start.x_m), start.y_m + share * (goal[1] - start.y_m)
    meet_s = math.hypot(x - start.x_m, y - start.y_m) / _ROBOT_MPS + _SET_OUT_S + rng.uniform(-1.0, 1.0)
    angle, speed = rng.choice([-1.0, 1.0]) * (math.pi / 2.0 + rng.uniform(-0.6, 0.6)), rng.uniform(0.3, 0.8)
    edge_m, up = builder.half_m[1] - 0.4, math.sin(angle)
    before_m = min((edge_m + math.copysign(1.0, up) * y) / abs(up), speed * meet_s)
    after_m = (edge_m - math.copysign(1.0, up) * y) / abs(up)
    walk = Walk(
        from_m=(x - before_m * math.cos(angle), y - before_m * up),
        to_m=(x + after_m * math.cos(angle), y + after_m * up),
        speed_mps=speed,
        begin_s=meet_s - before_m / speed,
    )
    return Course(builder.world("crossing"), Pair(start, goal), walk)


COURSES: Mapping[str, Callable[[Rng], Course]] = MappingProxyType(
    {"random": random_scene, "slalom": slalom, "slit": slit, "dead_end": dead_end, "crossing": crossing}
)


def _room(rng: Rng, width_m: float, depth_m: float) -> RoomBuilder:
    builder = RoomBuilder(rng, width_m=width_m, depth_m=depth_m)
    builder.outer_walls(height_m=2.5)
    return builder
