"""What the server shows of itself, as ROS's diagnostic statuses."""

from __future__ import annotations

from revnm_server.recording.ros import Level, Status
from revnm_server.views.view import CameraView, RobotView, ServerView

_CAMERA_LEVELS = {"running": Level.OK, "stale": Level.STALE, "init": Level.WARN}
_ROBOT_LEVELS = {"waiting": Level.WARN}


def diagnose(view: ServerView) -> list[Status]:
    """Return the statuses of camera, robots, timings and server."""
    return [_camera(view.camera), *(_robot(robot) for robot in view.robots), _timings(view), _server(view)]


def _camera(camera: CameraView) -> Status:
    values: dict[str, object] = {
        "url": camera.url,
        "state": camera.state,
        "fps": camera.fps,
        "frame_age_s": camera.frame_age_s,
    }
    if camera.calibration is not None:
        known = camera.calibration
        values |= {
            "calibration": known.status,
            "calibration_progress": known.progress,
            "calibration_spread_2_m_cm": known.spread_2_m_cm,
            "calibration_event": known.event,
        }
    return Status("revnm: camera", _CAMERA_LEVELS.get(camera.state, Level.ERROR), camera.reason or "running", values)


def _robot(robot: RobotView) -> Status:
    values = {
        "status": robot.status,
        "goal": robot.goal.id if robot.goal is not None else None,
        "sighting_age_s": robot.sighting_age_s,
        "state_age_s": robot.robot_state_age_s,
        "epoch": robot.epoch,
        "seq": robot.seq,
    }
    level = _ROBOT_LEVELS.get(robot.status, Level.OK)
    return Status(f"revnm: robot {robot.name}", level, robot.reason or robot.status, values)


def _timings(view: ServerView) -> Status:
    values = {
        f"{stage}_{key}_ms": value
        for stage, timing in view.timings_ms.items()
        for key, value in (("p50", timing.p50), ("p95", timing.p95))
    }
    return Status("revnm: timings", Level.OK, "milliseconds", values)


def _server(view: ServerView) -> Status:
    level = Level.OK if view.ready and not view.warnings else Level.WARN
    message = "; ".join([*view.reasons, *view.warnings]) or "ready"
    return Status("revnm: server", level, message, {f"rejected {key}": count for key, count in view.rejected.items()})
