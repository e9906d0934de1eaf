"""Rendered samples of one or several data sets, split into those to train on and held-out worlds.

Symbols: M samples, N frames of history, H waypoints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revnm_training.cache import Arrays

VALIDATION_SHARE = 0.03


@dataclass(frozen=True, slots=True)
class DataSource:
    """A data set.

    Attributes:
        data: Folder of episodes.
        cache: Folder for what is rendered of them.
        repeat: How often its training samples count, beside those of other sources.
    """

    data: Path
    cache: Path
    repeat: int = 1


class JoinedColumn:
    """Columns (M, …) of several sample sets as one."""

    def __init__(self, parts: Sequence[Rows]) -> None:
        self._parts = tuple(parts)
        self._ends = np.cumsum([len(part) for part in parts])
        self.shape: tuple[int, ...] = (int(self._ends[-1]), *parts[0].shape[1:])

    def __len__(self) -> int:
        """Return M."""
        return self.shape[0]

    def __getitem__(self, index: NDArray[np.int64]) -> NDArray[Any]:
        """Return a copy of the items with numbers (K,), ascending."""
        cuts = np.searchsorted(index, self._ends)
        starts = np.concatenate([[0], self._ends[:-1]])
        chosen = np.split(index, cuts[:-1])
        return np.concatenate([part[i - start] for part, i, start in zip(self._parts, chosen, starts, strict=True)])


Rows = NDArray[Any] | JoinedColumn
"""A column, or several as one."""


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
        worlds: How many there are.
    """

    folder: Path
    columns: Mapping[str, Rows]
    train: NDArray[np.int64]
    validation: NDArray[np.int64]
    worlds: int

    def describe(self) -> dict[str, Any]:
        """Return the numbers of samples and worlds, for records."""
        return {
            "train_samples": len(self.train),
            "validation_samples": len(self.validation),
            "worlds": self.worlds,
        }


def join(sets: Sequence[SampleSet], repeats: Sequence[int]) -> SampleSet:
    """Return several sample sets as one, in the first one's folder.

    Args:
        sets: Each keeps its own held-out samples.
        repeats: How often the training samples of each are in it.
    """
    starts = np.concatenate([[0], np.cumsum([len(each.columns["waypoints"]) for each in sets])])[:-1]
    columns = {name: JoinedColumn([each.columns[name] for each in sets]) for name in sets[0].columns}
    return SampleSet(
        sets[0].folder,
        columns,
        np.concatenate([np.tile(each.train + s, n) for each, s, n in zip(sets, starts, repeats, strict=True)]),
        np.concatenate([each.validation + s for each, s in zip(sets, starts, strict=True)]),
        sum(each.worlds for each in sets),
    )


def sample_set(folder: Path, columns: Arrays) -> SampleSet:
    """Return rendered columns as a set: the last 3 % of the worlds, at least one, are held out."""
    episode = np.asarray(columns["episode"])
    numbers = np.unique(episode)
    held_out = max(1, round(VALIDATION_SHARE * len(numbers)))
    is_held_out = episode >= numbers[-held_out]
    return SampleSet(folder, columns, np.flatnonzero(~is_held_out), np.flatnonzero(is_held_out), len(numbers))
