"""What recording costs: time in the tick's thread, share of a core beside it, and room on the disk."""

from __future__ import annotations

import math
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import zenoh

from revnm_client import keys
from revnm_client.cdr import encode_odometry, encode_scan
from revnm_client.geometry import FloatArray, Pose2
from revnm_client.link import open_router
from revnm_client.messages import STANDSTILL, Odometry, Scan
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import Frame
from revnm_server.ports import Heard
from revnm_server.recording.about import FORMAT
from revnm_server.recording.heard_log import HeardLog
from revnm_server.recording.recorder import Recorder
from revnm_server.robots.mission import Goal
from revnm_server.settings import RecordingSettings
from revnm_server.tick.pipeline import RobotPlan, TickResult
from revnm_server.tick.site_report import SiteReport, SiteRoute
from revnm_server.tick.tick_recorder import ObservedTick
from revnm_server.views.view import CameraView, ServerView

_ROBOT, _CAMERA = "rover", "camera"
_HZ = 10.0
_ODOMETRY_PER_TICK, _BEAMS = 4, 720
_PICTURES = 10  # that take turns
_NOISE = 3.0  # gray levels, as of a sensor indoors
_DISPARITY_HW, _EGO_PX = (192, 256), 32  # of the shipped bundle
_MB = 1e6


class _Spent(NamedTuple):
    """What a drive cost: each tick's thread in time and in work, and the share of a core that other threads took."""

    tick_us: FloatArray
    tick_cpu_us: FloatArray
    writer_share: float


def measure(size_px: tuple[int, int], *, original: bool, seconds: float) -> dict[str, Any]:
    """Record made-up ticks at 10 Hz, as of one robot that drives over a map.

    Args:
        size_px: Width and height of the pictures: smooth, with sensor noise.
        original: They came as JPEG; else the recorder encodes them.
        seconds: For how long.

    Returns:
        A row of the report.
    """
    heard = HeardLog()
    with tempfile.TemporaryDirectory(prefix="revnm-record-") as folder, open_router(["tcp/127.0.0.1:0"]) as session:
        settings = RecordingSettings(folder=Path(folder), least_free_gb=0.0)
        recorder = Recorder(settings, session, camera=_CAMERA, robots=(_ROBOT,), about={"format": FORMAT}, heard=heard)
        recorder.watch(lambda: _view(size_px))
        recorder.start()
        spent = _drive(recorder, session, heard, _frames(size_px, original=original), ticks=round(seconds * _HZ))
        record = recorder.stop()
        size_bytes = sum(path.stat().st_size for path in Path(folder).iterdir())
    (p50, p95), cpu_p95 = np.percentile(spent.tick_us, (50.0, 95.0)), np.percentile(spent.tick_cpu_us, 95.0)
    return {
        "width_px": size_px[0],
        "height_px": size_px[1],
        "pictures": "original" if original else "encoded",
        "ticks": len(spent.tick_us),
        "tick_p50_us": round(float(p50), 1),
        "tick_p95_us": round(float(p95), 1),
        "tick_cpu_p95_us": round(float(cpu_p95), 1),
        "writer_cpu_share": round(spent.writer_share, 3),
        "mb_per_min": round(size_bytes / _MB * 60.0 * _HZ / len(spent.tick_us), 1),
        "dropped": record.dropped,
    }


def _drive(recorder: Recorder, session: zenoh.Session, heard: HeardLog, frames: list[Frame], *, ticks: int) -> _Spent:
    senses, pause = heard.along(_ROBOT, _Odometer()), threading.Event()
    ranges = np.random.default_rng(1).uniform(0.5, 10.0, _BEAMS).astype(np.float32)
    tick_us, tick_cpu_us = np.empty(ticks), np.empty(ticks)
    began_s, process_s, own_s = time.perf_counter(), time.process_time(), time.thread_time()
    for number in range(ticks):
        stamp_ns = time.time_ns()
        scan = Scan(stamp_ns, -math.pi, math.tau / _BEAMS, 0.1, 12.0, ranges)
        session.put(keys.scan(_ROBOT), encode_scan(scan))
        for odometry in senses.listen().odometry:
            session.put(keys.odom(_ROBOT), encode_odometry(odometry))
        shown = frames[number % len(frames)]
        tick = _tick(Frame(shown.image, stamp_ns, number, shown.jpeg))
        started_s, started_cpu_s = time.perf_counter(), time.thread_time()
        recorder.observe(tick)
        tick_us[number] = (time.perf_counter() - started_s) * 1e6
        tick_cpu_us[number] = (time.thread_time() - started_cpu_s) * 1e6
        pause.wait(max(0.0, began_s + (number + 1) / _HZ - time.perf_counter()))
    others_s = (time.process_time() - process_s) - (time.thread_time() - own_s)
    return _Spent(tick_us, tick_cpu_us, others_s / (time.perf_counter() - began_s))


class _Odometer:
    """Senses that hear four odometries in each turn."""

    @property
    def rejected(self) -> dict[str, int]:
        return {}

    def listen(self) -> Heard:
        odometry = Odometry(time.time_ns(), Pose2(0.1, 0.2, 0.3), STANDSTILL)
        return Heard((odometry,) * _ODOMETRY_PER_TICK)


def _frames(size_px: tuple[int, int], *, original: bool) -> list[Frame]:
    rng = np.random.default_rng(0)
    width, height = size_px
    smooth = cv2.resize(rng.uniform(40.0, 220.0, (12, 16, 3)), size_px, interpolation=cv2.INTER_CUBIC)
    images = [
        (smooth + rng.normal(0.0, _NOISE, (height, width, 3))).clip(0.0, 255.0).astype(np.uint8)
        for _ in range(_PICTURES)
    ]
    return [Frame(image, 0, 0, encode_jpeg(image, quality=90) if original else None) for image in images]


def _tick(frame: Frame) -> ObservedTick:
    rng = np.random.default_rng(frame.seq)
    goal = Goal("goal", (100.0, 100.0), frame.size_px)
    camera = FloorCamera(frame.size_px, 0.6 * frame.size_px[0], 0.6, 0.0, 2.5)
    calibration = CalibrationState("good", camera, 1e-4 * np.eye(5), 0.02, 0.05, 1.0, 24, 4.0, None, 0)
    way_m = np.column_stack([np.linspace(2.0, 7.0, 100), np.zeros(100)])
    route = SiteRoute("", way_m, None, way_m[-1])
    site = SiteReport(frame.stamp_ns, calibration, None, {_ROBOT: Pose2(2.0, 0.0, 0.1)}, {_ROBOT: route}, (), {})
    disparity = cv2.resize(rng.random((24, 32), dtype=np.float32), _DISPARITY_HW[::-1])
    ego = cv2.resize(rng.random((4, 4), dtype=np.float32), (_EGO_PX, _EGO_PX))
    plans = (RobotPlan(_ROBOT, way_m[:5], frame.stamp_ns, goal.id),)
    result = TickResult(plans, (), np.asarray(disparity), {_ROBOT: np.asarray(ego)}, {"tick": 20.0}, site)
    return ObservedTick(frame, {_ROBOT: goal}, result, frozenset({_ROBOT}))


def _view(size_px: tuple[int, int]) -> ServerView:
    camera = CameraView("zenoh://camera", "running", size_px, _HZ, 0.05, None, None)
    return ServerView(camera, [], {}, True, [], [], {}, (0.43, 0.36))
