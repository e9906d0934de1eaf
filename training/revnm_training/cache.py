"""Rendered data kept as arrays on disk while networks train; made once by several processes, never committed.

Rendering first and training afterwards leaves both cores to the network. A cache is made block by block; an
interrupted one goes on with the blocks that miss.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import joblib
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from revnm_client.errors import ConfigError

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class Column:
    """One array of a cache.

    Attributes:
        dtype: Its numpy type, by name.
        shape: Shape of one item.
    """

    dtype: str
    shape: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Block:
    """Items that are rendered in one go: number ``index``, items ``start`` to ``stop``, the latter excluded."""

    index: int
    start: int
    stop: int


class Renderer(Protocol):
    """Renders blocks in another process, so it must be picklable."""

    def __call__(self, block: Block) -> Arrays:
        """Return every column's items of a block."""
        ...


def fill_cache(
    folder: Path,
    *,
    recipe: Mapping[str, Any],
    columns: Mapping[str, Column],
    blocks: Sequence[Block],
    render: Renderer,
    jobs: int,
) -> dict[str, NDArray[Any]]:
    """Render what is missing of a cache and open it.

    Args:
        folder: Where it lives.
        recipe: What it is made from, JSON-able; a cache of another recipe is refused.
        columns: Its arrays.
        blocks: Its parts, together all items.
        render: Renders one part.
        jobs: Processes.

    Returns:
        The arrays by column, memory-mapped, read-only.

    Raises:
        ConfigError: The folder holds a cache of another recipe.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _check_recipe(folder, recipe)
    for name, column in columns.items():
        path = folder / f"{name}.npy"
        if not path.exists():
            shape = (blocks[-1].stop, *column.shape)
            np.lib.format.open_memmap(path, mode="w+", dtype=column.dtype, shape=shape).flush()
    missing = [block for block in blocks if not _marker(folder, block).exists()]
    items = sum(block.stop - block.start for block in missing)
    with tqdm(total=items, desc=f"render {folder.name}", unit=" samples", disable=not missing) as bar:
        tasks = (joblib.delayed(_fill_block)(folder, block, render) for block in missing)
        for count in joblib.Parallel(n_jobs=jobs, return_as="generator_unordered", batch_size=1)(tasks):
            bar.update(count)
    return {name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in columns}


def cut_blocks(count: int, size: int) -> list[Block]:
    """Cut ``count`` items into blocks of ``size``."""
    starts = range(0, count, size)
    return [Block(index, start, min(start + size, count)) for index, start in enumerate(starts)]


def _check_recipe(folder: Path, recipe: Mapping[str, Any]) -> None:
    path, text = folder / "recipe.json", json.dumps(recipe, indent=1, sort_keys=True)
    if not path.exists():
        path.write_text(text, encoding="utf-8")
    elif path.read_text(encoding="utf-8") != text:
        raise ConfigError(f"{folder}: holds data of another recipe (recipe.json): name another folder or remove it")


def _marker(folder: Path, block: Block) -> Path:
    return folder / f".done_{block.index:06d}"


def _fill_block(folder: Path, block: Block, render: Renderer) -> int:
    for name, items in render(block).items():
        column = np.load(folder / f"{name}.npy", mmap_mode="r+")
        column[block.start : block.stop] = items
        column.flush()
    _marker(folder, block).touch()
    return block.stop - block.start
