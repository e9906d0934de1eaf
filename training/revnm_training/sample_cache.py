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
from revnm_training.render_device import RenderDevice, depth_caster
from revnm_training.sample_set import SampleSet, sample_set
from revnm_training.samples import EpisodeRenderer, Sample

FORMAT = 1
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
    device: RenderDevice

    def __call__(self, block: Block) -> Arrays:
        """Return the columns of a block."""
        source, cast = self.sources[block.index], depth_caster(self.device)
        _, episodes = read_episodes(source.path)
        samples: list[Sample] = []
        owners: list[int] = []
        for offset, episode in enumerate(episodes[source.first : source.first + source.count]):
            number = self.first_episode[block.index] + offset
            rng = np.random.default_rng((self.seed, number))
            renderer = EpisodeRenderer(episode, self.spec, cast=cast)
            samples += [renderer.sample(s, rng, self.disturbance) for s in range(len(episode.goal))]
            owners += [number] * len(episode.goal)
        return _pack(samples, owners)


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
    data: Path,
    folder: Path,
    spec: ObservationSpec,
    *,
    jobs: int,
    device: RenderDevice = "cpu",
    seed: int = 0,
    disturbance: Disturbance | None = None,
) -> SampleSet:
    """Render a data set into a cache, or open it where that is done.

    Args:
        data: Folder of episodes.
        folder: Folder of the cache.
        spec: What the networks see.
        jobs: Processes.
        device: Casts ego depth.
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
    render = SampleRenderer(spec, errors, seed, tuple(sources), tuple(first_episode), device)
    arrays = fill_cache(folder, recipe=recipe, columns=columns, blocks=blocks, render=render, jobs=jobs)
    return sample_set(folder, arrays)


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
