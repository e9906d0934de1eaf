"""What the recording's tests need: a server that records, ticks to record, and an independent reader."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry, Scan
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import Frame
from revnm_server.recording.heard_log import HeardLog
from revnm_server.recording.recorder import Recorder
from revnm_server.robots.mission import Goal
from revnm_server.settings import RecordingSettings
from revnm_server.tick.pipeline import RobotPlan, TickResult
from revnm_server.tick.site_report import SiteReport, SiteRoute
from revnm_server.tick.tick_recorder import ObservedTick
from revnm_server.views.view import CameraView, ServerView

STAMP_NS = 1_700_000_000_000_000_000
TICK_NS = 100_000_000
PLAN_M = np.array([[0.3, 0.01], [0.6, 0.02]])
CAMERA = FloorCamera((64, 48), 50.0, 0.6, 0.0, 2.5)
KNOWN = CalibrationState("good", CAMERA, 0.01 * np.eye(5), 0.02, 0.05, 1.0, 5, 2.0, None, 0)
UNKNOWN = CalibrationState("unknown", None, np.eye(5), np.inf, np.inf, 0.0, 0, 0.0, None, 0)
SHOWN = CameraView("zenoh://cam", "running", (64, 48), 10.0, 0.05, None, None)
VIEW = ServerView(SHOWN, [], {}, True, [], [], {}, (0.43, 0.36))


def observed(number: int, *, calibration: CalibrationState | None = KNOWN, as_jpeg: bool = True) -> ObservedTick:
    """Tick ``number``: the robot rover is led to a goal; its picture is gray noise, which does not compress."""
    rng = np.random.default_rng(number)
    image = np.repeat(rng.integers(0, 255, (48, 64, 1), dtype=np.uint8), 3, axis=2)
    stamp_ns = STAMP_NS + number * TICK_NS
    goal = Goal("g1", (10.0, 20.0), (64, 48))
    site = None
    if calibration is not None:
        route = SiteRoute("", np.array([[2.0, 0.0], [3.0, 1.0]]), None, np.array([3.0, 1.0]))
        places = {"rover": Pose2(2.0, 0.0, 0.5)} if calibration.camera is not None else {}
        site = SiteReport(stamp_ns, calibration, None, places, {"rover": route}, (), {})
    disparity = rng.random((6, 8), dtype=np.float32)
    plans = (RobotPlan("rover", PLAN_M, stamp_ns, goal.id),)
    result = TickResult(plans, (), disparity, {"rover": disparity - 1.0}, {"tick": 4.0}, site)
    frame = Frame(image, stamp_ns, number, encode_jpeg(image) if as_jpeg else None)
    return ObservedTick(frame, {"rover": goal}, result, frozenset({"rover"}))


def scan(stamp_ns: int) -> Scan:
    return Scan(stamp_ns, -1.0, 0.5, 0.1, 8.0, np.full(5, 2.0, np.float32))


def odometry(stamp_ns: int, x_m: float = 0.0) -> Odometry:
    return Odometry(stamp_ns, Pose2(x_m, 0.0, 0.0), STANDSTILL)


@contextmanager
def recorder(
    session: zenoh.Session,
    folder: Path | None,
    *,
    robots: tuple[str, ...] = ("rover",),
    heard: HeardLog | None = None,
    **settings: Any,
) -> Iterator[Recorder]:
    """A recorder with small limits on the disk's side, which knows a server that is well."""
    chosen: Mapping[str, Any] = {"folder": folder, "least_free_gb": 0.0} | settings
    made = Recorder(
        RecordingSettings(**chosen),
        session,
        camera="cam",
        robots=robots,
        about={"format": "revnm run record 1"},
        heard=heard,
    )
    made.watch(lambda: VIEW)
    try:
        yield made
    finally:
        made.close()


def read(path: Path) -> dict[str, list[Any]]:
    """The messages of a record by topic, in the order of their time, as rosbags reads them."""
    found: dict[str, list[Any]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, raw in reader.messages():
            found.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    return found


def records(folder: Path) -> list[Path]:
    """The complete records of a folder, oldest first."""
    return sorted(folder.glob("revnm-*.mcap"))
