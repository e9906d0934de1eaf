"""Compiled loops over single rays: a laser scan, and whether points are hidden from an eye.

A ray that starts inside a primitive does not meet it, as in :mod:`revnm_sim.rays.raycast_kernels`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

KindArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_CYLINDER = 1
_TINY = 1e-12
_TOUCHING = 1e-4  # a hit this near to the point, as a fraction of the way, is the point's own surface

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def _slab(start: float, step: float, half: float) -> tuple[float, float]:
    """Return between which times a coordinate start + time · step is in ±half; (inf, -inf) if never."""
    if abs(step) < _TINY:
        return (-math.inf, math.inf) if abs(start) <= half else (math.inf, -math.inf)
    a, b = (-half - start) / step, (half - start) / step
    return min(a, b), max(a, b)


@_compiled
def _disc(x: float, y: float, dx: float, dy: float, radius: float) -> tuple[float, float]:
    """Return between which times a ray in the plane is in a circle about the origin; (inf, -inf) if never."""
    square = dx * dx + dy * dy
    room = x * x + y * y - radius * radius
    if square < _TINY:
        return (-math.inf, math.inf) if room <= 0.0 else (math.inf, -math.inf)
    along = x * dx + y * dy
    root = along * along - square * room
    if root < 0.0:
        return math.inf, -math.inf
    root = math.sqrt(root)
    return (-along - root) / square, (-along + root) / square


@_compiled
def _plan_times(
    cylinder: bool, half: FloatArray, axis: FloatArray, x: float, y: float, dx: float, dy: float
) -> tuple[float, float]:
    """Return when a ray from (x, y), relative to a primitive's middle, enters and leaves it in the plan."""
    if cylinder:
        return _disc(x, y, dx, dy, half[0])
    c, s = axis[0], axis[1]
    in_x, out_x = _slab(c * x + s * y, c * dx + s * dy, half[0])
    in_y, out_y = _slab(c * y - s * x, c * dy - s * dx, half[1])
    return max(in_x, in_y), min(out_x, out_y)


@_compiled
def scan_ranges(
    shape: KindArray,
    centre_m: FloatArray,
    half_m: FloatArray,
    axis: FloatArray,
    origin_m: FloatArray,
    directions: FloatArray,
    max_range_m: float,
) -> FloatArray:
    """Return the distance (N,) from an origin (3,) along level unit directions (N, 2) to a hit, or inf."""
    ranges = np.full(directions.shape[0], math.inf)
    for k in range(shape.shape[0]):
        if abs(origin_m[2] - centre_m[k, 2]) > half_m[k, 2]:
            continue
        cylinder = shape[k] == _CYLINDER
        x, y = origin_m[0] - centre_m[k, 0], origin_m[1] - centre_m[k, 1]
        reach = half_m[k, 0] if cylinder else math.hypot(half_m[k, 0], half_m[k, 1])
        distance = math.hypot(x, y)
        if distance - reach > max_range_m:
            continue
        # A direction passes within reach of the middle if its component towards it is at least the tangent.
        towards = math.sqrt(distance * distance - reach * reach) - 1e-9 if distance > reach else -math.inf
        for n in range(directions.shape[0]):
            dx, dy = directions[n, 0], directions[n, 1]
            if -(dx * x + dy * y) < towards:
                continue
            enter, leave = _plan_times(cylinder, half_m[k], axis[k], x, y, dx, dy)
            if 0.0 < enter <= leave and enter < ranges[n]:
                ranges[n] = enter
    for n in range(ranges.shape[0]):
        if ranges[n] > max_range_m:
            ranges[n] = math.inf
    return ranges


@_compiled
def hide(
    shape: KindArray,
    centre_m: FloatArray,
    half_m: FloatArray,
    axis: FloatArray,
    eye_m: FloatArray,
    points_m: FloatArray,
    seen: BoolArray,
) -> None:
    """Clear the marks (M,) of the points (M, 3) that a primitive hides from the eye (3,); in place."""
    for m in range(points_m.shape[0]):
        if not seen[m]:
            continue
        dx, dy, dz = points_m[m, 0] - eye_m[0], points_m[m, 1] - eye_m[1], points_m[m, 2] - eye_m[2]
        for k in range(shape.shape[0]):
            in_z, out_z = _slab(eye_m[2] - centre_m[k, 2], dz, half_m[k, 2])
            if in_z >= 1.0 or out_z <= 0.0:
                continue
            x, y = eye_m[0] - centre_m[k, 0], eye_m[1] - centre_m[k, 1]
            enter, leave = _plan_times(shape[k] == _CYLINDER, half_m[k], axis[k], x, y, dx, dy)
            enter, leave = max(enter, in_z), min(leave, out_z)
            if 0.0 < enter <= leave and enter < 1.0 - _TOUCHING:
                seen[m] = False
                break
