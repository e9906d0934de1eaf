"""Which trials a benchmark consists of: start–goal pairs × camera poses × repeats (paper, section V-A).

Every draw follows from the seed and the numbers of pair and camera alone, so that any process can make any trial, and
all methods meet the same ones. A generated world gives each pair a world of its own, always one with an evaluation
seed: no training world is among them.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from revnm_client.errors import ConfigError, ContractError
from revnm_client.geometry import FloatArray
from revnm_sim.camera import Camera
from revnm_sim.expert.planner import Expert, UnreachableError
from revnm_sim.expert.route import Route, plan_route
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.generation.placement import sample_camera
from revnm_sim.robot import RobotSpec
from revnm_sim.scenario import Scenario, at_height, sample_pair, tag_points
from revnm_sim.site import Pair, Site
from revnm_sim.worlds import named_site

PairRule = Literal["blocked", "any"]

_ATTEMPTS = 20
_WIDTH_PX, _HEIGHT_PX, _HFOV_RAD = 640, 480, math.radians(120.0)
CAMERA_HEIGHTS_M = (2.0, 3.5)
_DRAWS = {"world": 0, "pair": 1, "cameras": 2, "trial": 3}


@dataclass(frozen=True, slots=True)
class Protocol:
    """How many trials a world gets.

    Attributes:
        pairs: Starts and goals.
        cameras: Poses of the remote camera for each pair.
        repeats: Trials for each pair and camera; they differ in noise alone.
    """

    pairs: int
    cameras: int
    repeats: int


PROTOCOLS = {"default": Protocol(50, 5, 1), "paper": Protocol(10, 5, 5)}


def parse_protocol(text: str) -> Protocol:
    """Return the protocol of a name, or of numbers such as ``20x2x1``.

    Raises:
        ConfigError: It is neither.
    """
    if text in PROTOCOLS:
        return PROTOCOLS[text]
    numbers = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d?)x([1-9]\d?)", text)
    if numbers is None:
        names = ", ".join(PROTOCOLS)
        raise ConfigError(f"--protocol {text}: expected one of {names}, or PAIRSxCAMERASxREPEATS such as 20x2x1")
    return Protocol(*(int(number) for number in numbers.groups()))


def fit_protocol(protocol: Protocol, site: Site) -> Protocol:
    """Return the protocol with the numbers of pairs and cameras that a site itself brings along."""
    return Protocol(len(site.pairs) or protocol.pairs, len(site.cameras) or protocol.cameras, protocol.repeats)


@dataclass(frozen=True, slots=True)
class Setting:
    """One pair in its world, with its cameras.

    Attributes:
        site: Where.
        pair: Start and goal.
        cameras: The remote cameras, each of which sees both.
        route: What the planner knows of the way.
    """

    site: Site
    pair: Pair
    cameras: tuple[Camera, ...]
    route: Route

    def scenario(self, *, camera: int, seed: int) -> Scenario:
        """Return the trial in front of a camera, by its number; the seed decides the noise."""
        return Scenario(
            self.site.world, self.cameras[camera], *self.pair, seed=seed, goal_radius_m=self.site.goal_radius_m
        )


@lru_cache(maxsize=2)
def draw_setting(world: str, *, seed: int, pair: int, cameras: int, rule: PairRule) -> Setting:
    """Draw a pair and the cameras that see it; a site that brings its own pairs or cameras keeps them.

    Drawn pairs are 5 to 10 m apart and reachable; with the rule ``blocked``, the straight way of every one of them is
    blocked for the robot, and the shortest way is longer by the site's ``detour_m``: what takes less of a detour, the
    controller solves by itself, and shows nothing of the method. Drawn cameras are 2.0 to 3.5 m up, 640 × 480, 120°;
    each sees the robot's tag at the start, the floor of the goal, and a quarter of the free floor.

    Args:
        world: Name, or path of a world file.
        seed: Of the benchmark.
        pair: Number of the pair.
        cameras: How many cameras.
        rule: Whether the straight way must be blocked.

    Raises:
        ConfigError: No world has this name.
        FileError: The world's file is malformed.
        ContractError: The world has no such pair, or no cameras that see it; the text says where the world is from.
    """
    for attempt in range(_ATTEMPTS):
        rngs = {name: np.random.default_rng([seed, pair, attempt, number]) for name, number in _DRAWS.items()}
        site = named_site(world, int(rngs["world"].integers(TRAINING_SEED_BASE)))
        found = _draw_pair(site, pair, rngs["pair"], rule)
        if found is None:
            continue
        try:
            seen_by = site.cameras or tuple(_draw_camera(site, found, rngs["cameras"]) for _ in range(cameras))
            return Setting(site, found, seen_by, plan_route(site.world, found))
        except (ContractError, UnreachableError):
            continue
    between = f" with a detour of {site.detour_m} m" if rule == "blocked" else ""
    count = len(site.cameras) or cameras
    raise ContractError(
        f"{site.where}: no start and goal 5 to 10 m apart{between} that the robot can drive between and that "
        f"{'one camera sees' if count == 1 else f'{count} cameras see'}, in {_ATTEMPTS} draws"
    )


def trial_seed(seed: int, *, pair: int, camera: int, repeat: int) -> int:
    """Return what everything random within a trial follows from; the same for all methods and worlds."""
    return int(np.random.default_rng([seed, pair, camera, repeat, _DRAWS["trial"]]).integers(2**31))


def _draw_pair(site: Site, number: int, rng: np.random.Generator, rule: PairRule) -> Pair | None:
    if site.pairs:
        return site.pairs[number]
    detour_m = site.detour_m if rule == "blocked" else 0.0
    return sample_pair(site.world, Expert(site.world), rng, detour_m=detour_m, cameras=site.cameras)


def _draw_camera(site: Site, pair: Pair, rng: np.random.Generator) -> Camera:
    return sample_camera(
        site.world,
        rng,
        width_px=_WIDTH_PX,
        height_px=_HEIGHT_PX,
        hfov_rad=_HFOV_RAD,
        height_range_m=CAMERA_HEIGHTS_M,
        points_m=_must_see(pair),
    )


def _must_see(pair: Pair) -> FloatArray:
    """Return (6, 3), metres: the tag of a robot at the start, and the goal."""
    start = np.array([[pair.start.x_m, pair.start.y_m]])
    return np.concatenate([tag_points(start, RobotSpec())[0], at_height(np.array([pair.goal_m]), 0.0)])
