"""The remote camera's picture: PyBullet's software renderer, made fast enough for a live camera.

The camera and the world stand still, so they are rendered once, with their depth; a frame renders only the
robot, through the part of the view frustum that sees it, and lays it over the background where it is nearer.
"""

from __future__ import annotations

from types import TracebackType
from typing import Self

import cv2
import numpy as np
import pybullet
from numpy.typing import NDArray

from revnm_client.geometry import Pose2
from revnm_sim.camera import Camera
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.robot_model import PLATE_JOINT, WHEEL_RADIUS_M
from revnm_sim.scene import add_floor, add_obstacle, add_robot, yaw_quaternion
from revnm_sim.software_renderer import NEAR_M, Region, Shot, enlarged, render
from revnm_sim.tag_picture import TagPicture
from revnm_sim.world import World

_SKY_RGB = (176, 190, 204)
_SUPERSAMPLING = 2
_MARGIN_PX = 2


class CameraRenderer:
    """Renders what a camera sees of a world and of the robot in it.

    It owns a PyBullet client with nothing in it but the robot, apart from the client of the physics.
    """

    def __init__(self, world: World, camera: Camera, spec: RobotSpec, *, tag_id: int) -> None:
        self._camera = camera
        self._spec = spec
        self._tag = TagPicture(tag_id)
        self._background = _render_world(world, camera)
        whole = Region(0, 0, camera.width_px, camera.height_px)
        self._still = _shrink(self._background.colours, whole)
        self._client: int = pybullet.connect(pybullet.DIRECT)
        self._robot, joints = add_robot(self._client, Pose2(0.0, 0.0, 0.0), spec)
        self._plate = self._robot + ((joints[PLATE_JOINT] + 1) << 24)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the PyBullet client; a second call does nothing."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def picture(self, world_from_robot: Pose2 | None) -> NDArray[np.uint8]:
        """Return the picture (H, W, 3) uint8 RGB with the robot at a pose, or without it."""
        picture = self._still.copy()
        region = self._robot_region(world_from_robot) if world_from_robot else None
        if region is None or world_from_robot is None:
            return picture
        self._place_robot(world_from_robot)
        robot = render(self._client, self._camera, region, _SUPERSAMPLING)
        behind = _cut(self._background, region)
        in_front = (robot.parts >= 0) & (robot.depth < behind.depth)
        colours = np.where(in_front[:, :, None], robot.colours, behind.colours)
        self._print_tag(colours, in_front & (robot.parts == self._plate), region, world_from_robot)
        rows = slice(region.top, region.top + region.height)
        columns = slice(region.left, region.left + region.width)
        picture[rows, columns] = _shrink(colours, region)
        return picture

    def _place_robot(self, pose: Pose2) -> None:
        # PyBullet counts from the centre of mass, which lies at the axle.
        pybullet.resetBasePositionAndOrientation(
            self._robot,
            (pose.x_m, pose.y_m, WHEEL_RADIUS_M),
            yaw_quaternion(pose.yaw_rad),
            physicsClientId=self._client,
        )

    def _robot_region(self, pose: Pose2) -> Region | None:
        """Return the pixels that the robot may cover, or None if it is out of the picture."""
        camera, spec = self._camera, self._spec
        x, y = spec.length_m / 2.0, spec.width_m / 2.0
        footprint = pose.apply(np.array([[x, y], [x, -y], [-x, -y], [-x, y]]))
        box = np.vstack([np.column_stack([footprint, np.full(4, z)]) for z in (0.0, spec.top_m)])
        pixels, depths = camera.project(box)
        if depths.max() <= NEAR_M:
            return None
        if depths.min() <= NEAR_M:
            return Region(0, 0, camera.width_px, camera.height_px)
        size = np.array([camera.width_px, camera.height_px])
        low = np.clip(np.floor(pixels.min(axis=0)) - _MARGIN_PX, 0, size).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)) + _MARGIN_PX + 1, 0, size).astype(int)
        if (high <= low).any():
            return None
        return Region(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))

    def _print_tag(self, colours: NDArray[np.uint8], on_plate: NDArray[np.bool_], region: Region, pose: Pose2) -> None:
        """Print the tag on the visible part of its plate."""
        if not on_plate.any():
            return
        sighting = see_robot(self._camera, pose, self._spec, robot="", stamp_ns=0)
        corners = enlarged(sighting.corners, region, _SUPERSAMPLING)
        ink = self._tag.warped(corners, (colours.shape[1], colours.shape[0]))
        colours[on_plate] = (colours[on_plate] * ink[on_plate, None] + 0.5).astype(np.uint8)


def _render_world(world: World, camera: Camera) -> Shot:
    """Render the world without a robot, supersampled."""
    client: int = pybullet.connect(pybullet.DIRECT)
    try:
        add_floor(client, world)
        for primitive in world.primitives:
            add_obstacle(client, primitive)
        shot = render(client, camera, Region(0, 0, camera.width_px, camera.height_px), _SUPERSAMPLING)
    finally:
        pybullet.disconnect(physicsClientId=client)
    colours = np.where(shot.parts[:, :, None] < 0, np.array(_SKY_RGB, dtype=np.uint8), shot.colours)
    return Shot(colours, shot.depth.copy(), shot.parts[:0])


def _cut(shot: Shot, region: Region) -> Shot:
    rows = slice(region.top * _SUPERSAMPLING, (region.top + region.height) * _SUPERSAMPLING)
    columns = slice(region.left * _SUPERSAMPLING, (region.left + region.width) * _SUPERSAMPLING)
    return Shot(shot.colours[rows, columns], shot.depth[rows, columns], shot.parts[:0])


def _shrink(colours: NDArray[np.uint8], region: Region) -> NDArray[np.uint8]:
    size = (region.width, region.height)
    return np.asarray(cv2.resize(colours, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
