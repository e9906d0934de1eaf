"""Robust least squares over a camera, the drives' odometry errors and the robots' poses (bundle adjustment).

Unknown are the camera (5 parameters), three odometry errors of each of D drives, and the floor_from_robot pose of each
of K keyframes. Known are what the camera saw and what odometry measured between the keyframes of a drive; a sighting or
a stretch of odometry that fits badly counts little, as a whole (Cauchy weights). Levenberg–Marquardt with group weights
is written out here because SciPy's losses weight single residuals, and its trust region takes several times as long.
Imports numpy only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.calibration.keyframes import Keyframe, relative
from revnm_server.floor_camera import PARAMETERS, project

_STEP = 1e-6  # of numeric derivatives
_CAUCHY = 2.0  # residuals in standard deviations from which a group begins to count less
_ENOUGH = 0.02  # gain of a step, in variances, below which the search ends
_SEEN = 11  # residuals of a sighting: eight of corners, two of the centre, one of the heading
_PLACE_M = 100.0  # robots stand so near to the camera: what is seen at the horizon does not run away
_ODOMETRY_M = (0.001, 0.005)  # noise of a stretch: constant, and per metre of way
_ODOMETRY_RAD = (0.001, 0.003, 0.005)  # constant, per metre of way, per radian of turning


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of what is measured.

    Attributes:
        pixel_px: Of a corner's or a centre's coordinate.
        heading_rad: Of a heading in the picture that was not measured by corners.
        odometry_scale: Relative, of distances of a drive, as by a wrong wheel radius.
        odometry_turn: Relative, of turns.
        odometry_drift_radpm: Of a drive's heading per metre.
    """

    pixel_px: float = 0.5
    heading_rad: float = math.radians(3.0)
    odometry_scale: float = 0.02
    odometry_turn: float = 0.02
    odometry_drift_radpm: float = 0.02


@dataclass(frozen=True, slots=True)
class Belief:
    """A Gaussian over the camera's parameters.

    Attributes:
        mean: (5,) of :attr:`revnm_server.floor_camera.FloorCamera.vector`.
        covariance: (5, 5).
    """

    mean: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Estimate:
    """Unknowns at one point of the search.

    Attributes:
        camera: (5,).
        drives: (D, 3) relative errors of distance and turn, drift in rad/m.
        poses: (K, 3) floor_from_robot (x, y, yaw).
    """

    camera: FloatArray
    drives: FloatArray
    poses: FloatArray

    def moved(self, step: FloatArray) -> Estimate:
        """Return the estimate after a step (5 + 3 D + 3 K,)."""
        split = PARAMETERS + self.drives.size
        return Estimate(
            self.camera + step[:PARAMETERS],
            self.drives + step[PARAMETERS:split].reshape(-1, 3),
            self.poses + step[split:].reshape(-1, 3),
        )


@dataclass(frozen=True, slots=True)
class Solution:
    """The result.

    Attributes:
        estimate: The best unknowns.
        covariance: (5 + 3 D + 3 K, same) of them, in this order.
        misfit: Median over the keyframes of their sightings' mean squared residual, in variances; about 1 is expected.
        cost: Sum of the robust costs, the priors' included.
        weights: (K,) in (0, 1], how much each sighting counts.
    """

    estimate: Estimate
    covariance: FloatArray
    misfit: float
    cost: float
    weights: FloatArray


class Adjustment:
    """The problem of one set of keyframes."""

    def __init__(self, frames: list[Keyframe], prior: Belief, noise: Noise, size_px: tuple[int, int]) -> None:
        """Gather the measurements; the frames of a drive stand in the order of time."""
        self._size_px, self._prior = size_px, prior
        self._information = np.linalg.cholesky(np.linalg.inv(prior.covariance)).T
        numbers = [frame.drive for frame in frames]
        drives = sorted(set(numbers))
        self.drive = np.array([drives.index(number) for number in numbers])
        self.drive_count = len(drives)
        self._drive_sigma = np.array([noise.odometry_scale, noise.odometry_turn, noise.odometry_drift_radpm])
        self._measure(frames, noise)
        self._pairs(frames)

    def _measure(self, frames: list[Keyframe], noise: Noise) -> None:
        self._corners_m = np.stack([frame.mount.corners_m() for frame in frames])  # (K, 4, 2)
        self._tag_m = np.array([frame.mount.height_m for frame in frames])
        cornered = np.array([frame.corners is not None for frame in frames])
        self._corners = np.stack([np.zeros((4, 2)) if f.corners is None else f.corners for f in frames])
        self._centre = np.stack([frame.pixel for frame in frames])
        self._heading = np.array([math.atan2(frame.heading[1], frame.heading[0]) for frame in frames])
        plain = [1.0 / noise.pixel_px] * 2 + [1.0 / noise.heading_rad]
        self._seen_weight = np.where(cornered[:, None], [1.0 / noise.pixel_px] * 8 + [0.0] * 3, [0.0] * 8 + plain)
        self._seen_count = np.where(cornered, 8.0, 3.0)

    def _pairs(self, frames: list[Keyframe]) -> None:
        """Link each keyframe with the one before of the same drive."""
        order = [i for d in range(self.drive_count) for i in np.flatnonzero(self.drive == d)]
        motions, ways = relative([frames[i] for i in order])
        linked = np.array([self.drive[a] == self.drive[b] for a, b in pairwise(order)], dtype=bool)
        self._before = np.array(order[:-1], dtype=int)[linked]
        self._after = np.array(order[1:], dtype=int)[linked]
        self._motion, self._ways = motions[linked], ways[linked]
        way, turn = self._ways[:, 1], self._ways[:, 2]
        along = _ODOMETRY_M[0] + _ODOMETRY_M[1] * way
        turned = _ODOMETRY_RAD[0] + _ODOMETRY_RAD[1] * way + _ODOMETRY_RAD[2] * turn
        self._motion_weight = 1.0 / np.stack([along, along, turned], axis=1)

    def sightings(self, camera: FloatArray, poses: FloatArray) -> FloatArray:
        """Return the weighted residuals (..., K, 11) of what the camera saw, for (..., K, 5) and (..., K, 3)."""
        c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        ahead = np.stack([c, s], axis=-1)[..., None, :]
        left = np.stack([-s, c], axis=-1)[..., None, :]
        place = poses[..., None, :2]
        corners = place + self._corners_m[..., :1] * ahead + self._corners_m[..., 1:] * left  # (..., K, 4, 2)
        points = np.concatenate([corners, place, place + 0.01 * ahead], axis=-2)
        heights = np.broadcast_to(self._tag_m[:, None, None], (*points.shape[:-1], 1))
        pixels, _ = project(camera[..., None, :], self._size_px, np.concatenate([points, heights], axis=-1))
        step = pixels[..., 5, :] - pixels[..., 4, :]
        off = np.arctan2(step[..., 1], step[..., 0]) - self._heading
        residuals = np.concatenate(
            [
                (pixels[..., :4, :] - self._corners).reshape(*pixels.shape[:-2], 8),
                pixels[..., 4, :] - self._centre,
                ((off + math.pi) % math.tau - math.pi)[..., None],
            ],
            axis=-1,
        )
        return np.asarray(residuals * self._seen_weight)

    def motions(self, before: FloatArray, after: FloatArray, drive: FloatArray) -> FloatArray:
        """Return the weighted residuals of odometry between poses, with the drives' errors; all (..., P, 3)."""
        yaw = before[..., 2]
        c, s = np.cos(yaw), np.sin(yaw)
        dx, dy = after[..., 0] - before[..., 0], after[..., 1] - before[..., 1]
        expected = corrected(self._motion, self._ways, drive)
        turn = after[..., 2] - yaw - expected[..., 2]
        residual = np.stack(
            [
                c * dx + s * dy - expected[..., 0],
                c * dy - s * dx - expected[..., 1],
                (turn + math.pi) % math.tau - math.pi,
            ],
            axis=-1,
        )
        return np.asarray(residual * self._motion_weight)

    def solve(self, start: Estimate, *, iterations: int = 12) -> Solution:
        """Search from a start for the unknowns that fit best."""
        estimate, damping = start, 1e-3
        cost = self._cost(estimate)
        for _ in range(iterations):
            hessian, gradient = self._normal(estimate)
            diagonal = np.diag(hessian)
            for _ in range(6):
                step = np.asarray(np.linalg.solve(hessian + np.diag(damping * diagonal), -gradient), dtype=np.float64)
                tried = estimate.moved(step)
                new_cost = self._cost(tried)
                if new_cost < cost:
                    break
                damping *= 10.0
            else:
                break
            gain, estimate, cost = cost - new_cost, tried, new_cost
            damping = max(damping * 0.2, 1e-9)
            if gain < _ENOUGH:
                break
        return self._solution(estimate, cost)

    def _solution(self, estimate: Estimate, cost: float) -> Solution:
        hessian, _ = self._normal(estimate)
        squares = self._seen_squares(estimate)
        misfit = float(np.median(squares / self._seen_count))
        covariance = np.asarray(np.linalg.inv(hessian) * max(1.0, misfit), dtype=np.float64)
        return Solution(estimate, covariance, misfit, cost, _weights(squares, self._seen_count))

    def _seen_squares(self, estimate: Estimate) -> FloatArray:
        camera = np.broadcast_to(estimate.camera, (len(estimate.poses), PARAMETERS))
        return np.asarray(np.square(self.sightings(camera, estimate.poses)).sum(axis=-1))

    def _motion_residuals(self, estimate: Estimate) -> FloatArray:
        poses = estimate.poses
        return self.motions(poses[self._before], poses[self._after], estimate.drives[self.drive[self._before]])

    def _cost(self, estimate: Estimate) -> float:
        groups = _costs(self._seen_squares(estimate), self._seen_count).sum()
        groups += _costs(np.square(self._motion_residuals(estimate)).sum(axis=-1), np.array(3.0)).sum()
        prior = np.square(self._information @ (estimate.camera - self._prior.mean)).sum()
        places = np.square(estimate.poses[:, :2] / _PLACE_M).sum()
        return float(groups + prior + places + np.square(estimate.drives / self._drive_sigma).sum())

    def _normal(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        """Return the weighted normal equations: matrix and gradient."""
        rows, residuals = zip(
            self._seen_rows(estimate), self._motion_rows(estimate), self._prior_rows(estimate), strict=True
        )
        jacobian, residual = np.concatenate(rows), np.concatenate(residuals)
        return jacobian.T @ jacobian, jacobian.T @ residual

    def _seen_rows(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        count = len(estimate.poses)
        camera = np.broadcast_to(estimate.camera, (count, PARAMETERS))
        nudges = _STEP * np.eye(PARAMETERS + 3)
        cameras = np.concatenate([camera[None], camera + nudges[:, None, :PARAMETERS]])  # (1 + 8, K, 5)
        poses = np.concatenate([estimate.poses[None], estimate.poses + nudges[:, None, PARAMETERS:]])
        values = self.sightings(cameras, poses)  # (9, K, 11)
        root = np.sqrt(_weights(np.square(values[0]).sum(axis=-1), self._seen_count))[:, None]
        slopes = (values[1:] - values[0]) / _STEP * root  # (8, K, 11)
        rows = np.zeros((count, _SEEN, self._width(estimate)))
        rows[:, :, :PARAMETERS] = slopes[:PARAMETERS].transpose(1, 2, 0)
        each = np.arange(count)
        for axis in range(3):
            rows[each, :, self._pose_column(each, axis)] = slopes[PARAMETERS + axis]
        return rows.reshape(-1, rows.shape[-1]), (values[0] * root).ravel()

    def _motion_rows(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        before, after = estimate.poses[self._before], estimate.poses[self._after]
        drive_of = self.drive[self._before]
        drive = estimate.drives[drive_of]
        nudges = np.concatenate([np.zeros((1, 9)), _STEP * np.eye(9)])[:, None]
        values = self.motions(before + nudges[..., :3], after + nudges[..., 3:6], drive + nudges[..., 6:])  # (10, P, 3)
        root = np.sqrt(_weights(np.square(values[0]).sum(axis=-1), np.array(3.0)))[:, None]
        slopes = (values[1:] - values[0]) / _STEP * root
        rows = np.zeros((len(before), 3, self._width(estimate)))
        each = np.arange(len(before))
        for axis in range(3):
            rows[each, :, self._pose_column(self._before, axis)] = slopes[axis]
            rows[each, :, self._pose_column(self._after, axis)] = slopes[3 + axis]
            rows[each, :, PARAMETERS + 3 * drive_of + axis] = slopes[6 + axis]
        return rows.reshape(-1, rows.shape[-1]), (values[0] * root).ravel()

    def _prior_rows(self, estimate: Estimate) -> tuple[FloatArray, FloatArray]:
        drive_sigma = np.tile(self._drive_sigma, self.drive_count)
        sigma = np.concatenate([drive_sigma, np.tile([_PLACE_M, _PLACE_M, np.inf], len(estimate.poses))])
        rows = np.diag(np.concatenate([np.zeros(PARAMETERS), 1.0 / sigma]))
        rows[:PARAMETERS, :PARAMETERS] = self._information
        camera = self._information @ (estimate.camera - self._prior.mean)
        others = np.concatenate([estimate.drives.ravel(), estimate.poses.ravel()])
        return rows, np.concatenate([camera, others / sigma])

    def _pose_column(self, frame: NDArray[np.int_], axis: int) -> NDArray[np.int_]:
        return PARAMETERS + 3 * self.drive_count + 3 * frame + axis

    def _width(self, estimate: Estimate) -> int:
        return PARAMETERS + estimate.drives.size + estimate.poses.size


def corrected(motion: FloatArray, ways: FloatArray, drive: FloatArray) -> FloatArray:
    """Return odometry's motions (P, 3) without their drives' errors (..., P, 3); ways (P, 3) as of :func:`relative`."""
    scale, turn, drift = drive[..., 0], drive[..., 1], drive[..., 2]
    extra = turn * motion[:, 2] + drift * ways[:, 0]
    c, s = np.cos(extra / 2.0), np.sin(extra / 2.0)  # the chord of an even arc turns by half
    x, y = motion[:, 0], motion[:, 1]
    return np.stack([(1.0 + scale) * (c * x - s * y), (1.0 + scale) * (s * x + c * y), motion[:, 2] + extra], axis=-1)


def _costs(squares: FloatArray, count: FloatArray) -> FloatArray:
    scale = _CAUCHY**2 * count
    return np.asarray(scale * np.log1p(squares / scale))


def _weights(squares: FloatArray, count: FloatArray) -> FloatArray:
    return np.asarray(1.0 / (1.0 + squares / (_CAUCHY**2 * count)))
