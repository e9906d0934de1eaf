"""The calibration of one camera as it is learnt: from sightings and odometry to the camera and the robots' places."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.calibration.adjustment import Adjustment, Belief, Estimate, Noise, Solution, corrected
from revnm_server.calibration.keyframes import Keyframe, KeyframeSet, Travel, relative
from revnm_server.calibration.prior import distorted, loosened, wide_prior
from revnm_server.calibration.spread import pixel_sigma_px, spread_m
from revnm_server.calibration.start import continued, starts
from revnm_server.floor_camera import PARAMETERS, FloorCamera, project

_SURE_AT_2_M = 0.15  # spread at which a calibration counts as good
_LEADS_AT_2_M = 0.35
_LEAST_TRAVEL_M = 0.45
_SETTLED = 0.08  # deviation of the log of the focal length from which no other starts are tried
_GATE_SIGMAS = 5.0
_GATE_PX = 8.0 / 640.0  # of the picture's width
_STARTS = 2
_DOUBTS = 5  # sightings in a row that disagree with odometry until something must have moved
_BAD_MISFIT = 6.0


@dataclass(frozen=True, slots=True)
class CalibrationState:
    """What is known now.

    Attributes:
        status: ``unknown`` before a robot was seen; ``learning``; ``good``.
        camera: The camera; None while unknown.
        covariance: (5, 5) of its parameters.
        spread_1_m: Standard deviation of a place on the floor 1 m from the robot that was seen last, in its frame.
        spread_2_m: The same at 2 m.
        misfit: Mean squared residual of the sightings, in variances.
        keyframes: How many are in use.
        travel_m: Way between the keyframes of all drives; inf where a kept calibration is used.
        event: What happened last that an operator should know, or None.
        restarts: How often the learning began anew, because nothing that was learnt before held any more.
    """

    status: Literal["unknown", "learning", "good"]
    camera: FloorCamera | None
    covariance: FloatArray
    spread_1_m: float
    spread_2_m: float
    misfit: float
    keyframes: int
    travel_m: float
    event: str | None
    restarts: int

    @property
    def leads(self) -> bool:
        """Whether a map made with it may lead a robot: after half a metre, if places near the robot are sure enough."""
        return self.camera is not None and self.travel_m >= _LEAST_TRAVEL_M and self.spread_2_m <= _LEADS_AT_2_M

    @property
    def progress(self) -> float:
        """How far the learning is, in [0, 1]."""
        if self.camera is None:
            return 0.0
        return min(1.0, _SURE_AT_2_M / self.spread_2_m, self.travel_m / _LEAST_TRAVEL_M)


class Calibrator:
    """Learns one camera from every robot that drives in front of it. Not thread-safe."""

    def __init__(self, size_px: tuple[int, int], *, kept: Belief | None = None, noise: Noise | None = None) -> None:
        """Begin.

        Args:
            size_px: Of the picture.
            kept: What was learnt before, or None.
            noise: Of sightings and odometry.
        """
        self._size_px, self._noise = size_px, noise or Noise()
        self._prior = kept or wide_prior()
        self._known = kept is not None
        self._frames = KeyframeSet()
        self._solution: Solution | None = None
        self._placed: list[Keyframe] = []
        self._drives: list[int] = []
        self._doubts: dict[int, int] = {}
        self._event: str | None = None
        self._restarts = 0
        self._state: CalibrationState | None = None  # of now; a new keyframe or a start over changes it

    @property
    def belief(self) -> Belief:
        """What is known of the camera, for keeping it."""
        if self._solution is None:
            return self._prior
        covariance = self._solution.covariance[:PARAMETERS, :PARAMETERS]
        return Belief(self._solution.estimate.camera, covariance)

    @property
    def state(self) -> CalibrationState:
        """What is known now."""
        if self._state is None:
            self._state = self._judged()
        return self._state

    def _judged(self) -> CalibrationState:
        belief = self.belief
        if self._solution is None and not self._known:
            return CalibrationState(
                "unknown", None, belief.covariance, math.inf, math.inf, 1.0, 0, 0.0, self._event, self._restarts
            )
        one, two = self._spread(1.0), self._spread(2.0)
        camera = FloorCamera.from_vector(belief.mean, self._size_px)
        misfit = self._solution.misfit if self._solution is not None else 1.0
        frames, travel_m = self._frames.frames, math.inf if self._known else self._frames.travel_m()
        good = two <= _SURE_AT_2_M and travel_m >= _LEAST_TRAVEL_M
        status: Literal["learning", "good"] = "good" if good else "learning"
        return CalibrationState(
            status, camera, belief.covariance, one, two, misfit, len(frames), travel_m, self._event, self._restarts
        )

    def observe(self, *frames: Keyframe) -> None:
        """Take sightings, such as all robots' in one picture; a drive's earlier ones came before."""
        taken = [self._takes(frame) for frame in frames]
        if any(taken):
            self._adjust()

    def _takes(self, frame: Keyframe) -> bool:
        """Return whether a sighting is a keyframe from now on."""
        if self._contradicts(frame):
            self._doubt(frame)
            return False
        self._doubts[frame.drive] = 0
        if not self._frames.wants(frame):
            return False
        self._frames.add(frame)
        return True

    def _adjust(self) -> None:
        self._state = None
        self._solve()
        if self._solution is not None and self._solution.misfit > _BAD_MISFIT and len(self._frames.frames) >= 6:
            self._start_over("the sightings fit no camera at this place: learning it anew", wide_prior())

    def floor_from_robot(self, travel: Travel, drive: int) -> Pose2 | None:
        """Return where a robot is by its odometry since its last keyframe; None before it was seen in this drive.

        While its sightings contradict its odometry it is nowhere, too.
        """
        found = self._last_placed(drive)
        if found is None or self._doubts.get(drive, 0) >= 2:
            return None
        return self._carried(*found, travel)

    def covariance_with(self, drive: int) -> FloatArray:
        """Return the covariance (8, 8) of the camera's parameters and the last keyframe's pose of a drive.

        Raises:
            KeyError: No robot was seen in this drive.
        """
        found = self._last_placed(drive)
        if found is None or self._solution is None:
            raise KeyError(drive)
        chosen = np.r_[0:PARAMETERS, PARAMETERS + 3 * len(self._drives) + 3 * found[1] + np.arange(3)]
        return np.asarray(self._solution.covariance[np.ix_(chosen, chosen)])

    def _spread(self, distance_m: float) -> float:
        """Return the spread around the robot seen last, or 4 m before the camera."""
        belief = self.belief
        if self._solution is None:
            covariance = np.zeros((8, 8))
            covariance[:PARAMETERS, :PARAMETERS] = belief.covariance
            return spread_m(np.array([*belief.mean, 4.0, 0.0, 0.0]), covariance, self._size_px, distance_m)
        vector = np.concatenate([belief.mean, self._solution.estimate.poses[-1]])
        return spread_m(vector, self.covariance_with(self._placed[-1].drive), self._size_px, distance_m)

    def _last_placed(self, drive: int) -> tuple[Keyframe, int] | None:
        indices = [i for i, frame in enumerate(self._placed) if frame.drive == drive]
        return (self._placed[indices[-1]], indices[-1]) if indices else None

    def _carried(self, last: Keyframe, index: int, travel: Travel) -> Pose2:
        """Return the pose of a keyframe carried on by odometry, its learnt errors taken out."""
        assert self._solution is not None
        x, y, yaw = self._solution.estimate.poses[index]
        motion, ways = relative([last, Keyframe(last.pixel, last.heading, None, travel, last.mount, last.drive)])
        errors = self._solution.estimate.drives[self._drives.index(last.drive)]
        dx, dy, turn = corrected(motion, ways, errors)[0]
        return Pose2(x, y, yaw) @ Pose2(dx, dy, turn)

    def _contradicts(self, frame: Keyframe) -> bool:
        """Tell whether a sighting lies where its robot cannot be."""
        found = self._last_placed(frame.drive)
        if found is None or self._solution is None:
            return False
        pose = self._carried(*found, frame.travel)
        vector = np.concatenate([self.belief.mean, pose])
        covariance = self.covariance_with(frame.drive)
        driven = frame.travel.way_m - found[0].travel.way_m
        sigma = pixel_sigma_px(vector, covariance, self._size_px, frame.mount.height_m, driven_m=driven)
        expected, _ = project(vector[:PARAMETERS], self._size_px, np.array([pose.x_m, pose.y_m, frame.mount.height_m]))
        limit = max(_GATE_PX * self._size_px[0], _GATE_SIGMAS * (sigma + self._noise.pixel_px))
        return bool(np.linalg.norm(expected - frame.pixel) > limit)

    def _doubt(self, frame: Keyframe) -> None:
        count = self._doubts.get(frame.drive, 0) + 1
        self._doubts[frame.drive] = count
        if count >= _DOUBTS:
            self._start_over("the camera or the odometry has jumped: learning again", loosened(self.belief))
            self._frames.add(frame)
            self._solve()

    def _start_over(self, event: str, prior: Belief) -> None:
        """Forget all keyframes, and of the camera all but a prior."""
        self._state = None
        self._event, self._prior, self._known = event, prior, False
        self._restarts += 1
        self._frames, self._placed, self._solution = KeyframeSet(), [], None
        self._doubts = {}

    def _solve(self) -> None:
        frames = self._frames.frames
        prior = distorted(self._prior, frames, self._size_px)
        problem = Adjustment(frames, prior, self._noise, self._size_px)
        candidates = self._candidates(frames, prior)
        if not candidates:
            return
        solutions = [problem.solve(start) for start in candidates]
        self._solution = min(solutions, key=lambda solution: solution.cost)
        self._placed = list(frames)
        self._drives = sorted({frame.drive for frame in frames})

    def _candidates(self, frames: list[Keyframe], prior: Belief) -> list[Estimate]:
        """Return where to search from: what is known, and while that is little, what the newest drive suggests."""
        belief, found = self.belief, list[Estimate]()
        settled = math.sqrt(belief.covariance[0, 0]) <= _SETTLED
        if self._solution is not None:
            estimate = self._solution.estimate
            errors = dict(zip(self._drives, estimate.drives, strict=True))
            poses = {id(frame): pose for frame, pose in zip(self._placed, estimate.poses, strict=True)}
            found.append(continued(frames, belief.mean, self._size_px, poses=poses, errors=errors))
        elif self._known or settled:
            found.append(continued(frames, belief.mean, self._size_px))
        if not settled:
            newest = [frame for frame in frames if frame.drive == frames[-1].drive]
            count = _STARTS if self._solution is None else 1
            for start in starts(newest, prior, self._size_px, pixel_px=self._noise.pixel_px, count=count):
                poses = {id(frame): pose for frame, pose in zip(newest, start.poses, strict=True)}
                found.append(continued(frames, start.camera, self._size_px, poses=poses))
        return found
