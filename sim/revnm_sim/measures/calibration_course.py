"""Random cameras and short drives in front of them: what the calibration is measured on.

No world and no physics: a robot on a plane, its tag's corners with noise, odometry with the errors of its wheels.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.calibration.calibrator import Calibrator
from revnm_server.calibration.keyframes import Keyframe, TagMount, Travel
from revnm_server.calibration.spread import in_robot, in_robot_covariances
from revnm_server.floor_camera import FloorCamera
from revnm_sim.robot import RobotSpec
from revnm_sim.sensors import OdometrySpec

SIZE_PX = (640, 480)
MOUNT = TagMount(RobotSpec().tag_m, RobotSpec().top_m)
PIXEL_PX = 0.5
HEADING_RAD = math.radians(3.0)
_STEP_M = 0.05
_BEND_EVERY = 10  # steps after which the curvature is drawn anew
_MOST_CURVATURE = 1.2  # 1/m
_BORDER_PX = 8.0
_DIRECTIONS = 12


@dataclass(frozen=True, slots=True)
class Moment:
    """What is measured at one time, and the truth.

    Attributes:
        pixel: (2,) the tag's centre, with noise.
        heading: (2,) unit vector in the picture, with noise.
        corners: (4, 2) the tag's corners, with noise.
        odom_from_robot: By the wheels.
        floor_from_robot: The truth.
    """

    pixel: FloatArray
    heading: FloatArray
    corners: FloatArray
    odom_from_robot: Pose2
    floor_from_robot: Pose2


def random_camera(rng: np.random.Generator) -> FloorCamera:
    """Draw a camera 1.8 to 4 m up, bent down by 15° to 50°, 60° to 120° wide, its roll within ± 2°."""
    hfov = math.radians(rng.uniform(60.0, 120.0))
    focal = SIZE_PX[0] / (2.0 * math.tan(hfov / 2.0))
    pitch, roll = math.radians(rng.uniform(15.0, 50.0)), math.radians(rng.uniform(-2.0, 2.0))
    return FloorCamera(SIZE_PX, focal, pitch, roll, rng.uniform(1.8, 4.0))


def drive(camera: FloorCamera, rng: np.random.Generator, way_m: float) -> list[Moment]:
    """Drive gentle arcs in sight of a camera, from 2.5 to 6 m before it, and measure every 5 cm."""
    while True:
        distance, angle = rng.uniform(2.5, 6.0), rng.uniform(-0.5, 0.5)
        start = Pose2(distance * math.cos(angle), distance * math.sin(angle), rng.uniform(-math.pi, math.pi))
        track = _track(start, rng, way_m)
        if all(_inside(camera, _tag_points(place), _BORDER_PX).all() for place in track):
            return _measure(camera, track, rng)


def around(
    camera: FloorCamera, pose: Pose2, distance_m: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return the places (M, 2) on the floor at a distance from a robot, its frame, that are seen, and their pixels."""
    angles = rng.uniform(-math.pi, math.pi, _DIRECTIONS)
    local = distance_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    world = np.column_stack([pose.apply(local), np.zeros(_DIRECTIONS)])
    seen = _inside(camera, world, 0.0)
    return local[seen], camera.project(world[seen])[0]


class Learner:
    """A calibrator that is shown drives, and its errors.

    Attributes:
        calibrator: What learns.
        times_ms: How long each sighting that became a keyframe took.
    """

    def __init__(self, *, corners: bool = True, calibrator: Calibrator | None = None) -> None:
        """Begin.

        Args:
            corners: Whether sightings have corners, or centre and heading alone.
            calibrator: What learns; by default one that knows nothing.
        """
        self.calibrator = calibrator or Calibrator(SIZE_PX)
        self.times_ms: list[float] = []
        self._corners = corners
        self._travel: Travel | None = None
        self._drive = 0

    def see(self, moment: Moment) -> None:
        """Show a moment of the present drive."""
        odom = moment.odom_from_robot
        self._travel = Travel(odom) if self._travel is None else self._travel.on(odom)
        corners = moment.corners if self._corners else None
        frame = Keyframe(moment.pixel, moment.heading, corners, self._travel, MOUNT, self._drive)
        before, begin = self.calibrator.state.keyframes, time.perf_counter()
        self.calibrator.observe(frame)
        passed_ms = 1e3 * (time.perf_counter() - begin)
        if self.calibrator.state.keyframes != before:
            self.times_ms.append(passed_ms)

    def begin_drive(self) -> None:
        """Begin another drive, whose odometry has nothing to do with the last one's."""
        self._drive += 1
        self._travel = None

    def place(self) -> Pose2 | None:
        """Return floor_from_robot as the calibrator has it now."""
        assert self._travel is not None
        return self.calibrator.floor_from_robot(self._travel, self._drive)

    def errors(self, camera: FloorCamera, truth: Pose2, distance_m: float) -> tuple[FloatArray, FloatArray]:
        """Compare places at a distance from the robot, seen at their true pixels, with the truth.

        Returns:
            Distances (M,), metres, and squared distances (M,) in the measure of the calibrator's covariance.
        """
        local, pixels = around(camera, truth, distance_m, np.random.default_rng(0))
        pose = self.place()
        assert pose is not None
        vector = np.concatenate([self.calibrator.belief.mean, pose])
        off = in_robot(vector, SIZE_PX, pixels) - local
        covariances = in_robot_covariances(vector, self.calibrator.covariance_with(self._drive), SIZE_PX, pixels)
        return np.linalg.norm(off, axis=1), np.einsum("mi,mij,mj->m", off, np.linalg.inv(covariances), off)


def _track(pose: Pose2, rng: np.random.Generator, way_m: float) -> list[Pose2]:
    track, curvature = [pose], 0.0
    for step in range(round(way_m / _STEP_M)):
        if step % _BEND_EVERY == 0:
            curvature = rng.uniform(-_MOST_CURVATURE, _MOST_CURVATURE)
        pose @= Pose2(_STEP_M, 0.0, _STEP_M * curvature)
        track.append(pose)
    return track


def _measure(camera: FloorCamera, track: list[Pose2], rng: np.random.Generator) -> list[Moment]:
    spec = OdometrySpec()
    sigmas = np.array([spec.scale_sigma, spec.turn_sigma, spec.drift_sigma_radpm])
    scale, turn, drift = np.clip(rng.normal(size=3), -2.0, 2.0) * sigmas
    odom, before, moments = Pose2(0.0, 0.0, 0.0), track[0], list[Moment]()
    for pose in track:
        step = before.inverse() @ pose
        way = math.hypot(step.x_m, step.y_m)
        odom @= Pose2(step.x_m * (1.0 + scale), step.y_m * (1.0 + scale), step.yaw_rad * (1.0 + turn) + drift * way)
        before = pose
        pixels, _ = camera.project(_tag_points(pose))
        along = pixels[1] - pixels[0]
        bearing = math.atan2(along[1], along[0]) + rng.normal(0.0, HEADING_RAD)
        noisy = pixels + rng.normal(0.0, PIXEL_PX, pixels.shape)
        heading = np.array([math.cos(bearing), math.sin(bearing)])
        moments.append(Moment(noisy[0], heading, noisy[2:], odom, pose))
    return moments


def _tag_points(pose: Pose2) -> FloatArray:
    """Return (6, 3): the tag's centre, a point ahead of it, its corners."""
    local = np.concatenate([np.zeros((1, 2)), [[0.01, 0.0]], MOUNT.corners_m()])
    return np.column_stack([pose.apply(local), np.full(len(local), MOUNT.height_m)])


def _inside(camera: FloorCamera, points_m: FloatArray, border_px: float) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    pixels, depth = camera.project(points_m)
    limit = np.array(SIZE_PX) - 1.0 - border_px
    return np.asarray(((pixels >= border_px) & (pixels <= limit)).all(axis=1) & (depth > 0.2))
