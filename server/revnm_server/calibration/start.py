"""Where the search for a calibration starts: focal length and pitch by trying, the rest in closed form.

For a focal length and a pitch the tag's pixels lie on a plane at a known shape but an unknown scale, which is the
camera's height over the tag; odometry says where the same points lie in metres. The similarity that brings both
together gives height and alignment, and how well they agree (weighted as by pixels) ranks the tries. Imports
numpy only.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2, wrap_angle
from revnm_server.calibration.adjustment import Belief, Estimate, corrected
from revnm_server.calibration.keyframes import Keyframe, relative
from revnm_server.floor_camera import on_plane

ComplexArray = NDArray[np.complex128]

_FOCALS, _PITCHES = 13, 13
_NOTHING = 1e-12
_SPREAD = 2.0  # tries reach so many standard deviations of the prior


def starts(
    frames: list[Keyframe], prior: Belief, size_px: tuple[int, int], *, pixel_px: float, count: int
) -> list[Estimate]:
    """Return starts for one drive's keyframes, the most credible first.

    Args:
        frames: Of one drive.
        prior: What is known before.
        size_px: Of the picture.
        pixel_px: Noise of a pixel coordinate.
        count: Most starts wanted.
    """
    pixels, places = _points(frames)
    grid = _tries(prior)
    unit = grid.copy()
    unit[:, 3] = 0.0  # the plane of the tags one metre below the camera
    points, valid = on_plane(unit[:, None], size_px, pixels[None])
    plane = points[..., 0] + 1j * points[..., 1]  # (G, N)
    motion, shift, cost = _similarities(plane, places, valid, np.exp(grid[:, 0]) * size_px[0] / pixel_px)
    heights = np.abs(motion) + frames[0].mount.height_m
    grid[:, 3] = np.log(np.maximum(heights, 1e-3))
    sigma = np.sqrt(np.diag(prior.covariance))
    cost += np.square((grid - prior.mean) / sigma)[:, [0, 1, 3]].sum(axis=1)
    best = [i for i in np.argsort(cost)[:count] if np.isfinite(cost[i])]
    return [Estimate(grid[i], np.zeros((1, 3)), _poses(frames, motion[i], shift[i])) for i in best]


def continued(
    frames: list[Keyframe],
    camera: FloatArray,
    size_px: tuple[int, int],
    *,
    poses: Mapping[int, FloatArray] | None = None,
    errors: Mapping[int, FloatArray] | None = None,
) -> Estimate:
    """Return a start from what is known already.

    Args:
        frames: All keyframes, those of a drive in the order of time.
        camera: (5,) its parameters.
        size_px: Of the picture.
        poses: floor_from_robot (3,) of keyframes by their ``id()``; others are carried on by odometry from the one
            before, and the first of a drive is placed by its tag.
        errors: (3,) odometry errors of drives by number; 0 where they are not known.
    """
    errors = errors or {}
    placed: dict[int, tuple[Keyframe, FloatArray]] = {}  # the last of each drive
    found = []
    for frame in frames:
        pose = (poses or {}).get(id(frame))
        if pose is None and frame.drive in placed:
            pose = _carried(*placed[frame.drive], frame, errors.get(frame.drive, np.zeros(3)))
        elif pose is None:
            pose = placed_by_tag(frame, camera, size_px)
        placed[frame.drive] = (frame, pose)
        found.append(pose)
    drives = [errors.get(drive, np.zeros(3)) for drive in sorted(placed)]
    return Estimate(camera, np.array(drives), np.array(found))


def placed_by_tag(frame: Keyframe, camera: FloatArray, size_px: tuple[int, int]) -> FloatArray:
    """Return floor_from_robot (3,) from where the tag's plane is at its pixel, and a little ahead."""
    pixels = np.stack([frame.pixel, frame.pixel + frame.heading])
    points, _ = on_plane(camera, size_px, pixels, frame.mount.height_m)
    ahead = points[1] - points[0]
    return np.array([*points[0], math.atan2(ahead[1], ahead[0])])


def _carried(last: Keyframe, pose: FloatArray, frame: Keyframe, errors: FloatArray) -> FloatArray:
    motion, ways = relative([last, frame])
    return np.array(Pose2(*pose) @ Pose2(*corrected(motion, ways, errors)[0]))


def _points(frames: list[Keyframe]) -> tuple[FloatArray, ComplexArray]:
    """Return pixels (N, 2) and the places (N,) of the same points in the odometry's frame, as complex numbers."""
    pixels, places = [], []
    for frame in frames:
        local = frame.mount.corners_m() if frame.corners is not None else np.zeros((1, 2))
        pixels.append(frame.corners if frame.corners is not None else frame.pixel[None])
        places.append(frame.travel.odom_from_robot.apply(local))
    found = np.concatenate(places)
    return np.concatenate(pixels), found[:, 0] + 1j * found[:, 1]


def _tries(prior: Belief) -> FloatArray:
    """Return the grid (G, 5) of focal lengths and pitches around the prior."""
    sigma = _SPREAD * np.sqrt(np.diag(prior.covariance))
    focals = prior.mean[0] + sigma[0] * np.linspace(-1.0, 1.0, _FOCALS)
    pitches = prior.mean[1] + sigma[1] * np.linspace(-1.0, 1.0, _PITCHES)
    grid = np.tile(prior.mean, (_FOCALS * _PITCHES, 1))
    grid[:, 0], grid[:, 1] = (axis.ravel() for axis in np.meshgrid(focals, np.clip(pitches, 0.02, 1.5)))
    return grid


def _similarities(
    plane: ComplexArray, places: ComplexArray, valid: NDArray[np.bool_], focal: FloatArray
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    """Fit places = motion × plane + shift for each try.

    Args:
        plane: (G, N) points on the plane one metre below the camera.
        places: (N,) the same points in the odometry's frame.
        valid: (G, N) which of the points lie on the plane at all.
        focal: (G,) focal length in standard deviations of a pixel.

    Returns:
        Motions (G,), shifts (G,), and the misfit (G,), in variances; inf where a point is not on the plane.
    """
    weight = np.where(valid, np.square(focal[:, None] / (1.0 + np.square(np.abs(plane)))), _NOTHING)
    total = weight.sum(axis=1)
    middle, place = (weight * plane).sum(axis=1) / total, (weight * places).sum(axis=1) / total
    off, away = plane - middle[:, None], places - place[:, None]
    motion = (weight * off.conj() * away).sum(axis=1) / ((weight * np.square(np.abs(off))).sum(axis=1) + _NOTHING)
    left = np.square(np.abs(away - motion[:, None] * off)) / (np.square(np.abs(motion[:, None])) + _NOTHING)
    misfit = np.where(valid.all(axis=1), (weight * left).sum(axis=1), np.inf)
    return motion, place - motion * middle, misfit


def _poses(frames: list[Keyframe], motion: complex, shift: complex) -> FloatArray:
    """Return floor_from_robot (K, 3) from odom = motion / |motion| × floor + shift."""
    odom_from_floor = Pose2(shift.real, shift.imag, math.atan2(motion.imag, motion.real))
    floor_from_odom = odom_from_floor.inverse()
    poses = [floor_from_odom @ frame.travel.odom_from_robot for frame in frames]
    return np.array([(pose.x_m, pose.y_m, wrap_angle(pose.yaw_rad)) for pose in poses])
