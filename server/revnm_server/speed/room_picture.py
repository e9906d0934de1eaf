"""What the room's camera sees: floor, walls, boxes and robots with their tags, painted from far to near.

Flat colours with a little noise: enough for the tag detector and for a depth network to work on. Imports numpy and
OpenCV only.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.frame import Frame
from revnm_server.speed.room import (
    BOXES,
    CAMERA,
    ROBOT_LENGTH_M,
    ROBOT_WIDTH_M,
    TAG_HEIGHT_M,
    TAG_SIZE_M,
    WALLS,
    Room,
)
from revnm_server.tag.family import CELLS, RIM_CELLS, upright_cells

Picture = NDArray[np.uint8]

_FLOOR, _WALL, _BODY = (150, 140, 128), (196, 196, 188), (60, 62, 70)
_COLOURS = ((170, 90, 70), (90, 120, 160), (120, 150, 90), (160, 140, 80), (110, 100, 140), (90, 150, 150))
_SIDE_SHADE, _FRONT_SHADE = 0.6, 0.8
_NOISE = 4.0


class RoomPainter:
    """Paints a room; always the same noise."""

    def __init__(self, tags: dict[str, int]) -> None:
        """Prepare what does not move.

        Args:
            tags: Tag id by robot.
        """
        width, height = CAMERA.size_px
        noise = np.random.default_rng(0).normal(0.0, _NOISE, (height, width, 1))
        self._empty = np.asarray(np.clip(np.array(_FLOOR) + noise, 0, 255), dtype=np.uint8)
        for wall in WALLS:
            _paint_prism(self._empty, wall.outline_m, wall.height_m, _WALL)
        self._tags = {robot: _tag(number) for robot, number in tags.items()}

    def frame(self, room: Room) -> Frame:
        """Return the picture of this moment."""
        picture = self._empty.copy()
        things = [(box.outline_m, box.height_m, colour, "") for box, colour in zip(BOXES, _COLOURS, strict=True)]
        things += [
            (robot.pose.apply(_outline(ROBOT_LENGTH_M, ROBOT_WIDTH_M)), TAG_HEIGHT_M, _BODY, robot.name)
            for robot in room.robots
        ]
        poses = {robot.name: robot.pose for robot in room.robots}
        for outline_m, height_m, colour, robot in sorted(things, key=lambda each: -np.hypot(*each[0].mean(axis=0))):
            _paint_prism(picture, outline_m, height_m, colour)
            if robot:
                _paint_tag(picture, self._tags[robot], poses[robot])
        return Frame(picture, room.stamp_ns, room.stamp_ns)


def _outline(length_m: float, width_m: float) -> FloatArray:
    """Return (4, 2), counter-clockwise: front left, rear left, rear right, front right."""
    return 0.5 * np.array([[length_m, width_m], [-length_m, width_m], [-length_m, -width_m], [length_m, -width_m]])


def _paint_prism(picture: Picture, outline_m: FloatArray, height_m: float, colour: tuple[int, int, int]) -> None:
    """Paint something upright on an outline (4, 2): the sides that face the camera, and its top."""
    top = np.column_stack([outline_m, np.full(4, height_m)])
    bottom = np.column_stack([outline_m, np.zeros(4)])
    for first in range(4):
        second = (first + 1) % 4
        along = outline_m[second] - outline_m[first]
        outward = np.array([along[1], -along[0]])
        if outward @ outline_m[first] < 0.0:  # the camera is over the origin
            shade = _FRONT_SHADE if abs(outward[0]) > abs(outward[1]) else _SIDE_SHADE
            _fill(picture, np.stack([bottom[first], bottom[second], top[second], top[first]]), colour, shade)
    if height_m < CAMERA.height_m:
        _fill(picture, top, colour, 1.0)


def _fill(picture: Picture, points_m: FloatArray, colour: tuple[int, int, int], shade: float) -> None:
    pixels, depths = CAMERA.project(points_m)
    if (depths > 0.0).all():
        shaded = tuple(round(shade * part) for part in colour)
        cv2.fillConvexPoly(picture, np.rint(pixels).astype(np.int32), shaded, lineType=cv2.LINE_AA)


def _tag(number: int) -> Picture:
    """Return a tag's cells (10, 10) with its white rim, its upper edge at the robot's front."""
    cells = 255 * upright_cells(number).astype(np.uint8)
    return np.pad(cells, RIM_CELLS, constant_values=255)


def _paint_tag(picture: Picture, cells: Picture, pose: Pose2) -> None:
    """Paint a tag on a robot's top: its upper edge lies forward."""
    rim_m = TAG_SIZE_M * (CELLS + 2 * RIM_CELLS) / CELLS
    corners_m = pose.apply(_outline(rim_m, rim_m)[[0, 3, 2, 1]])  # front left, front right, rear right, rear left
    pixels, _ = CAMERA.project(np.column_stack([corners_m, np.full(4, TAG_HEIGHT_M)]))
    left, top = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 1, 0, CAMERA.size_px)
    right, bottom = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 2, 0, CAMERA.size_px)
    if right <= left or bottom <= top:
        return
    side = float(np.linalg.norm(pixels - np.roll(pixels, 1, axis=0), axis=1).max())
    cell_px = max(2, round(side / CELLS))  # about one texel a pixel
    texture = np.kron(cells, np.ones((cell_px, cell_px), dtype=np.uint8))
    reach = len(texture) - 0.5
    source = np.array([[-0.5, -0.5], [reach, -0.5], [reach, reach], [-0.5, reach]], dtype=np.float32)
    matrix = cv2.getPerspectiveTransform(source, (pixels - (left, top)).astype(np.float32))
    size = int(right - left), int(bottom - top)
    drawn = cv2.warpPerspective(texture, matrix, size, flags=cv2.INTER_LINEAR)
    inside = cv2.warpPerspective(np.full_like(texture, 255), matrix, size, flags=cv2.INTER_NEAREST) > 0
    picture[top:bottom, left:right][inside] = drawn[inside][:, None]
