"""A data set of episodes, rendered for the policy and for exo2ego.

Symbols: M samples, N frames of history, H waypoints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ConfigError, FileError
from revnm_server.observation import ObservationSpec
from revnm_training.augment import Disturbance
from revnm_training.cache import Arrays, Block, Column, fill_cache
from revnm_training.episodes import layout_of, read_episodes, read_layout
from revnm_training.samples import EpisodeRenderer, Sample

FORMAT = 1
VALIDATION_SHARE = 0.03
_EPISODES_PER_BLOCK = 25


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Which episodes of which file a block holds."""

    path: Path
    first: int
    count: int


@dataclass(frozen=True, slots=True)
class SampleRenderer:
    """Renders blocks of episodes; see :class:`revnm_training.cache.Renderer`."""

    spec: ObservationSpec
    disturbance: Disturbance
    seed: int
    sources: tuple[SampleBlock, ...]
    first_episode: tuple[int, ...]

    def __call__(self, block: Block) -> Arrays:
        """Return the columns of a block."""
        source = self.sources[block.index]
        _, episodes = read_episodes(source.path)
        samples: list[Sample] = []
        owners: list[int] = []
        for offset, episode in enumerate(episodes[source.first : source.first + source.count]):
            number = self.first_episode[block.index] + offset
            rng = np.random.default_rng((self.seed, number))
            renderer = EpisodeRenderer(episode, self.spec)
            samples += [renderer.sample(s, rng, self.disturbance) for s in range(len(episode.goal))]
            owners += [number] * len(episode.goal)
        return _pack(samples, owners)


@dataclass(frozen=True, slots=True)
class SampleSet:
    """Rendered samples, memory-mapped.

    Attributes:
        folder: Where they live.
        columns: By name: ``exo`` (M, N, h, w), ``crop`` (M, N, c, c) and ``ego`` (M, N, e, e) uint8, 0 to 255 for
            [0, 1], of ``ego`` for [−1, 1]; ``robot``, ``heading``, ``goal`` (M, 2) and ``waypoints`` (M, H, 2)
            float32; ``episode`` (M,) int32.
        train: Numbers of the samples to train on.
        validation: Numbers of held-out samples: of other worlds.
    """

    folder: Path
    columns: dict[str, NDArray[Any]]
    train: NDArray[np.int64]
    validation: NDArray[np.int64]

    def describe(self) -> dict[str, Any]:
        """Return the numbers of samples and worlds, for records."""
        episode = self.columns["episode"]
        return {
            "train_samples": len(self.train),
            "validation_samples": len(self.validation),
            "worlds": len(np.unique(episode)),
        }


def data_files(folder: Path) -> list[Path]:
    """Return the episode files of a data set, in order.

    Raises:
        FileError: There is none.
    """
    files = sorted(folder.glob("*.parquet"))
    if not files:
        raise FileError(f"{folder}: no episodes (*.parquet): make some with revnm-train synth")
    return files


def render_samples(
    data: Path, folder: Path, spec: ObservationSpec, *, jobs: int, seed: int = 0, disturbance: Disturbance | None = None
) -> SampleSet:
    """Render a data set into a cache, or open it where that is done.

    Args:
        data: Folder of episodes.
        folder: Folder of the cache.
        spec: What the networks see.
        jobs: Processes.
        seed: Of the disturbances.
        disturbance: Errors of depth network and tag detector; their defaults where None.

    Raises:
        FileError: An episode file is missing or malformed.
        ConfigError: The episodes are labelled for another observation, or the cache is of another recipe.
    """
    files, errors = data_files(data), disturbance or Disturbance()
    sources, first_episode, blocks = plan_blocks(files, spec)
    columns = {
        "exo": Column("uint8", (spec.history, *spec.exo_hw)),
        "crop": Column("uint8", (spec.history, spec.crop_px, spec.crop_px)),
        "ego": Column("uint8", (spec.history, spec.ego_px, spec.ego_px)),
        "robot": Column("float32", (2,)),
        "heading": Column("float32", (2,)),
        "goal": Column("float32", (2,)),
        "waypoints": Column("float32", (spec.waypoints, 2)),
        "episode": Column("int32", ()),
    }
    recipe = {
        "format": FORMAT,
        "files": [[path.name, path.stat().st_size] for path in files],
        "observation": asdict(spec),
        "disturbance": asdict(errors),
        "seed": seed,
    }
    render = SampleRenderer(spec, errors, seed, tuple(sources), tuple(first_episode))
    arrays = fill_cache(folder, recipe=recipe, columns=columns, blocks=blocks, render=render, jobs=jobs)
    train, validation = split(np.asarray(arrays["episode"]))
    return SampleSet(folder, arrays, train, validation)


def split(episode: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split samples by their episodes: the last 3 % of the worlds, at least one, are held out."""
    numbers = np.unique(episode)
    held_out = max(1, round(VALIDATION_SHARE * len(numbers)))
    is_held_out = episode >= numbers[-held_out]
    return np.flatnonzero(~is_held_out), np.flatnonzero(is_held_out)


def plan_blocks(files: Sequence[Path], spec: ObservationSpec) -> tuple[list[SampleBlock], list[int], list[Block]]:
    """Cut files into blocks of episodes.

    Returns:
        What each block holds, the number of its first episode, and which samples it fills.

    Raises:
        FileError: A file is malformed.
        ConfigError: It is labelled for another observation.
    """
    sources: list[SampleBlock] = []
    first_episode: list[int] = []
    blocks: list[Block] = []
    start = number = 0
    for path in files:
        if read_layout(path) != layout_of(spec):
            raise ConfigError(f"{path}: labelled for {read_layout(path)}, but the preset asks for {layout_of(spec)}")
        _, episodes = read_episodes(path)
        for first in range(0, len(episodes), _EPISODES_PER_BLOCK):
            part = episodes[first : first + _EPISODES_PER_BLOCK]
            stop = start + sum(len(episode.goal) for episode in part)
            sources.append(SampleBlock(path, first, len(part)))
            first_episode.append(number)
            blocks.append(Block(len(blocks), start, stop))
            start, number = stop, number + len(part)
    return sources, first_episode, blocks


def _pack(samples: Sequence[Sample], owners: Sequence[int]) -> dict[str, NDArray[Any]]:
    return {
        "exo": to_bytes(np.stack([s.exo for s in samples])),
        "crop": to_bytes(np.stack([s.crop for s in samples])),
        "ego": to_bytes((np.stack([s.ego for s in samples]) + 1.0) / 2.0),
        "robot": np.stack([s.robot for s in samples]),
        "heading": np.stack([s.heading for s in samples]),
        "goal": np.stack([s.goal for s in samples]),
        "waypoints": np.stack([s.waypoints for s in samples]),
        "episode": np.array(owners),
    }


def to_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Map [0, 1] to 0 … 255."""
    return np.asarray(np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8))
