"""A data set of episodes, rendered for the map policy and for exo2ego with its prior.

Symbols: M samples, side of the window, P points of the way, H waypoints, e side of the ego picture, c of the crop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revnm_server.mapping.map_window import LAYERS, WAY_POINTS, WindowSpec
from revnm_server.observation import Image32, ObservationSpec
from revnm_training.cache import Arrays, Block, Column, fill_cache
from revnm_training.episodes import read_episodes
from revnm_training.map_samples import (
    COST_RANGE_M,
    COST_STRIDE,
    MapEpisodeRenderer,
    MapSample,
)
from revnm_training.map_scene import MapFaults
from revnm_training.preset import Preset
from revnm_training.render_device import RenderDevice, depth_caster
from revnm_training.sample_cache import SampleBlock, data_files, plan_blocks, render_samples, to_bytes
from revnm_training.sample_set import SampleSet, sample_set

FORMAT = 1
UNREACHED = 255
_COST_STEPS = 254


@dataclass(frozen=True, slots=True)
class MapSampleRenderer:
    """Renders blocks of episodes; see :class:`revnm_training.cache.Renderer`."""

    spec: ObservationSpec
    faults: MapFaults
    seed: int
    sources: tuple[SampleBlock, ...]
    first_episode: tuple[int, ...]
    device: RenderDevice

    def __call__(self, block: Block) -> Arrays:
        """Return the columns of a block."""
        source, cast = self.sources[block.index], depth_caster(self.device)
        _, episodes = read_episodes(source.path)
        samples: list[MapSample] = []
        owners: list[int] = []
        for offset, episode in enumerate(episodes[source.first : source.first + source.count]):
            number = self.first_episode[block.index] + offset
            rng = np.random.default_rng((self.seed, number))
            samples += MapEpisodeRenderer(episode, self.spec, self.faults, rng, cast).samples()
            owners += [number] * (len(samples) - len(owners))
        return _pack(samples, owners)


def rendered(preset: Preset, data: Path, folder: Path, *, jobs: int, device: RenderDevice) -> SampleSet:
    """Render what the networks of a preset see of a data set, or open it where that is done.

    Raises:
        FileError: An episode file is missing or malformed.
        ConfigError: The episodes are labelled for another observation, or the cache is of another recipe.
    """
    if preset.map_policy is None:
        return render_samples(data, folder, preset.observation, jobs=jobs, device=device)
    return render_map_samples(data, folder, preset.observation, jobs=jobs, device=device)


def render_map_samples(
    data: Path,
    folder: Path,
    spec: ObservationSpec,
    *,
    jobs: int,
    device: RenderDevice = "cpu",
    seed: int = 0,
    faults: MapFaults | None = None,
) -> SampleSet:
    """Render a data set into a cache, or open it where that is done.

    Columns: ``map`` (M, 4, side, side), ``crop`` (M, 1, c, c), ``prior`` (M, 2, e, e) and ``ego`` (M, 1, e, e) uint8,
    0 to 255 for [0, 1], of depths for [−1, 1]; ``occupied`` (M, side · side / 8) bits; ``cost`` (M, side / 2, side / 2)
    uint8, 0 to 254 for ± 8 m, 255 where there is no way; ``way`` (M, P, 2), ``aim``, ``robot`` and ``heading`` (M, 2)
    and ``waypoints`` (M, H, 2) float32; ``episode`` (M,) int32.

    Args:
        data: Folder of episodes.
        folder: Folder of the cache.
        spec: What the networks see.
        jobs: Processes.
        device: Casts ego depth.
        seed: Of the errors.
        faults: How wrong maps are; their defaults where None.

    Raises:
        FileError: An episode file is missing or malformed.
        ConfigError: The episodes are labelled for another observation, or the cache is of another recipe.
    """
    files, errors, side = data_files(data), faults or MapFaults(), WindowSpec().side
    sources, first_episode, blocks = plan_blocks(files, spec)
    columns = {
        "map": Column("uint8", (len(LAYERS), side, side)),
        "occupied": Column("uint8", (side * side // 8,)),
        "cost": Column("uint8", (side // COST_STRIDE, side // COST_STRIDE)),
        "crop": Column("uint8", (1, spec.crop_px, spec.crop_px)),
        "prior": Column("uint8", (2, spec.ego_px, spec.ego_px)),
        "ego": Column("uint8", (1, spec.ego_px, spec.ego_px)),
        "way": Column("float32", (WAY_POINTS, 2)),
        "aim": Column("float32", (2,)),
        "robot": Column("float32", (2,)),
        "heading": Column("float32", (2,)),
        "waypoints": Column("float32", (spec.waypoints, 2)),
        "episode": Column("int32", ()),
    }
    recipe = {
        "format": FORMAT,
        "files": [[path.name, path.stat().st_size] for path in files],
        "observation": asdict(spec),
        "faults": asdict(errors),
        "seed": seed,
    }
    render = MapSampleRenderer(spec, errors, seed, tuple(sources), tuple(first_episode), device)
    arrays = fill_cache(folder, recipe=recipe, columns=columns, blocks=blocks, render=render, jobs=jobs)
    return sample_set(folder, arrays)


def _pack(samples: Sequence[MapSample], owners: Sequence[int]) -> dict[str, NDArray[Any]]:
    prior = np.stack([s.prior for s in samples])
    prior[:, 0] = (prior[:, 0] + 1.0) / 2.0
    return {
        "map": to_bytes(np.stack([s.layers for s in samples])),
        "occupied": np.packbits(np.stack([s.occupied.ravel() for s in samples]), axis=1),
        "cost": _cost_bytes(np.stack([s.cost for s in samples])),
        "crop": to_bytes(np.stack([s.crop for s in samples])[:, None]),
        "prior": to_bytes(prior),
        "ego": to_bytes((np.stack([s.ego for s in samples])[:, None] + 1.0) / 2.0),
        "way": np.stack([s.way for s in samples]),
        "aim": np.stack([s.goal for s in samples]),
        "robot": np.stack([s.robot for s in samples]),
        "heading": np.stack([s.heading for s in samples]),
        "waypoints": np.stack([s.waypoints for s in samples]),
        "episode": np.array(owners),
    }


def _cost_bytes(cost: Image32) -> NDArray[np.uint8]:
    reached = np.isfinite(cost)
    share = 0.5 + 0.5 * np.where(reached, cost, 0.0) / COST_RANGE_M
    return np.where(reached, np.rint(share * _COST_STEPS), UNREACHED).astype(np.uint8)
