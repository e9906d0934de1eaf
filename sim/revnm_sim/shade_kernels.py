"""Compiled shading: procedural textures on world coordinates under lamps; see :mod:`revnm_sim.shade`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32

PLAIN, CHECKER, STRIPES, NOISE, PLANKS = range(5)

_compiled = njit(cache=True, nogil=True, error_model="numpy")


class Seen(NamedTuple):
    """What every cell of a grid sees.

    Attributes:
        depth_m: (h, w) float32.
        ids: (h, w) int32, a primitive, −1 floor, −2 sky.
        normals: (h, w, 3) float32.
        rays: (7, 3) float64, as of ``raycast.ray_grid``.
    """

    depth_m: Image32
    ids: NDArray[np.int32]
    normals: Image32
    rays: FloatArray


class Surfaces(NamedTuple):
    """S = P + 1 surfaces: the primitives, then the floor.

    Attributes:
        centre_m: (S, 3) float64, origin of the texture.
        axis: (S, 2) float64, cosine and sine of the body's yaw.
        radius_m: (S,) float64, of a cylinder; 0 for flat bodies.
        kind: (S,) int64, PLAIN, CHECKER, STRIPES, NOISE or PLANKS.
        scale_m: (S,) float64, size of the pattern.
        turn: (S, 2) float64, cosine and sine of the pattern's turn in its surface.
        colours: (S, 2, 3) float64, the two colours that the pattern mixes, linear, 0 to 1.
    """

    centre_m: FloatArray
    axis: FloatArray
    radius_m: FloatArray
    kind: NDArray[np.int64]
    scale_m: FloatArray
    turn: FloatArray
    colours: FloatArray


@_compiled
def _hash(x: int, y: int, seed: int) -> float:
    """Return a number in [0, 1) that looks random."""
    h = (x * 374761393 + y * 668265263 + seed * 362437) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    return float((h ^ (h >> 16)) & 0xFFFFFF) / 16777216.0


@_compiled
def _smooth_noise(u: float, v: float, seed: int) -> float:
    """Return value noise in [0, 1) with a lattice of 1."""
    x, y = math.floor(u), math.floor(v)
    a, b = u - x, v - y
    a, b = a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b)
    low = _hash(x, y, seed) * (1.0 - a) + _hash(x + 1, y, seed) * a
    high = _hash(x, y + 1, seed) * (1.0 - a) + _hash(x + 1, y + 1, seed) * a
    return low * (1.0 - b) + high * b


@_compiled
def _pattern(kind: int, u: float, v: float, seed: int) -> float:
    """Return the mix of two colours, 0 to 1, at texture coordinates in units of the pattern."""
    if kind == CHECKER:
        return float((math.floor(u) + math.floor(v)) & 1)
    if kind == STRIPES:
        return 1.0 if u - math.floor(u) < 0.4 else 0.0
    if kind == NOISE:
        total = 0.5 * _smooth_noise(u, v, seed) + 0.3 * _smooth_noise(2.7 * u, 2.7 * v, seed + 1)
        return total + 0.2 * _smooth_noise(7.1 * u, 7.1 * v, seed + 2)
    row = math.floor(v)
    along = u / 5.0 + _hash(row, 0, seed)
    plank = math.floor(along)
    if v - row < 0.06 or along - plank < 0.012:
        return 1.0
    return 0.6 * _hash(plank, row, seed + 3)


@_compiled
def _mix(k: int, surfaces: Surfaces, x: float, y: float, z: float, normal: Image32, footprint_m: float) -> float:
    """Return the mix of surface k's colours at a point relative to its middle; cells that outgrow it blur."""
    if surfaces.kind[k] == PLAIN:
        return 0.0
    fade: float = min(max(1.5 - 2.0 * footprint_m / surfaces.scale_m[k], 0.0), 1.0)
    if fade <= 0.0:
        return 0.5
    c, s = surfaces.axis[k, 0], surfaces.axis[k, 1]
    u, v = c * x + s * y, c * y - s * x
    if abs(normal[2]) < 0.5:
        if surfaces.radius_m[k] > 0.0:
            u = surfaces.radius_m[k] * math.atan2(v, u)
        elif abs(c * normal[0] + s * normal[1]) > 0.7:
            u = v
        v = z
    cu, su = surfaces.turn[k, 0], surfaces.turn[k, 1]
    a, b = (cu * u + su * v) / surfaces.scale_m[k], (cu * v - su * u) / surfaces.scale_m[k]
    mix: float = _pattern(surfaces.kind[k], a, b, 17 * k)
    return 0.5 + fade * (mix - 0.5)


@_compiled
def _light(lamps: FloatArray, ambient: float, point: FloatArray, normal: Image32) -> float:
    """Return the light (Lambert) on a surface point; lamps (L, 5) are position, strength, reach."""
    total: float = ambient * (0.8 + 0.2 * normal[2])
    for n in range(lamps.shape[0]):
        x, y, z = lamps[n, 0] - point[0], lamps[n, 1] - point[1], lamps[n, 2] - point[2]
        square = x * x + y * y + z * z
        facing = (x * normal[0] + y * normal[1] + z * normal[2]) / math.sqrt(square + 1e-9)
        if facing > 0.0:
            total += facing * lamps[n, 3] / (1.0 + square / lamps[n, 4] ** 2)
    return total


@_compiled
def shade_cells(seen: Seen, surfaces: Surfaces, lamps: FloatArray, ambient: float, sky: FloatArray) -> Image32:
    """Return the light that reaches every cell, (h, w, 3) float32, linear, about 0 to 1.

    Args:
        seen: What the cells see.
        surfaces: How it looks.
        lamps: (L, 5) position, metres, strength, and the distance at which it has halved, metres.
        ambient: Light from everywhere.
        sky: (2, 3) colours of the sky at the top and at the bottom of the picture.
    """
    height, width = seen.ids.shape
    picture = np.empty((height, width, 3), np.float32)
    floor = surfaces.kind.shape[0] - 1
    point = np.empty(3)
    cell = math.sqrt(seen.rays[2, 0] ** 2 + seen.rays[2, 1] ** 2 + seen.rays[2, 2] ** 2)
    for row in range(height):
        for column in range(width):
            k = seen.ids[row, column]
            if k == -2:
                for m in range(3):
                    picture[row, column, m] = sky[0, m] + (sky[1, m] - sky[0, m]) * row / height
                continue
            k = floor if k == -1 else k
            depth = min(seen.depth_m[row, column], 1e4)
            normal = seen.normals[row, column]
            facing = square = 0.0
            for a in range(3):
                ray = seen.rays[1, a] + seen.rays[2, a] * column + seen.rays[3, a] * row
                point[a] = seen.rays[0, a] + depth * ray
                facing -= ray * normal[a]
                square += ray * ray
            footprint = depth * cell * math.sqrt(square) / max(facing, 1e-3)
            middle = surfaces.centre_m[k]
            x, y, z = point[0] - middle[0], point[1] - middle[1], point[2] - middle[2]
            mix = _mix(k, surfaces, x, y, z, normal, footprint)
            light = _light(lamps, ambient, point, normal)
            for m in range(3):
                first, second = surfaces.colours[k, 0, m], surfaces.colours[k, 1, m]
                picture[row, column, m] = light * (first + mix * (second - first))
    return picture
