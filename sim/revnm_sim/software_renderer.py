"""PyBullet's software renderer behind our pinhole camera: any rectangle of the picture, enlarged at will."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pybullet
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_sim.camera import Camera

NEAR_M, FAR_M = 0.05, 100.0
_LIGHT_BESIDE_RAD, _LIGHT_SLOPE = 0.7, 1.0
_AMBIENT, _DIFFUSE = 0.55, 0.45


class Region(NamedTuple):
    """A rectangle of pixels: its first column and row, and its size."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class Shot:
    """What a region shows, enlarged by the supersampling: h, w are the region's size times it.

    Attributes:
        colours: (h, w, 3) uint8 RGB.
        depth: (h, w) float32, the depth buffer: grows from 0 at the near plane to 1 at the far plane.
        parts: (h, w) int32, body + (link + 1) << 24, −1 where there is nothing.
    """

    colours: NDArray[np.uint8]
    depth: NDArray[np.float32]
    parts: NDArray[np.int32]


def render(client: int, camera: Camera, region: Region, supersampling: int) -> Shot:
    """Render what ``camera`` sees of a PyBullet client's bodies in a region of its picture."""
    width, height = region.width * supersampling, region.height * supersampling
    _, _, rgba, depth, parts = pybullet.getCameraImage(
        width,
        height,
        viewMatrix=view_matrix(camera),
        projectionMatrix=region_projection(camera, region, supersampling),
        renderer=pybullet.ER_TINY_RENDERER,
        flags=pybullet.ER_SEGMENTATION_MASK_OBJECT_AND_LINKINDEX,
        shadow=0,
        lightDirection=_light(camera),
        lightColor=(1.0, 1.0, 1.0),
        lightAmbientCoeff=_AMBIENT,
        lightDiffuseCoeff=_DIFFUSE,
        lightSpecularCoeff=0.0,
        physicsClientId=client,
    )
    return Shot(
        np.asarray(rgba, dtype=np.uint8).reshape(height, width, 4)[:, :, :3],
        np.asarray(depth, dtype=np.float32).reshape(height, width),
        np.asarray(parts, dtype=np.int32).reshape(height, width),
    )


def _light(camera: Camera) -> list[float]:
    """Return where light comes from: over the camera's shoulder, so that the faces that it sees differ."""
    back = camera.yaw_rad + math.pi - _LIGHT_BESIDE_RAD
    return [math.cos(back), math.sin(back), _LIGHT_SLOPE]


def view_matrix(camera: Camera) -> list[float]:
    """Return OpenGL's view matrix (x right, y up, z towards the viewer), 16 numbers by columns."""
    camera_from_world = np.eye(4)
    rotation = camera.world_from_camera().T * np.array([[1.0], [-1.0], [-1.0]])
    camera_from_world[:3, :3] = rotation
    camera_from_world[:3, 3] = -rotation @ np.array(camera.position_m)
    return [float(value) for value in camera_from_world.T.ravel()]


def region_projection(camera: Camera, region: Region, supersampling: int) -> list[float]:
    """Return OpenGL's projection matrix of a region of the picture, 16 numbers by columns.

    PyBullet's renderer samples column i at 2 i / width − 1 and row j at 1 − 2 (j + 1) / height in normalised
    device coordinates (measured); this puts the sample of the enlarged region's pixel where it belongs.
    """
    width, height = region.width * supersampling, region.height * supersampling
    focal = camera.focal_px * supersampling
    centre = enlarged(camera.centre_px, region, supersampling)
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 * focal / width
    matrix[1, 1] = 2.0 * focal / height
    matrix[0, 2] = 1.0 - 2.0 * centre[0] / width
    matrix[1, 2] = 2.0 * (centre[1] + 1.0) / height - 1.0
    matrix[2, 2] = -(FAR_M + NEAR_M) / (FAR_M - NEAR_M)
    matrix[2, 3] = -2.0 * FAR_M * NEAR_M / (FAR_M - NEAR_M)
    matrix[3, 2] = -1.0
    return [float(value) for value in matrix.T.ravel()]


def enlarged(pixels: FloatArray, region: Region, supersampling: int) -> FloatArray:
    """Take pixels (..., 2) of the picture to pixels of the enlarged region; centres at integers in both."""
    first = np.array([region.left, region.top])
    return np.asarray((pixels - first + 0.5) * supersampling - 0.5)
