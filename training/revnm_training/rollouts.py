"""Drives a bundle through training worlds in the simulator and lets the expert label what it met.

Rollouts are written in shards, a file of episodes and one of outcomes, which appear whole; a run that was stopped goes
on with the shards that miss.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from tqdm import tqdm

from revnm_client.errors import ContractError, FileError
from revnm_client.geometry import FloatArray
from revnm_sim.bench.methods import Perception
from revnm_sim.bench.metrics import spl
from revnm_sim.bench.trial import CONTROL_S, Trial, TrialKey, TrialResult
from revnm_sim.engine import Engine
from revnm_sim.expert.planner import Expert, UnreachableError
from revnm_sim.expert.route import Route, plan_route
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.scenario import Scenario, sample_pair
from revnm_training.episodes import Episode, EpisodeLayout, write_episodes
from revnm_training.samples import build_world
from revnm_training.synth import FAMILIES, WORLDS_PER_SEED, draw_camera
from revnm_training.visited import choose_visited

SHARD_ROLLOUTS = 10
_DETOUR_M = 0.3  # what takes less of a detour, the controller solves by itself
_ATTEMPTS = 20


@dataclass(frozen=True, slots=True)
class RolloutConfig:
    """What to drive.

    Attributes:
        out: Folder of the shards.
        bundle: Folder of the model bundle that drives.
        perception: Where its depth comes from.
        rollouts: Drives, each in a world of its own.
        states: Labelled states of a drive, at most.
        seed: Of worlds and drives, 0 to 999; data sets of other seeds share no world.
        layout: Lengths of history and labels.
    """

    out: Path
    bundle: Path
    perception: Perception
    rollouts: int
    states: int
    seed: int
    layout: EpisodeLayout


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a drive went.

    Attributes:
        family: Of its world.
        success: At the goal in time and without contact.
        collision: Touched something.
        spl: Success weighted by the expert's way over the driven one.
        states: How many of its states were labelled.
    """

    family: str
    success: bool
    collision: bool
    spl: float
    states: int


Drive = tuple[Episode | None, Outcome]
"""The states that the expert labelled, None where there are none, and the outcome."""


def roll_out(config: RolloutConfig, *, jobs: int) -> list[Outcome]:
    """Make the shards that miss, and return the outcomes of all drives.

    Raises:
        FileError: The bundle does not fit, or a file of outcomes is damaged.
    """
    config.out.mkdir(parents=True, exist_ok=True)
    shards = [
        range(first, min(first + SHARD_ROLLOUTS, config.rollouts))
        for first in range(0, config.rollouts, SHARD_ROLLOUTS)
    ]
    missing = [numbers for numbers in shards if not _outcomes_path(config, numbers).exists()]
    with tqdm(total=sum(map(len, missing)), desc="roll out", unit=" drives") as bar:
        for numbers, drives in Engine("local", jobs).map(partial(_drive_shard, config), missing):
            _write_shard(config, _outcomes_path(config, numbers), drives)
            bar.update(len(numbers))
    return [outcome for numbers in shards for outcome in _read_outcomes(_outcomes_path(config, numbers))]


def drive(config: RolloutConfig, number: int) -> Drive | None:
    """Drive once, by its number.

    Returns:
        The drive, or None where the world has no pair of start and goal that its camera sees.
    """
    rng = np.random.default_rng((config.seed, number))
    family = str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))
    world_seed = TRAINING_SEED_BASE + config.seed * WORLDS_PER_SEED + number
    drawn = _draw_scenario(family, world_seed, rng)
    if drawn is None:
        return None
    scenario, route = drawn
    trial = Trial(scenario, route, _key(config, family, number))
    result = trial.run()
    episode = _label(config, scenario, route, trial.poses, rng, family=family, world_seed=world_seed)
    return episode, _outcome(family, result, 0 if episode is None else len(episode.goal))


def _drive_shard(config: RolloutConfig, numbers: range) -> list[Drive]:
    return [found for found in (drive(config, number) for number in numbers) if found is not None]


def _write_shard(config: RolloutConfig, path: Path, drives: Sequence[Drive]) -> None:
    episodes = [episode for episode, _ in drives if episode is not None]
    if episodes:
        write_episodes(path.with_suffix(".parquet"), episodes, config.layout)
    partial_file = path.with_name(f".{path.name}.{os.getpid()}.partial")
    partial_file.write_text(json.dumps([asdict(outcome) for _, outcome in drives]), encoding="utf-8")
    partial_file.replace(path)


def _draw_scenario(family: str, world_seed: int, rng: np.random.Generator) -> tuple[Scenario, Route] | None:
    world = build_world(family, world_seed)
    expert = Expert(world)
    for _ in range(_ATTEMPTS):
        try:
            camera = draw_camera(world, rng)
            pair = sample_pair(world, expert, rng, detour_m=_DETOUR_M, cameras=(camera,))
            if pair is not None:
                return Scenario(world, camera, *pair, seed=int(rng.integers(2**31))), plan_route(world, pair)
        except (ContractError, UnreachableError):
            continue
    return None


def _key(config: RolloutConfig, family: str, number: int) -> TrialKey:
    return TrialKey(
        world=family,
        method="revnm",
        perception=config.perception,
        seed=config.seed,
        pair=number,
        camera=0,
        repeat=0,
        cameras=1,
        rule="blocked",
        world_sha256="",
        bundle=str(config.bundle),
        manifest_sha256="",
    )


def _label(
    config: RolloutConfig,
    scenario: Scenario,
    route: Route,
    poses: FloatArray,
    rng: np.random.Generator,
    *,
    family: str,
    world_seed: int,
) -> Episode | None:
    layout = config.layout
    numbers, kinds = choose_visited(poses, route.field, config.states, rng, interval_s=CONTROL_S)
    waypoints = route.field.waypoints_batch(poses[numbers], count=layout.waypoints, spacing_m=layout.spacing_m)
    valid = np.isfinite(waypoints).all(axis=(1, 2))
    if not valid.any():
        return None
    step = round(layout.history_interval_s / CONTROL_S)
    past = numbers[valid, None] - step * np.arange(layout.history)[::-1]
    return Episode(
        family=family,
        world_seed=world_seed,
        camera=scenario.camera,
        goals_m=np.array([scenario.goal_m]),
        goal=np.zeros(int(valid.sum()), dtype=np.uint8),
        kind=kinds[valid],
        poses=poses[np.maximum(past, 0)],
        waypoints_m=waypoints[valid].astype(np.float32),
    )


def _outcome(family: str, result: TrialResult, states: int) -> Outcome:
    weighted = float(spl([result], length=lambda r: r.expert_m)[0])
    return Outcome(family, result.success, result.collision, round(weighted, 4), states)


def _outcomes_path(config: RolloutConfig, numbers: range) -> Path:
    return config.out / f"drives_{config.seed:03d}_{numbers.start:07d}.json"


def _read_outcomes(path: Path) -> list[Outcome]:
    try:
        return [Outcome(**row) for row in json.loads(path.read_text(encoding="utf-8"))]
    except (ValueError, TypeError) as error:
        raise FileError(f"{path}: no outcomes of drives: {error}: delete it, and it is made again") from error
