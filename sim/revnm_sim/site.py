"""A site: a world, and what trials in it need to know beside it.

Imports numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from revnm_client.geometry import Pose2
from revnm_sim.camera import Camera
from revnm_sim.world import World

GOAL_RADIUS_M = 0.5
DETOUR_M = 0.1


class Pair(NamedTuple):
    """Where a trial begins and where it must end.

    Attributes:
        start: ``world_from_robot`` at the beginning.
        goal_m: (x, y) on the floor.
    """

    start: Pose2
    goal_m: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Site:
    """A world and its trials.

    Attributes:
        world: Floor and obstacles.
        where: Where the world comes from, for errors about the whole: ``shop.yaml:4: bounds``, or
            ``world random_pillar, seed 5``.
        goal_radius_m: So near to the goal the robot has arrived.
        detour_m: Of drawn pairs whose straight way is blocked, the shortest way is at least so much longer.
        cameras: The remote cameras; empty where they are drawn.
        pairs: Starts and goals; empty where they are drawn.
        file_sha256: Of the world file, in hexadecimal; empty for generated worlds.
    """

    world: World
    where: str
    goal_radius_m: float = GOAL_RADIUS_M
    detour_m: float = DETOUR_M
    cameras: tuple[Camera, ...] = ()
    pairs: tuple[Pair, ...] = ()
    file_sha256: str = ""
