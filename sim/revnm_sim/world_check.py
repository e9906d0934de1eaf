"""How well a world agrees with the measured layout that it was written from."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.ndimage import label

from revnm_client.errors import FileError
from revnm_client.geometry import FloatArray
from revnm_sim.expert.planner import INSCRIBED_M
from revnm_sim.occupancy import OccupancyGrid, occupancy
from revnm_sim.world import Bounds, Primitive, Shape, World

LEAST_IOU = 0.97
_MOST_BYTES = 4_000_000
_LOW_M = (0.05, 0.40)  # heights that stop the robot
_SEEN_M = (0.05, 3.5)  # heights that a camera sees
_LAYER_M = 0.15
_CELL_M = 0.05

BoolArray = NDArray[np.bool_]
Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0, allow_inf_nan=False)]
Extent = Annotated[float, Field(gt=0.0, le=1000.0, allow_inf_nan=False)]
Channel = Annotated[int, Field(ge=0, le=255)]


class _Part(BaseModel):
    """The keys of the JSON that are read; it has more."""

    model_config = ConfigDict(frozen=True)

    shape: Literal["box", "cylinder"]
    category: Annotated[str, Field(min_length=1, max_length=64)]
    center: tuple[Coordinate, Coordinate, Coordinate]
    size: tuple[Extent, Extent, Extent]
    yaw: Annotated[float, Field(ge=-10.0, le=10.0, allow_inf_nan=False)]
    color: tuple[Channel, Channel, Channel]


class _Range(BaseModel):
    x: tuple[Coordinate, Coordinate]
    y: tuple[Coordinate, Coordinate]


class _File(BaseModel):
    name: str
    bounds: _Range
    floor_polygon: Annotated[list[tuple[Coordinate, Coordinate]], Field(min_length=3, max_length=1000)]
    floor_z: Coordinate
    objects: Annotated[list[_Part], Field(max_length=10_000)]
    overhead: Annotated[list[_Part], Field(max_length=10_000)] = []


@dataclass(frozen=True, slots=True)
class Layout:
    """A measured layout.

    Attributes:
        world: All its parts, the floor moved to z = 0.
        categories: (P,) of each primitive of the world, such as ``shelf``.
        outline_m: (N, 2) corners of the floor, in order.
    """

    world: World
    categories: tuple[str, ...]
    outline_m: FloatArray


@dataclass(frozen=True, slots=True)
class Agreement:
    """How well a world agrees with a layout, on a grid of 0.05 m over the layout's bounds.

    Attributes:
        free_m2: Floor that nothing covers between 0.05 and 0.40 m: of the world, of the layout.
        iou: Free floor of both over free floor of either. Floor outside the world's bounds, or outside the
            layout's outline, is not free.
        iou_inflated: The same of the largest piece of floor where a disc of 0.22 m fits.
        covered: By category, the shares of the layout's footprint and volume between 0.05 and 3.5 m, the volume
            in layers of 0.15 m, where the world has something too.
    """

    free_m2: tuple[float, float]
    iou: float
    iou_inflated: float
    covered: dict[str, tuple[float, float]]


def load_layout(path: Path) -> Layout:
    """Read a measured layout: boxes and cylinders as JSON.

    Raises:
        FileError: It cannot be read, is no JSON, or lacks what is read; the text names file and key.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise FileError(f"{path}: larger than {_MOST_BYTES} bytes")
        content = _File.model_validate(json.loads(path.read_text(encoding="utf-8")), strict=False)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        key = ".".join(str(part) for part in first["loc"]) or "the file"
        problem = f"{first['msg'][0].lower()}{first['msg'][1:]}, got {first['input']!r:.80}"
        raise FileError(f"{path}: {key}: {problem}") from error
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: is no JSON: {error}") from error
    (x_min, x_max), (y_min, y_max) = content.bounds.x, content.bounds.y
    if x_min >= x_max or y_min >= y_max:
        raise FileError(
            f"{path}: bounds: expected ranges of growing numbers, got {content.bounds.x}, {content.bounds.y}"
        )
    parts = content.objects + content.overhead
    primitives = tuple(_on_floor(part, content.floor_z) for part in parts)
    # Whole cells, so that the grids have no cell that the bounds cut; the outline ends the floor.
    whole = [low + math.ceil((high - low) / _CELL_M) * _CELL_M for low, high in ((x_min, x_max), (y_min, y_max))]
    world = World(content.name, Bounds(x_min, y_min, *whole), (128, 128, 128), primitives)
    return Layout(world, tuple(part.category for part in parts), np.array(content.floor_polygon))


def compare(world: World, layout: Layout) -> Agreement:
    """Measure how well a world agrees with a layout."""
    theirs = occupancy(layout.world, z_min_m=_LOW_M[0], z_max_m=_LOW_M[1])
    ours = occupancy(replace(world, bounds=layout.world.bounds), z_min_m=_LOW_M[0], z_max_m=_LOW_M[1])
    points = _middles(theirs)
    low, high = np.array(world.bounds[:2]), np.array(world.bounds[2:])
    inside = _inside(points, layout.outline_m)
    ours = replace(ours, occupied=ours.occupied | ~((points > low) & (points < high)).all(axis=-1))
    theirs = replace(theirs, occupied=theirs.occupied | ~inside)
    cell = theirs.resolution_m**2
    return Agreement(
        free_m2=(float((~ours.occupied).sum()) * cell, float((~theirs.occupied).sum()) * cell),
        iou=_iou(~ours.occupied, ~theirs.occupied),
        iou_inflated=_iou(_largest(ours.distance_m > INSCRIBED_M), _largest(theirs.distance_m > INSCRIBED_M)),
        covered={name: _covered(world, layout, name) for name in sorted(set(layout.categories))},
    )


def agreement_table(agreement: Agreement) -> str:
    """Return the agreement as text for a terminal."""
    lines = [
        f"free floor           ours {agreement.free_m2[0]:7.2f} m²   measured {agreement.free_m2[1]:7.2f} m²",
        f"IoU of free floor    {agreement.iou:.4f}",
        f"IoU after {INSCRIBED_M:.2f} m     {agreement.iou_inflated:.4f}   (largest piece)",
        "",
        f"{'measured':<12} {'footprint':>9} {'volume':>9}   (share of it where ours has something too)",
    ]
    lines += [f"{name:<12} {shares[0]:>9.1%} {shares[1]:>9.1%}" for name, shares in agreement.covered.items()]
    return "\n".join(lines)


def _on_floor(part: _Part, floor_z_m: float) -> Primitive:
    x, y, z = part.center
    shape = Shape.BOX if part.shape == "box" else Shape.CYLINDER
    return Primitive(shape, (x, y, z - floor_z_m), part.size, part.yaw, part.color)


def _covered(world: World, layout: Layout, category: str) -> tuple[float, float]:
    """Return the shares of a category's footprint and volume that the world covers; 1 of nothing."""
    parts = tuple(p for p, name in zip(layout.world.primitives, layout.categories, strict=True) if name == category)
    theirs = replace(layout.world, primitives=parts)
    ours = replace(world, bounds=layout.world.bounds)
    layers = np.linspace(*_SEEN_M, 1 + round((_SEEN_M[1] - _SEEN_M[0]) / _LAYER_M))
    both, wanted = 0, 0
    for low, high in pairwise(layers):
        measured = _raster(theirs, low, high)
        wanted += int(measured.sum())
        both += int((measured & _raster(ours, low, high)).sum())
    footprint = _raster(theirs, *_SEEN_M)
    hit = footprint & _raster(ours, *_SEEN_M)
    return float(hit.sum() / max(footprint.sum(), 1)) if wanted else 1.0, both / wanted if wanted else 1.0


def _raster(world: World, low_m: float, high_m: float) -> BoolArray:
    """Return the cells that something between two heights touches, without the rim that the grid adds."""
    return occupancy(world, z_min_m=low_m, z_max_m=high_m).occupied[2:-2, 2:-2]


def _largest(free: BoolArray) -> BoolArray:
    pieces, count = label(free, structure=np.ones((3, 3)))
    sizes = np.bincount(pieces.ravel(), minlength=count + 1)
    sizes[0] = 0
    return np.asarray(free & (pieces == sizes.argmax()))


def _iou(one: BoolArray, other: BoolArray) -> float:
    """Return cells of both over cells of either; 1 where there are none."""
    either = int((one | other).sum())
    return float((one & other).sum() / either) if either else 1.0


def _middles(grid: OccupancyGrid) -> FloatArray:
    """Return the middles (Ny, Nx, 2) of the cells, metres."""
    rows, columns = grid.occupied.shape
    xs, ys = ((np.arange(n) + 0.5) * grid.resolution_m for n in (columns, rows))
    return np.asarray(np.stack(np.meshgrid(xs, ys), axis=-1) + np.array(grid.origin_m))


def _inside(points_m: FloatArray, corners_m: FloatArray) -> BoolArray:
    """Return which points (..., 2) lie in a polygon (N, 2): a ray to the right crosses an odd number of its edges."""
    inside = np.zeros(points_m.shape[:-1], dtype=bool)
    x, y = points_m[..., 0], points_m[..., 1]
    for (x0, y0), (x1, y1) in zip(corners_m, np.roll(corners_m, -1, axis=0), strict=True):
        if y0 != y1:
            inside ^= ((y0 > y) != (y1 > y)) & (x < x0 + (x1 - x0) / (y1 - y0) * (y - y0))
    return inside
