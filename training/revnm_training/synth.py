"""Makes a data set of episodes: training worlds, random cameras, goals, and states labelled by the expert.

Episodes are written in shards that appear whole; a run that was stopped goes on with the shards that miss. The same
seed gives the same data set. Imports neither torch nor PyBullet.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from revnm_client.errors import ConfigError, ContractError
from revnm_client.geometry import FloatArray, Pose2
from revnm_sim.camera import Camera
from revnm_sim.engine import Engine
from revnm_sim.expert.planner import CostToGo, Expert, UnreachableError
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.generation.placement import sample_camera
from revnm_sim.robot import RobotSpec
from revnm_sim.world import World
from revnm_training.episodes import Episode, EpisodeLayout, read_layout, write_episodes
from revnm_training.samples import build_world
from revnm_training.states import Scene, draw_goals, draw_history, draw_states, make_scene

SHARD_EPISODES = 100
WORLDS_PER_SEED = 1_000_000
FAMILIES: Mapping[str, float] = MappingProxyType(
    {"random_pillar": 0.30, "slits": 0.20, "aisles": 0.20, "rooms": 0.20, "demo_room": 0.10}
)
"""Share of the worlds by family."""

_SIZES_PX = ((640, 480), (640, 360))
_HFOV_DEG = (60.0, 120.0)
_ROLL_RAD = math.radians(1.0)
_WIDE_SHARE = 0.4  # the benchmark's camera: 640 × 480 and 120°


@dataclass(frozen=True, slots=True)
class SynthConfig:
    """What to make.

    Attributes:
        out: Folder of the data set.
        episodes: Worlds, each with one camera.
        goals: Goals of an episode.
        states: States of a goal.
        seed: Of everything; data sets of different seeds share no world.
        hidden: Keep states in which the camera does not see the tag, which only a map carries on.
        layout: Lengths of history and labels.
    """

    out: Path
    episodes: int
    goals: int
    states: int
    seed: int
    hidden: bool
    layout: EpisodeLayout


def synthesise(config: SynthConfig, engine: Engine) -> tuple[int, float]:
    """Make the shards that miss; they are written here, wherever they are made.

    Returns:
        Labelled states made now, and the seconds that took.

    Raises:
        ConfigError: The seed or the number of episodes is out of range, the folder holds data of another layout, or the
            engine is not installed.
        LinkError: There is no cluster at the engine's address.
    """
    if not 0 <= config.seed < 1000 or not 1 <= config.episodes <= WORLDS_PER_SEED:
        raise ConfigError(
            f"seed {config.seed}, {config.episodes} episodes: expected 0 to 999 and 1 to {WORLDS_PER_SEED}"
        )
    config.out.mkdir(parents=True, exist_ok=True)
    missing = list(_missing_shards(config))
    started_s, labelled = time.monotonic(), 0
    with tqdm(total=sum(len(numbers) for numbers in missing), desc="synth", unit=" episodes") as bar:
        for numbers, episodes in engine.map(partial(_make_shard, config), missing):
            write_episodes(shard_path(config.out, config.seed, numbers.start), episodes, config.layout)
            labelled += sum(len(episode.goal) for episode in episodes)
            bar.set_postfix(samples_per_s=f"{labelled / (time.monotonic() - started_s):.0f}")
            bar.update(len(numbers))
    return labelled, time.monotonic() - started_s


def _missing_shards(config: SynthConfig) -> Iterator[range]:
    """Yield the numbers of the episodes of each shard that is not there."""
    for first in range(0, config.episodes, SHARD_EPISODES):
        path = shard_path(config.out, config.seed, first)
        if not path.exists():
            yield range(first, min(first + SHARD_EPISODES, config.episodes))
        elif read_layout(path) != config.layout:
            raise ConfigError(f"{path}: made for {read_layout(path)}, now asked for {config.layout}")


def shard_path(out: Path, seed: int, first: int) -> Path:
    """Return the file of the shard that begins with episode number ``first``."""
    return out / f"episodes_{seed:03d}_{first:07d}.parquet"


def _make_shard(config: SynthConfig, numbers: range) -> list[Episode]:
    return [episode for episode in (make_episode(config, number) for number in numbers) if episode is not None]


def make_episode(config: SynthConfig, number: int) -> Episode | None:
    """Make an episode by its number; None where the camera sees no place to go from or to."""
    rng = np.random.default_rng((config.seed, number))
    family = str(rng.choice(list(FAMILIES), p=list(FAMILIES.values())))
    world_seed = TRAINING_SEED_BASE + config.seed * WORLDS_PER_SEED + number
    world = build_world(family, world_seed)
    try:
        camera = draw_camera(world, rng)
    except ContractError:
        return None
    expert = Expert(world)
    scene = make_scene(world, camera, expert.grid, RobotSpec(), rng, hidden=config.hidden)
    goals = draw_goals(scene, config.goals, rng)
    parts = [_label(config, scene, expert, goal, rng) for goal in goals]
    counts = [len(kind) for kind, _, _ in parts]
    if not sum(counts):
        return None
    return Episode(
        family=family,
        world_seed=world_seed,
        camera=camera,
        goals_m=goals,
        goal=np.repeat(np.arange(len(goals)), counts).astype(np.uint8),
        kind=np.concatenate([kind for kind, _, _ in parts]),
        poses=np.concatenate([poses for _, poses, _ in parts]),
        waypoints_m=np.concatenate([waypoints for _, _, waypoints in parts]).astype(np.float32),
    )


def draw_camera(world: World, rng: np.random.Generator) -> Camera:
    """Draw a camera: 60° to 120° wide, 4:3 or 16:9, often the benchmark's, at a place that sees the floor.

    Raises:
        ContractError: No place in the world sees enough of the floor.
    """
    wide = rng.random() < _WIDE_SHARE
    width, height = _SIZES_PX[0] if wide else _SIZES_PX[int(rng.integers(len(_SIZES_PX)))]
    hfov = math.radians(_HFOV_DEG[1] if wide else rng.uniform(*_HFOV_DEG))
    camera = sample_camera(world, rng, width_px=width, height_px=height, hfov_rad=hfov)
    return replace(camera, roll_rad=_ROLL_RAD * rng.standard_normal())


def _label(
    config: SynthConfig, scene: Scene, expert: Expert, goal: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return kinds (S,), poses (S, N, 3) and waypoints (S, H, 2) for a goal, farthest first; none without a way."""
    layout = config.layout
    try:
        field = expert.field(goal)
    except UnreachableError:
        poses, kinds = np.empty((0, 3)), np.empty(0, dtype=np.uint8)
        waypoints = np.empty((0, layout.waypoints, 2))
    else:
        poses, kinds = draw_states(scene, field, config.states, rng)
        waypoints = field.waypoints_batch(poses, count=layout.waypoints, spacing_m=layout.spacing_m)
    valid = np.flatnonzero(np.isfinite(waypoints).all(axis=(1, 2)))
    valid = valid[_farthest_first(field, poses[valid])] if len(valid) else valid
    past = [
        draw_history(scene, Pose2(*pose), frames=layout.history, interval_s=layout.history_interval_s, rng=rng)
        for pose in poses[valid]
    ]
    return kinds[valid], np.array(past).reshape(-1, layout.history, 3), waypoints[valid]


def _farthest_first(field: CostToGo, poses: FloatArray) -> NDArray[np.intp]:
    """Return the order of poses (S, 3) in which a robot would pass them on its way."""
    rest = [field.length_m(pose[:2]) for pose in poses]
    return np.argsort(rest)[::-1]
