"""Looks at what a depth network says of two pictures before a robot is driven by it.

Networks that say the opposite of what is believed of them run without an error, and so do exports that are broken in
the way that they give one number everywhere. The picture for that is drawn here: a tiled floor, up to a brick wall.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError, FileError
from revnm_server.networks.depth_input import place
from revnm_server.networks.depth_network import DepthNetwork
from revnm_server.observation import Image32

logger = logging.getLogger(__name__)

_HW = (480, 640)
_GRAY = 127
_FOCAL_PX = 420.0
_CAMERA_HEIGHT_M = 1.6
_HORIZON = 0.30  # rows, as fractions of the picture's height
_WALL_FOOT = 0.42
_TILE_M = 0.4
_BRICK_M = (0.12, 0.5)
_NEAR = (0.85, 1.0)  # rows of floor that is 2 m away
_FAR = (0.43, 0.52)  # rows of floor that is 6 to 11 m away
_CLEAR = 0.25  # of the span of all values: less difference between near and far tells nothing
_NOISE = 2e-3  # of the values: what rounding in half precision makes of one and the same number


def check_depth(network: DepthNetwork) -> None:
    """Check a network on a gray picture and on one of a floor.

    Raises:
        FileError: It cannot run, its output has another shape than the picture, is not finite or the same everywhere,
            or it is far where it should be near; the text says which setting to change.
    """
    try:
        _check_shape(network, network.look(np.full((*_HW, 3), _GRAY, dtype=np.uint8)).image)
        seen = network.look(floor_picture())
        network.meant(seen)
    except ContractError as error:
        raise FileError(f"{error} (trial run)") from error
    _check_sign(network, seen.image)


def floor_picture() -> NDArray[np.uint8]:
    """Return (480, 640, 3) RGB of a tiled floor that begins at the camera's feet and ends at a brick wall 12 m away."""
    height, width = _HW
    rows = (np.arange(height)[:, None] - _HORIZON * height) / _FOCAL_PX  # tangents of the angle below the horizon
    columns = (np.arange(width)[None] - width / 2) / _FOCAL_PX
    wall_m = _CAMERA_HEIGHT_M * _FOCAL_PX / ((_WALL_FOOT - _HORIZON) * height)
    floor = rows * wall_m > _CAMERA_HEIGHT_M
    depth_m = np.where(floor, _CAMERA_HEIGHT_M / np.maximum(rows, 1e-3), wall_m)
    aside_m, above_m = columns * depth_m, _CAMERA_HEIGHT_M - rows * depth_m
    tiles = (np.floor(aside_m / _TILE_M) + np.floor(depth_m / _TILE_M)) % 2
    course = np.floor(above_m / _BRICK_M[0])
    joints = (above_m / _BRICK_M[0] % 1.0 < 0.15) | ((aside_m / _BRICK_M[1] + course / 2) % 1.0 < 0.05)
    light = np.where(floor, 0.45 + 0.35 * tiles, np.where(joints, 0.75, 0.5))
    tint = np.where(floor[..., None], (1.0, 0.95, 0.85), (0.95, 0.65, 0.5))
    grain = 1.0 + 0.04 * np.random.default_rng(0).standard_normal((height, width, 1))
    return np.asarray(np.clip(255.0 * light[..., None] * tint * grain, 0.0, 255.0), dtype=np.uint8)


def _check_shape(network: DepthNetwork, image: Image32) -> None:
    """Compare height over width of what a picture gives with the input; a factor between them does not matter."""
    where = f"{network.model.path}: output {network.gives.name}"
    height, width = place(_HW, network.takes).inner_hw
    if abs(image.shape[0] * width - image.shape[1] * height) > 2 * max(height, width):
        raise FileError(
            f"{where}: {image.shape[0]} × {image.shape[1]} for a picture of {height} × {width} in the input: the "
            "export has a shape of its own; set depth.input.mode: fixed, and depth.input.size to it"
        )
    if network.gives.kind == "disparity" and not np.isfinite(image).all():
        raise FileError(f"{where} is not finite (trial run on gray)")


def _check_sign(network: DepthNetwork, image: Image32) -> None:
    """Compare near floor with far floor, in the network's own numbers, in which no depth is only a number."""
    where, kind = f"{network.model.path}: output {network.gives.name}", network.gives.kind
    image = np.where(np.isfinite(image), image, np.float32(0.0))
    low, high = (float(each) for each in np.percentile(image, (2.0, 98.0)))
    if not high - low > _NOISE * max(abs(high), abs(low)):
        raise FileError(f"{where} is the same everywhere in a picture of a floor and a wall: the export is broken")
    near, far = (float(np.median(_rows(image, band))) for band in (_NEAR, _FAR))
    clear = (near - far) / (high - low) * (1.0 if kind == "disparity" else -1.0)
    if clear < -_CLEAR:
        other = "depth (or metric_canonical)" if kind == "disparity" else "disparity"
        raise FileError(
            f"{where}: taken for {kind}, floor 8 m away is nearer than floor at the camera's feet; "
            f"set depth.kind: {other}"
        )
    if clear < _CLEAR:
        logger.warning("%s: a drawn floor does not tell whether it is %s; look at the page's map", where, kind)


def _rows(image: Image32, band: tuple[float, float]) -> Image32:
    return image[round(band[0] * image.shape[0]) : round(band[1] * image.shape[0])]
