"""A camera over a floor with boxes on it, by the simulator's ray caster: the oracle of the map's tests."""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.floor_camera import FloorCamera
from revnm_server.mapping.floor_view import FloorView, floor_view
from revnm_server.observation import Image32
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth
from revnm_sim.world import Primitive, Shape, primitive_arrays

HW = (96, 128)
# At the world's origin, looking along x: the floor frame is the world frame.
EYE = Camera(640, 480, math.radians(90.0), (0.0, 0.0, 2.5), 0.0, math.radians(32.0))
OURS = FloorCamera((640, 480), EYE.focal_px, EYE.pitch_rad, 0.0, 2.5)


def box(x: float, y: float, *, side: float = 0.5, height: float = 0.6, bottom: float = 0.0) -> Primitive:
    centre = (x, y, bottom + 0.5 * height)
    return Primitive(Shape.BOX, centre, (side, side, height), 0.0, (90, 90, 90))


def wall(x: float) -> Primitive:
    return Primitive(Shape.BOX, (x + 0.1, 0.0, 1.5), (0.2, 30.0, 3.0), 0.0, (90, 90, 90))


def disparity(*things: Primitive, hw: tuple[int, int] = HW) -> Image32:
    return disparity_from_depth(cast_depth(primitive_arrays(things), EYE, hw))


def view(camera: FloorCamera = OURS, covariance: FloatArray | None = None) -> FloorView:
    return floor_view(camera, HW, covariance)


def everywhere() -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.ones(HW, dtype=np.bool_)


def nowhere() -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return np.zeros(HW, dtype=np.bool_)
