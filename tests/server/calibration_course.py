"""Random cameras and short drives in front of them: what the calibration is measured on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.calibration.keyframes import TagMount
from revnm_server.floor_camera import FloorCamera

MOUNT = TagMount(size_m=0.30, height_m=0.14)
SIZE_PX = (640, 480)


@dataclass(frozen=True)
class Moment:
    """What is measured at one time, and the truth."""

    pixel: FloatArray
    heading: FloatArray
    corners: FloatArray
    odom_from_robot: Pose2
    floor_from_robot: Pose2


def random_camera(rng: np.random.Generator, distortion: float = 0.0) -> FloorCamera:
    hfov = math.radians(rng.uniform(60.0, 120.0))
    focal = SIZE_PX[0] / (2.0 * math.tan(hfov / 2.0))
    pitch, roll = math.radians(rng.uniform(15.0, 50.0)), math.radians(rng.uniform(-2.0, 2.0))
    return FloorCamera(SIZE_PX, focal, pitch, roll, rng.uniform(1.8, 4.0), distortion)


def inside(camera: FloorCamera, points_m: FloatArray, border_px: float = 8.0) -> bool:
    pixels, depth = camera.project(points_m)
    limit = np.array(SIZE_PX) - 1.0 - border_px
    return bool(((pixels >= border_px) & (pixels <= limit)).all() and (depth > 0.2).all())


def tag_points(pose: Pose2) -> FloatArray:
    local = np.concatenate([np.zeros((1, 2)), [[0.01, 0.0]], MOUNT.corners_m()])
    return np.column_stack([pose.apply(local), np.full(6, MOUNT.height_m)])


def drive(
    camera: FloorCamera,
    rng: np.random.Generator,
    way_m: float,
    *,
    pixel_px: float = 0.5,
    heading_rad: float = math.radians(3.0),
) -> list[Moment]:
    """Drive gentle arcs in sight of the camera, 2.5 to 6 m from it, and measure every 5 cm."""
    while True:
        distance, angle = rng.uniform(2.5, 6.0), rng.uniform(-0.5, 0.5)
        pose = Pose2(distance * math.cos(angle), distance * math.sin(angle), rng.uniform(-math.pi, math.pi))
        track = _track(pose, rng, way_m)
        if all(inside(camera, tag_points(place)) for place in track):
            return _measure(camera, track, rng, pixel_px, heading_rad)


def _track(pose: Pose2, rng: np.random.Generator, way_m: float) -> list[Pose2]:
    track, driven = [pose], 0.0
    curvature = 0.0
    while driven < way_m - 1e-9:
        if round(driven / 0.05) % 10 == 0:
            curvature = rng.uniform(-1.2, 1.2)
        pose = pose @ Pose2(0.05, 0.0, 0.05 * curvature)
        track.append(pose)
        driven += 0.05
    return track


def _measure(
    camera: FloorCamera, track: list[Pose2], rng: np.random.Generator, pixel_px: float, heading_rad: float
) -> list[Moment]:
    scale, turn, drift = np.clip(rng.normal(size=3), -2.0, 2.0) * 0.02
    odom, moments, before = Pose2(0.0, 0.0, 0.0), [], track[0]
    for pose in track:
        step = before.inverse() @ pose
        way = math.hypot(step.x_m, step.y_m)
        odom @= Pose2(step.x_m * (1.0 + scale), step.y_m * (1.0 + scale), step.yaw_rad * (1.0 + turn) + drift * way)
        before = pose
        pixels, _ = camera.project(tag_points(pose))
        along = pixels[1] - pixels[0]
        bearing = math.atan2(along[1], along[0]) + rng.normal(0.0, heading_rad)
        noisy = pixels + rng.normal(0.0, pixel_px, pixels.shape)
        heading = np.array([math.cos(bearing), math.sin(bearing)])
        moments.append(Moment(noisy[0], heading, noisy[2:], odom, pose))
    return moments


def around(
    camera: FloorCamera, pose: Pose2, distance_m: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return points (M, 2) on the floor at a distance, robot frame, that the camera sees, and their pixels (M, 2)."""
    angles = rng.uniform(-math.pi, math.pi, 12)
    local = distance_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    world = np.column_stack([pose.apply(local), np.zeros(12)])
    seen = np.array([inside(camera, point[None], 0.0) for point in world])
    pixels, _ = camera.project(world[seen])
    return local[seen], pixels
