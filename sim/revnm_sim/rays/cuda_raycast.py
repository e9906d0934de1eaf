"""The exact ray caster on a graphics card: many depth images of a world at once, one thread per pixel.

What is seen, and how it is computed, is as in :mod:`revnm_sim.rays.raycast_kernels`: inverse depth along the ray, the
greatest wins, and a primitive that holds the camera is not seen. A pixel asks every primitive instead of a primitive
painting its window, so both agree but where a ray grazes an edge.

Symbols: B images, P primitives.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import cuda

from revnm_client.errors import ConfigError
from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import ray_grid
from revnm_sim.rays.raycast_kernels import KindArray
from revnm_sim.world import PrimitiveArrays

_CYLINDER = 1
_EDGE = 1e-9  # a ray this little outside a face, relative to the distance, hits it: faces meet without cracks
_THREADS = 128


def cast_depths_cuda(
    arrays: PrimitiveArrays, cameras: Sequence[Camera], grid_hw: tuple[int, int], *, max_depth_m: float = math.inf
) -> Image32:
    """Return the depth along the optical axes of B cameras, (B, h, w) float32, metres.

    See :func:`revnm_sim.rays.raycast.cast_depths`, which does the same on the CPU.

    Raises:
        ConfigError: There is no CUDA device.
    """
    if not cuda.is_available():
        raise ConfigError("no CUDA device: numba finds none; use the CPU, or install its driver and numba-cuda")
    height, width = grid_hw
    views = np.stack([ray_grid(camera, grid_hw) for camera in cameras])
    depths = cuda.device_array((len(cameras), height, width), dtype=np.float32)
    blocks = -(-depths.size // _THREADS)
    _cast[blocks, _THREADS](*(cuda.to_device(part) for part in (*arrays, views)), max_depth_m, depths)
    return np.asarray(depths.copy_to_host())


@cuda.jit
def _cast(
    shape: KindArray,
    centre_m: FloatArray,
    half_m: FloatArray,
    axis: FloatArray,
    views: FloatArray,
    max_depth_m: float,
    depths: Any,
) -> None:
    """Cast one pixel of depths (B, h, w) from views (B, 7, 3)."""
    thread = cuda.grid(1)  # type: ignore[attr-defined]
    images, height, width = depths.shape
    if thread >= images * height * width:
        return
    image, pixel = divmod(thread, height * width)
    row, column = divmod(pixel, width)
    view = views[image]
    x = view[1, 0] + view[2, 0] * column + view[3, 0] * row
    y = view[1, 1] + view[2, 1] * column + view[3, 1] * row
    z = view[1, 2] + view[2, 2] * column + view[3, 2] * row
    nearest = -z / view[0, 2] if view[0, 2] > 0.0 else 0.0
    nearest = max(nearest, 0.0)
    for k in range(shape.shape[0]):
        c, s = axis[k, 0], axis[k, 1]
        dx, dy = view[0, 0] - centre_m[k, 0], view[0, 1] - centre_m[k, 1]
        eye_x, eye_y, eye_z = c * dx + s * dy, c * dy - s * dx, view[0, 2] - centre_m[k, 2]
        ray_x, ray_y = c * x + s * y, c * y - s * x
        if shape[k] == _CYLINDER:
            near = _cylinder(eye_x, eye_y, eye_z, ray_x, ray_y, z, half_m[k, 0], half_m[k, 2])
        else:
            near = max(
                _face(eye_x, ray_x, half_m[k, 0], eye_y, ray_y, half_m[k, 1], eye_z, z, half_m[k, 2]),
                _face(eye_y, ray_y, half_m[k, 1], eye_z, z, half_m[k, 2], eye_x, ray_x, half_m[k, 0]),
                _face(eye_z, z, half_m[k, 2], eye_x, ray_x, half_m[k, 0], eye_y, ray_y, half_m[k, 1]),
            )
        nearest = max(nearest, near)
    metres = 1.0 / nearest if nearest > 0.0 else math.inf
    depths[image, row, column] = metres if metres <= max_depth_m else math.inf


@cuda.jit(device=True)
def _face(
    eye: float,
    ray: float,
    half: float,
    eye_1: float,
    ray_1: float,
    half_1: float,
    eye_2: float,
    ray_2: float,
    half_2: float,
) -> float:
    """Return the inverse depth of a box's face that looks at the eye along one of its axes; 0 where the ray misses."""
    if abs(eye) <= half:
        return 0.0
    near = ray / ((half if eye > 0.0 else -half) - eye)
    if near <= 0.0:
        return 0.0
    # Where the ray meets the face's plane, times the inverse depth.
    inside_1 = abs(eye_1 * near + ray_1) <= (half_1 + _EDGE) * near
    inside_2 = abs(eye_2 * near + ray_2) <= (half_2 + _EDGE) * near
    return near if inside_1 and inside_2 else 0.0


@cuda.jit(device=True)
def _cylinder(
    eye_x: float, eye_y: float, eye_z: float, x: float, y: float, z: float, radius: float, half: float
) -> float:
    """Return the inverse depth of an upright cylinder, side or the cap that looks at the eye; 0 for a miss."""
    nearest = 0.0
    room = eye_x * eye_x + eye_y * eye_y - radius * radius
    if room > 0.0:
        along = eye_x * x + eye_y * y
        root = along * along - (x * x + y * y) * room
        if root >= 0.0:
            near = (math.sqrt(root) - along) / room
            if near > 0.0 and abs(eye_z * near + z) <= half * near:
                nearest = near
    if abs(eye_z) > half:
        near = z / ((half if eye_z > 0.0 else -half) - eye_z)
        hit_x, hit_y = eye_x * near + x, eye_y * near + y
        if near > nearest and hit_x * hit_x + hit_y * hit_y <= (radius * near) ** 2:
            nearest = near
    return nearest
