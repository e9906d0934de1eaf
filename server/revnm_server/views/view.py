"""What the server shows of itself: the document behind the page and ``/api/v1/state``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_client.json_payload import Scalar
from revnm_client.messages import Scan
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.floor_camera import FloorCamera

_MOST_SCAN_POINTS = 180

Pair = tuple[float, float]
Status = Literal["no_goal", "driving", "arrived", "stopped", "waiting"]
"""What a robot is doing; ``waiting`` has a goal and gets no plan, or is not heard."""


@dataclass(frozen=True, slots=True)
class FloorCameraView:
    """A camera over the floor.

    Attributes:
        focal_px: Focal length.
        pitch_rad: How far the view is bent down from the horizontal.
        roll_rad: Turn about the view, clockwise as seen in the picture's content.
        height_m: Of the optical centre over the floor.
        distortion: Of the division model, in units of (half the picture's width)⁻²; negative for barrels.
    """

    focal_px: float
    pitch_rad: float
    roll_rad: float
    height_m: float
    distortion: float

    @classmethod
    def of(cls, camera: FloorCamera) -> FloorCameraView:
        """Return what there is to show of a camera."""
        numbers = (camera.focal_px, camera.pitch_rad, camera.roll_rad, camera.height_m, camera.distortion)
        return cls(*(round(number, 5) for number in numbers))


@dataclass(frozen=True, slots=True)
class CalibrationView:
    """What the server has learnt of the camera.

    Attributes:
        status: ``unknown`` before a robot was seen; ``learning``; ``good``.
        progress: How far the learning is, in [0, 1].
        spread_1_m_cm: Standard deviation of a place on the floor 1 m from the robot seen last; None if unknown.
        spread_2_m_cm: The same at 2 m.
        event: What happened last that a person should know.
        camera: Where a pixel lies on the floor, once it is ``good``: pictures of ``CameraView.size_px``.
    """

    status: Literal["unknown", "learning", "good"]
    progress: float
    spread_1_m_cm: float | None
    spread_2_m_cm: float | None
    event: str | None
    camera: FloorCameraView | None = None

    @classmethod
    def of(cls, state: CalibrationState) -> CalibrationView:
        """Return what there is to show of a calibration."""
        one, two = (
            round(100.0 * spread_m, 1) if math.isfinite(spread_m) else None
            for spread_m in (state.spread_1_m, state.spread_2_m)
        )
        known = FloorCameraView.of(state.camera) if state.camera is not None and state.status == "good" else None
        return cls(state.status, round(state.progress, 3), one, two, state.event, known)


@dataclass(frozen=True, slots=True)
class CameraView:
    """The camera.

    Attributes:
        url: Where its pictures come from, without a password.
        state: Whether they come; ``stale`` sends none, or old ones; ``ended`` is a file that was played.
        size_px: Width and height of its pictures; None before the first.
        fps: Pictures a second.
        frame_age_s: Since the newest picture came.
        frame_stamp_ms: When that was taken, milliseconds since the epoch, server's clock: who sees a picture of the
            stream knows by it how far behind the stream is.
        reason: Why it is not running.
        calibration: What was learnt of it; None where no map is made.
    """

    url: str
    state: Literal["init", "running", "stale", "reconnecting", "ended"]
    size_px: tuple[int, int] | None
    fps: float | None
    frame_age_s: float | None
    frame_stamp_ms: float | None
    reason: str | None
    calibration: CalibrationView | None = None


@dataclass(frozen=True, slots=True)
class GoalView:
    """A goal.

    Attributes:
        u: Its pixel in the picture as it is now, from the left.
        v: The same, from the top.
        id: Tells it from others: plans carry it.
    """

    u: float
    v: float
    id: str


@dataclass(frozen=True, slots=True)
class ScanView:
    """A robot's newest scan.

    Attributes:
        points_m: At most 180 hits, metres, robot frame; of neighbours the nearest is kept.
        age_s: Since it was taken.
    """

    points_m: list[Pair]
    age_s: float


@dataclass(frozen=True, slots=True)
class RobotView:
    """One robot.

    Attributes:
        name: Its name.
        status: What it is doing.
        reason: Why it waits, what is provisional about its way, or what else a person should know.
        goal: Where it is to go.
        pixel: Where it was seen last, pixels.
        heading: Unit vector of its forward axis in the picture, then.
        sighting_age_s: How long ago that was.
        tag_px: Shortest side of its tag then, pixels.
        path_px: The last plan drawn in the picture, while it drives.
        waypoints_m: The same in the robot's frame, metres, x forward, y left.
        plan_age_s: Time since the capture of the picture that its last plan was made from.
        picture_to_plan_ms: From a picture's capture until its plan was sent, of the last plans; None before the first.
        scan: What its LiDAR saw last; None where the server hears no scans.
        clock_offset_ms: Server's clock minus the robot's, as the robot says; None if it does not.
        round_trip_ms: To the server and back, as the robot says; None if it does not.
        robot_state: What it last said of itself.
        robot_state_age_s: How long ago that was.
        epoch: Raised by every stop.
        seq: Number of its last plan.
    """

    name: str
    status: Status
    reason: str | None
    goal: GoalView | None
    pixel: Pair | None
    heading: Pair | None
    sighting_age_s: float | None
    tag_px: float | None
    path_px: list[Pair]
    waypoints_m: list[Pair]
    plan_age_s: float | None
    picture_to_plan_ms: TimingView | None
    scan: ScanView | None
    clock_offset_ms: float | None
    round_trip_ms: float | None
    robot_state: dict[str, Scalar] | None
    robot_state_age_s: float | None
    epoch: int
    seq: int


@dataclass(frozen=True, slots=True)
class TimingView:
    """How long something takes lately.

    Attributes:
        p50: Median, milliseconds.
        p95: Exceeded by one of twenty, milliseconds.
    """

    p50: float
    p95: float


@dataclass(frozen=True, slots=True)
class RecordingView:
    """The run record that is being written, or the last one.

    Attributes:
        active: Whether one is being written.
        name: Of its newest file; None before the first.
        size_mb: What the file holds by now.
        duration_s: Since the recording began, over all of its files.
        messages: Written since then.
        dropped: Messages and ticks that were lost since then, because the disk was too slow.
        refused: Malformed payloads since then, which are not recorded.
        reason: Why it is not being written although it was to be; None where all is well.
    """

    active: bool = False
    name: str | None = None
    size_mb: float = 0.0
    duration_s: float = 0.0
    messages: int = 0
    dropped: int = 0
    refused: int = 0
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class ServerView:
    """Everything the page shows.

    Attributes:
        camera: The camera.
        robots: All robots.
        timings_ms: By stage: ``depth``, ``tag``, ``exo2ego``, ``policy``, ``tick`` from picture to plans. Where a map
            is made, ``map`` and ``learn``, too; exo2ego, policy and learn then run after the tick, depth beside tag.
        ready: Whether a goal would be driven to now.
        reasons: Why it is not ready.
        warnings: What is odd, though it works.
        rejected: Number of malformed payloads by Zenoh key.
        robot_size_m: Length and width of a robot, metres.
        recording: The run record; None where none can be written.
    """

    camera: CameraView
    robots: list[RobotView]
    timings_ms: dict[str, TimingView]
    ready: bool
    reasons: list[str]
    warnings: list[str]
    rejected: dict[str, int]
    robot_size_m: Pair
    recording: RecordingView | None = None


def pairs(points: FloatArray, *, digits: int) -> list[Pair]:
    """Return points (N, 2) as rounded pairs."""
    return [(round(float(x), digits), round(float(y), digits)) for x, y in points]


def scan_view(scan: Scan, *, now_ns: int) -> ScanView:
    """Return what there is to show of a scan, stamped in the clock of ``now_ns``.

    Of neighbouring beams the nearest hit is kept: a thin leg must not vanish.
    """
    ranges = np.asarray(scan.ranges_m, dtype=np.float64)
    hit = (ranges >= scan.range_min_m) & (ranges < scan.range_max_m)
    group = -(-len(ranges) // _MOST_SCAN_POINTS) or 1
    padded = np.pad(np.where(hit, ranges, np.inf), (0, -len(ranges) % group), constant_values=np.inf)
    nearest = padded.reshape(-1, group).argmin(axis=1) + group * np.arange(len(padded) // group)
    nearest = nearest[np.isfinite(padded[nearest])]
    angles = scan.angle_min_rad + scan.angle_increment_rad * nearest
    points = padded[nearest, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = scan.robot_from_lidar.apply(points)
    return ScanView(pairs(points, digits=2), round((now_ns - scan.stamp_ns) / 1e9, 3))


def rounded(value: float | None, digits: int) -> float | None:
    """Round a number, if there is one."""
    return round(value, digits) if value is not None else None
