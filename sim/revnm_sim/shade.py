"""Pictures of a world without PyBullet, for training the depth network by domain randomisation.

Colours start from the world's; textures, lamps and the camera's faults are drawn at random for every picture,
so that only the geometry stays the same. No shadows. Must not import PyBullet.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_ids, ray_grid
from revnm_sim.shade_kernels import CHECKER, NOISE, PLAIN, PLANKS, STRIPES, Seen, Surfaces, shade_cells
from revnm_sim.world import Bounds, Primitive, PrimitiveArrays, Shape, World, primitive_arrays

_GAMMA = 2.2
_KINDS = np.array([PLAIN, CHECKER, STRIPES, NOISE, PLANKS])
_BODY_SHARES = (0.45, 0.08, 0.12, 0.25, 0.10)
_FLOOR_SHARES = (0.30, 0.15, 0.08, 0.29, 0.18)


def shade(
    world: World,
    camera: Camera,
    size_px: tuple[int, int],
    rng: np.random.Generator,
    *,
    extra: tuple[Primitive, ...] = (),
) -> NDArray[np.uint8]:
    """Return a picture of a world with random textures, light and camera faults.

    Args:
        world: The floor and what stands on it.
        camera: Where from; its picture is squeezed into the size asked for.
        size_px: Width and height of the result.
        rng: Decides everything random; the same state gives the same picture.
        extra: More primitives, such as the robot.

    Returns:
        (height, width, 3) uint8, RGB.
    """
    primitives = world.primitives + extra
    arrays = primitive_arrays(primitives)
    grid_hw = (size_px[1], size_px[0])
    seen = Seen(*cast_ids(arrays, camera, grid_hw), ray_grid(camera, grid_hw))
    colours = np.array([p.colour for p in primitives] + [world.floor_colour], dtype=np.float64)
    surfaces = _random_surfaces(arrays, (colours / 255.0) ** _GAMMA, rng)
    lamps, ambient = _random_light(world.bounds, rng)
    light = shade_cells(seen, surfaces, lamps, ambient, rng.uniform(0.0, 1.0, (2, 3)))
    return _photograph(light, rng)


def _random_surfaces(arrays: PrimitiveArrays, colours: FloatArray, rng: np.random.Generator) -> Surfaces:
    """Draw a texture for every primitive and the floor; the colours (P + 1, 3) are linear."""
    count = len(colours)
    bodies = rng.choice(_KINDS, size=count - 1, p=_BODY_SHARES)
    floor = rng.choice(_KINDS, p=_FLOOR_SHARES)
    angle = np.where(rng.random(count) < 0.7, 0.0, rng.uniform(-np.pi, np.pi, count))
    first = colours * rng.uniform(0.7, 1.4, (count, 1)) + rng.normal(0.0, 0.03, (count, 3))
    other = first * rng.uniform(0.2, 2.0, (count, 1)) + rng.normal(0.0, 0.08, (count, 3))
    contrast = rng.uniform(0.05, 0.9, (count, 1))
    pair = np.stack([first, first + contrast * (other - first)], axis=1)
    return Surfaces(
        centre_m=np.vstack([arrays.centre_m, [*rng.uniform(-1.0, 1.0, 2), 0.0]]),
        axis=np.vstack([arrays.axis, [1.0, 0.0]]),
        radius_m=np.append(np.where(arrays.shape == Shape.CYLINDER, arrays.half_m[:, 0], 0.0), 0.0),
        kind=np.append(bodies, floor).astype(np.int64),
        scale_m=np.exp(rng.uniform(np.log(0.06), np.log(1.0), count)),
        turn=np.stack([np.cos(angle), np.sin(angle)], axis=-1),
        colours=np.clip(pair, 0.01, 1.0),
    )


def _random_light(bounds: Bounds, rng: np.random.Generator) -> tuple[FloatArray, float]:
    """Draw two lamps (2, 5), one far away and one over the room, and the ambient light."""
    low = np.array([bounds.x_min_m, bounds.y_min_m])
    high = np.array([bounds.x_max_m, bounds.y_max_m])
    turn, tilt = rng.uniform(-np.pi, np.pi), rng.uniform(0.2, 1.4)
    sun = 1e3 * np.array([np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt), np.sin(tilt)])
    lamp = np.append(rng.uniform(low, high), rng.uniform(2.5, 5.0))
    far = [*sun, rng.uniform(0.1, 0.9), 1e6]
    near = [*lamp, rng.uniform(0.0, 1.0), rng.uniform(2.0, 10.0)]
    return np.array([far, near]), float(rng.uniform(0.15, 0.7))


def _photograph(light: Image32, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Turn light (h, w, 3) into a picture: exposure, white balance, vignette, blur, gamma, noise."""
    height, width, _ = light.shape
    exposure = rng.uniform(0.35, 0.75) / max(float(light.mean()), 1e-3)
    gains = exposure * rng.uniform(0.85, 1.15, 3)
    x = np.linspace(-1.0, 1.0, width) ** 2
    y = np.linspace(-1.0, 1.0, height) ** 2
    vignette = 1.0 - rng.uniform(0.0, 0.2) * (x[None, :] + y[:, None])
    picture = light * gains.astype(np.float32) * vignette[..., None].astype(np.float32)
    sigma = rng.uniform(0.0, 1.0)
    blurred = cv2.GaussianBlur(picture, (0, 0), sigma) if sigma > 0.25 else picture
    tones = 255.0 * np.power(np.clip(blurred, 0.0, 1.0), np.float32(1.0 / rng.uniform(1.6, 2.4)))
    noise = rng.standard_normal(light.shape, dtype=np.float32) * np.float32(rng.uniform(0.0, 6.0))
    return np.clip(tones + noise, 0.0, 255.0).astype(np.uint8)
