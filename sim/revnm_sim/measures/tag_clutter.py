"""Tag-free pictures that tempt a tag detector: shapes, checkerboards, print, squares of random cells, worlds."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_sim.generation.placement import sample_camera
from revnm_sim.shade import shade
from revnm_sim.worlds import WORLDS, generated_world, is_generated

Gray = NDArray[np.uint8]

_SHAPES_PER_MPX = 220  # as many as a full room shows
_HFOV_RAD = math.radians(78.0)
_FAMILIES = [name for name in WORLDS if is_generated(name)]
_LETTERS = "ABDEHKMNRSXZ0123456789#%&@=+"


def cluttered(rng: np.random.Generator, size_px: tuple[int, int]) -> Gray:
    """Return a picture (H, W) of random boxes, discs and outlines on an uneven ground."""
    width, height = size_px
    gray = _ground(rng, size_px)
    for _ in range(max(8, int(_SHAPES_PER_MPX * width * height / 1e6))):
        _draw_shape(gray, rng)
    return gray


def checkered(rng: np.random.Generator, size_px: tuple[int, int]) -> Gray:
    """Return a picture (H, W) with checkerboards, tilted, of all sizes."""
    return _pasted(rng, size_px, lambda: _board(rng))


def printed(rng: np.random.Generator, size_px: tuple[int, int]) -> Gray:
    """Return a picture (H, W) with dark signs full of letters."""
    return _pasted(rng, size_px, lambda: _sign(rng))


def celled(rng: np.random.Generator, size_px: tuple[int, int]) -> Gray:
    """Return a picture (H, W) with black-bordered squares of random cells: markers of no family."""
    return _pasted(rng, size_px, lambda: _square_of_cells(rng))


def world_seen(rng: np.random.Generator, size_px: tuple[int, int]) -> Gray:
    """Return a picture (H, W) of a generated world without a robot."""
    world = generated_world(str(rng.choice(_FAMILIES)), int(rng.integers(0, 1 << 30)))
    try:
        camera = sample_camera(world, rng, width_px=size_px[0], height_px=size_px[1], hfov_rad=_HFOV_RAD)
    except ContractError:  # no place for a camera: another world
        return world_seen(rng, size_px)
    return np.asarray(cv2.cvtColor(shade(world, camera, size_px, rng), cv2.COLOR_RGB2GRAY), dtype=np.uint8)


TAG_FREE: dict[str, Callable[[np.random.Generator, tuple[int, int]], Gray]] = {
    "shapes": cluttered,
    "checkerboards": checkered,
    "print": printed,
    "cells": celled,
    "worlds": world_seen,
}


def _ground(rng: np.random.Generator, size_px: tuple[int, int]) -> Gray:
    small = rng.integers(60, 190, (6, 8)).astype(np.uint8)
    return np.asarray(cv2.resize(small, size_px, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)


def _draw_shape(gray: Gray, rng: np.random.Generator) -> None:
    height, width = gray.shape
    level = int(rng.integers(0, 256))
    centre = (int(rng.integers(0, width)), int(rng.integers(0, height)))
    extent = rng.uniform(5.0, 90.0, 2)
    turned = cv2.boxPoints((centre, extent.tolist(), float(rng.uniform(0.0, 180.0)))).astype(np.int32)
    match rng.integers(0, 4):
        case 0 | 1:
            cv2.fillConvexPoly(gray, turned, level, cv2.LINE_AA)
        case 2:
            thickness = -1 if rng.random() < 0.5 else 2
            cv2.circle(gray, centre, int(extent[0] / 2), level, thickness, cv2.LINE_AA)
        case _:
            cv2.polylines(gray, [turned], isClosed=True, color=level, thickness=int(rng.integers(1, 5)))


def _pasted(rng: np.random.Generator, size_px: tuple[int, int], draw: Callable[[], Gray]) -> Gray:
    """Return a ground with six pictures pasted onto it, each tilted and scaled at random."""
    gray = _ground(rng, size_px)
    for _ in range(6):
        picture = draw()
        homography = _placement(rng, picture.shape[::-1], size_px)
        cv2.warpPerspective(picture, homography, size_px, dst=gray, borderMode=cv2.BORDER_TRANSPARENT)
    return gray


def _placement(rng: np.random.Generator, from_px: tuple[int, ...], to_px: tuple[int, int]) -> FloatArray:
    """Return a homography (3, 3) from a picture to a random place, size, roll and tilt in another."""
    width, height = from_px
    source = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32)
    outline = (source / [width, height] - 0.5) * rng.uniform(14.0, 130.0) + rng.normal(0.0, 3.0, (4, 2))
    turn = rng.uniform(0.0, math.tau)
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    target = outline @ rotation.T + rng.uniform((0, 0), to_px)
    return np.asarray(cv2.getPerspectiveTransform(source, target.astype(np.float32)))


def _board(rng: np.random.Generator) -> Gray:
    columns, rows = rng.integers(2, 11, 2)
    board = np.indices((rows, columns)).sum(axis=0) % 2
    return _inked(rng, np.pad(board, int(rng.integers(0, 2)), constant_values=int(rng.integers(0, 2))))


def _square_of_cells(rng: np.random.Generator) -> Gray:
    cells = rng.integers(0, 2, (6, 6))
    return _inked(rng, np.pad(np.pad(cells, 1), 1, constant_values=1))


def _inked(rng: np.random.Generator, cells: NDArray[np.int64]) -> Gray:
    levels = np.where(cells > 0, rng.integers(140, 256), rng.integers(0, 90)).astype(np.uint8)
    return np.kron(levels, np.ones((8, 8), np.uint8))


def _sign(rng: np.random.Generator) -> Gray:
    ground, ink = (30, 225) if rng.random() < 0.6 else (225, 30)
    sign = np.full((96, 96), ground, np.uint8)
    for row in range(int(rng.integers(2, 6))):
        text = "".join(rng.choice(list(_LETTERS), 8))
        cv2.putText(sign, text, (6, 18 + 18 * row), cv2.FONT_HERSHEY_SIMPLEX, rng.uniform(0.4, 0.9), ink, 2)
    return np.pad(sign, 10, constant_values=255 - ground)
