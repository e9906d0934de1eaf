"""Renders what the networks see in the states of an episode, with the server's own observation code.

The world's background is cast once an episode; a state adds its robot, so a sample costs little. Imports numpy,
OpenCV and numba only: neither torch nor PyBullet.

Symbols: N frames of history (the newest last), H waypoints, R = 1 robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import FileError
from revnm_client.geometry import FloatArray, Pose2
from revnm_server.frame import RobotSighting
from revnm_server.observation import (
    Image32,
    ImagePose,
    ObservationSpec,
    crop_around,
    exo_view,
    normalise_disparity,
    normalise_ego_depth,
    normalise_pixel,
)
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import (
    cast_depth,
    cast_depths,
    disparity_from_depth,
    ego_camera,
    overlay_depth,
    robot_primitive,
)
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.world import World, primitive_arrays
from revnm_sim.worlds import generated_world, is_generated
from revnm_training.augment import DisparityError, Disturbance, draw_error
from revnm_training.episodes import Episode
from revnm_training.render_device import DepthCaster


@dataclass(frozen=True, slots=True)
class Sample:
    """One training sample.

    Attributes:
        exo: (N, h, w) disparity in [0, 1].
        crop: (N, crop_px, crop_px) disparity in [0, 1].
        ego: (N, ego_px, ego_px) true ego depth in [−1, 1].
        robot: (2,) p_rob, normalised pixel.
        heading: (2,) q_rel, unit vector.
        goal: (2,) normalised pixel.
        waypoints: (H, 2) metres, robot frame.
    """

    exo: Image32
    crop: Image32
    ego: Image32
    robot: FloatArray
    heading: FloatArray
    goal: FloatArray
    waypoints: NDArray[np.float32]


def build_world(family: str, seed: int) -> World:
    """Generate the world that an episode names.

    Raises:
        FileError: There is no such family.
    """
    if not is_generated(family):
        raise FileError(f"world family {family!r}: no such family of generated worlds")
    return generated_world(family, seed)


def goal_pixel(camera: Camera, goal_m: FloatArray) -> FloatArray:
    """Return the pixel (2,) at which an operator would click a goal (2,) on the floor."""
    pixel, _ = camera.project(np.append(goal_m, 0.0))
    return pixel


class SceneRenderer:
    """Renders exactly what there is to see in one world with one camera: the background is cast once."""

    def __init__(
        self,
        world: World,
        camera: Camera,
        spec: ObservationSpec,
        *,
        robot: RobotSpec | None = None,
        cast: DepthCaster = cast_depths,
    ) -> None:
        self._camera, self._spec, self._cast = camera, spec, cast
        self._robot = robot or RobotSpec()
        self._arrays = primitive_arrays(world.primitives)
        self._background = cast_depth(self._arrays, camera, spec.disparity_hw)

    def background(self) -> Image32:
        """Return the disparity (h, w), 1/m, of the world without a robot."""
        return disparity_from_depth(self._background)

    def disparity(self, pose: Pose2) -> Image32:
        """Return the disparity (h, w), 1/m, with a robot at ``world_from_robot``."""
        body = robot_primitive(pose, self._robot)
        return disparity_from_depth(overlay_depth(self._background, self._camera, body))

    def sighting(self, pose: Pose2) -> RobotSighting:
        """Return what a perfect tag detector reports of a robot at ``world_from_robot``."""
        return see_robot(self._camera, pose, self._robot, robot="robot", stamp_ns=0)

    def egos(self, poses: Sequence[Pose2]) -> Image32:
        """Return the ego depths (B, ego_px, ego_px) in [−1, 1] of robots at B poses, ``world_from_robot``."""
        side = self._spec.ego_px
        depths = self._cast(self._arrays, [ego_camera(pose, self._spec) for pose in poses], (side, side))
        return normalise_ego_depth(depths, self._spec)


class EpisodeRenderer:
    """Renders the samples of one episode."""

    def __init__(
        self,
        episode: Episode,
        spec: ObservationSpec,
        *,
        robot: RobotSpec | None = None,
        cast: DepthCaster = cast_depths,
    ) -> None:
        self._episode = episode
        self._spec = spec
        world = build_world(episode.family, episode.world_seed)
        self._scene = SceneRenderer(world, episode.camera, spec, robot=robot, cast=cast)
        egos = self._scene.egos([Pose2(*pose) for pose in episode.poses.reshape(-1, 3)])
        self._egos = egos.reshape(*episode.poses.shape[:2], spec.ego_px, spec.ego_px)
        self._low, self._high = np.percentile(self._scene.background(), (2.0, 98.0))

    def sample(self, state: int, rng: np.random.Generator, disturbance: Disturbance | None) -> Sample:
        """Render a state.

        Args:
            state: Its number in the episode.
            rng: For the disturbance.
            disturbance: Errors of depth network and tag detector; None renders the exact sample.
        """
        episode, camera, spec = self._episode, self._episode.camera, self._spec
        size = (camera.width_px, camera.height_px)
        poses = [Pose2(*pose) for pose in episode.poses[state]]
        pose = self._image_pose(poses[-1], rng, disturbance)
        error = draw_error(disturbance, rng) if disturbance else None
        disparities = [self._disparity(earlier, error, rng) for earlier in poses]
        aspect = camera.width_px / camera.height_px
        goal = goal_pixel(camera, episode.goals_m[episode.goal[state]])
        return Sample(
            exo=np.stack([exo_view(disparity, spec) for disparity in disparities]),
            crop=np.stack([crop_around(disparity, pose, aspect, spec) for disparity in disparities]),
            ego=self._egos[state],
            robot=pose.p_rob,
            heading=pose.q_rel,
            goal=normalise_pixel(goal, size),
            waypoints=episode.waypoints_m[state],
        )

    def _disparity(self, pose: Pose2, error: DisparityError | None, rng: np.random.Generator) -> Image32:
        disparity = self._scene.disparity(pose)
        if error is not None:
            span = max(float(self._high - self._low), 1e-6)
            disparity = error.apply(((disparity - self._low) / span).astype(np.float32), rng)
        return normalise_disparity(disparity)

    def _image_pose(self, pose: Pose2, rng: np.random.Generator, disturbance: Disturbance | None) -> ImagePose:
        camera = self._episode.camera
        sighting = self._scene.sighting(pose)
        pixel, heading = sighting.pixel, sighting.heading
        if disturbance is not None:
            pixel = pixel + disturbance.pixel * camera.width_px * rng.standard_normal(2)
            turn = disturbance.heading_rad * rng.standard_normal()
            c, s = math.cos(turn), math.sin(turn)
            heading = np.array([c * heading[0] - s * heading[1], s * heading[0] + c * heading[1]])
        return ImagePose(normalise_pixel(pixel, (camera.width_px, camera.height_px)), heading)
