"""Runs a bundle's networks as another runtime would, to compare with: one robot after the other, nothing kept.

Other runtimes come in by the entry-point group ``revnm_server.bench_backends``; each is a function that builds a
bundle's networks. The training package has one, PyTorch eager. Their inputs are random: what a network takes does not
depend on them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import cast

import numpy as np
from tqdm import tqdm

from revnm_server.frame import Frame, RobotSighting
from revnm_server.mapping.ego_prior import PRIOR_CHANNELS
from revnm_server.mapping.map_window import LAYERS, WAY_POINTS, WindowSpec
from revnm_server.networks.bundle import Bundle
from revnm_server.observation import ImagePose
from revnm_server.ports import (
    BeliefRequest,
    DisparitySource,
    EgoDepth,
    EgoRequest,
    FloorPolicy,
    Planner,
    PlanRequest,
)

GROUP = "revnm_server.bench_backends"
_LEAST_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class Networks:
    """A bundle's networks in another runtime.

    Attributes:
        note: What runs them, for people: versions, threads.
        depth: The depth network.
        exo2ego: The denoiser with its sampling.
        policy: A :class:`Planner` if the bundle's policy sees the picture, else a :class:`FloorPolicy`.
    """

    note: str
    depth: DisparitySource
    exo2ego: EgoDepth
    policy: Planner | FloorPolicy


Backend = Callable[[Bundle], Networks]


def backends() -> dict[str, EntryPoint]:
    """Return the other runtimes that are installed, by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


def run_networks(
    networks: Networks, bundle: Bundle, *, robots: int, rounds: int, longest_s: float
) -> list[dict[str, float]]:
    """Run what a tick asks of the networks, again and again.

    Args:
        networks: In another runtime.
        bundle: What they are.
        robots: How many ask.
        rounds: That count, at most; one more warms up.
        longest_s: After so long no more begin, if there are three.

    Returns:
        The duration of ``depth``, ``exo2ego`` and ``policy`` in each, milliseconds.
    """
    rng = np.random.default_rng(0)
    frame = Frame(rng.integers(0, 255, (960, 1280, 3), dtype=np.uint8), 0, 0)
    egos = [_ego_request(bundle, number, rng) for number in range(robots)]
    asks = {
        "depth": lambda: networks.depth.disparity(frame),
        "exo2ego": lambda: networks.exo2ego.synthesise(egos),
        "policy": _policy_ask(networks, bundle, egos, rng),
    }
    found: list[dict[str, float]] = []
    begun_s = time.monotonic()
    for number in tqdm(range(1 + rounds), desc=f"{bundle.name}, {robots} robots, {networks.note}", unit=" rounds"):
        taken = {stage: _taken_ms(ask) for stage, ask in asks.items()}
        if number > 0:
            found.append(taken)
        if len(found) >= _LEAST_ROUNDS and time.monotonic() - begun_s > longest_s:
            break
    return found


def _taken_ms(ask: Callable[[], object]) -> float:
    began = time.perf_counter()
    ask()
    return (time.perf_counter() - began) * 1e3


def _policy_ask(
    networks: Networks, bundle: Bundle, egos: Sequence[EgoRequest], rng: np.random.Generator
) -> Callable[[], object]:
    if bundle.sees == "picture":
        planner, plans = cast(Planner, networks.policy), [_plan_request(bundle, ego, rng) for ego in egos]
        return lambda: planner.waypoints(plans)
    policy, beliefs = cast(FloorPolicy, networks.policy), [_belief_request(bundle, rng) for _ in egos]
    return lambda: policy.believe(beliefs)


def _ego_request(bundle: Bundle, number: int, rng: np.random.Generator) -> EgoRequest:
    spec = bundle.spec
    pose = ImagePose(rng.random(2), np.array([1.0, 0.0]))
    crops = rng.random((spec.history, spec.crop_px, spec.crop_px), dtype=np.float32)
    prior = rng.random((PRIOR_CHANNELS, spec.ego_px, spec.ego_px), dtype=np.float32) if bundle.exo2ego.prior else None
    return EgoRequest(f"r{number}", 0, pose, crops, prior)


def _plan_request(bundle: Bundle, ego: EgoRequest, rng: np.random.Generator) -> PlanRequest:
    spec = bundle.spec
    corners = np.zeros((4, 2))
    return PlanRequest(
        robot=ego.robot,
        stamp_ns=0,
        sighting=RobotSighting(ego.robot, 0, np.zeros(2), ego.pose.q_rel, corners),
        pose=ego.pose,
        goal=rng.random(2),
        goal_id="",
        exo=rng.random((spec.history, *spec.exo_hw), dtype=np.float32),
        ego=rng.random((spec.history, spec.ego_px, spec.ego_px), dtype=np.float32),
    )


def _belief_request(bundle: Bundle, rng: np.random.Generator) -> BeliefRequest:
    side, px = WindowSpec().side, bundle.spec.ego_px
    return BeliefRequest(
        rng.random((len(LAYERS), side, side), dtype=np.float32),
        rng.random((WAY_POINTS, 2)),
        rng.random(2),
        rng.random((px, px), dtype=np.float32),
    )
