"""Examples for the API's document, built of the classes that it answers with: a field that changes must change here."""

from __future__ import annotations

from typing import Any

from fastapi.encoders import jsonable_encoder

from revnm_server.api.guard import Role
from revnm_server.api.health import Health
from revnm_server.api.robots import GoalReply, OrderReply
from revnm_server.api.session import Session
from revnm_server.views.view import (
    CalibrationView,
    CameraView,
    FloorCameraView,
    GoalView,
    RecordingView,
    RobotView,
    ScanView,
    ServerView,
    TimingView,
)

_GOAL = GoalView(u=412.0, v=296.5, id="5f0c2e9a71bd")
_ROVER = RobotView(
    name="rover",
    status="driving",
    reason=None,
    goal=_GOAL,
    pixel=(201.4, 318.9),
    heading=(0.97, -0.24),
    sighting_age_s=0.08,
    tag_px=31.0,
    path_px=[(221.8, 314.0), (243.1, 309.2)],
    waypoints_m=[(0.3, 0.0), (0.6, 0.02)],
    plan_age_s=0.12,
    picture_to_plan_ms=TimingView(p50=38.2, p95=52.7),
    scan=ScanView(points_m=[(1.42, -0.31), (1.4, -0.27)], age_s=0.09),
    clock_offset_ms=1.8,
    round_trip_ms=3.1,
    robot_state={"robot": "rover", "moving": True, "reason": None, "stopped": False, "epoch": 3, "v_mps": 0.38},
    robot_state_age_s=0.2,
    epoch=3,
    seq=1841,
)
_CALIBRATION = CalibrationView(
    status="good",
    progress=1.0,
    spread_1_m_cm=2.1,
    spread_2_m_cm=4.6,
    event=None,
    camera=FloorCameraView(focal_px=331.2, pitch_rad=0.52, roll_rad=0.01, height_m=2.43, distortion=0.0),
)
_CAMERA = CameraView(
    url="rtsp://192.168.1.20/stream2",
    state="running",
    size_px=(640, 480),
    fps=14.9,
    frame_age_s=0.06,
    frame_stamp_ms=1764500000123.4,
    reason=None,
    calibration=_CALIBRATION,
)
_RECORDING = RecordingView(
    active=True,
    name="revnm-20260314-092653-589.mcap",
    size_mb=12.4,
    duration_s=95.0,
    messages=48210,
    dropped=0,
    refused=0,
)
_STATE = ServerView(
    camera=_CAMERA,
    robots=[_ROVER],
    timings_ms={"depth": TimingView(p50=11.3, p95=14.8), "tick": TimingView(p50=27.9, p95=36.0)},
    ready=True,
    reasons=[],
    warnings=[],
    rejected={},
    robot_size_m=(0.43, 0.36),
    recording=_RECORDING,
)

EXAMPLES: dict[str, Any] = {
    operation: jsonable_encoder(answer)
    for operation, answer in {
        "robots_robots": [_ROVER],
        "robots_set_goal": GoalReply(robot="rover", goal=_GOAL),
        "robots_stop": OrderReply(robot="rover", stopped=True, acknowledged=True, epoch=4),
        "robots_resume": OrderReply(robot="rover", stopped=False, acknowledged=True, epoch=4),
        "live_state": _STATE,
        "recording_recording": _RECORDING,
        "recording_start": _RECORDING,
        "recording_stop": RecordingView(name=_RECORDING.name, size_mb=12.9, duration_s=98.0, messages=49733),
        "health_healthz": Health(status="ok"),
        "health_readyz": Health(status="ready"),
        "session_session": Session(role=Role.OPERATOR),
    }.items()
}
"""By the id of an operation: one answer of status 200."""
