"""A tick as JSON: what it was given, so that it can be made again, and what it planned, so that it can be compared.

Pictures and messages are named by their stamps and stand in the record under their own topics.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from revnm_client.errors import FileError
from revnm_client.geometry import IDENTITY, FloatArray, Pose2
from revnm_server.calibration.adjustment import Belief
from revnm_server.calibration.calibrator import CalibrationState
from revnm_server.recording.heard_log import Listening
from revnm_server.robots.mission import Goal
from revnm_server.tick.tick_recorder import ObservedTick


@dataclass(frozen=True, slots=True)
class HeardStamps:
    """What one robot was heard to say in one turn.

    Attributes:
        robot: Its name.
        offset_ns: Was added to its own stamps.
        odometry_ns: Own stamps of the odometry, oldest first.
        scans_ns: Own stamps of the scans.
        robot_from_lidar: Where they were taken.
    """

    robot: str
    offset_ns: int
    odometry_ns: tuple[int, ...]
    scans_ns: tuple[int, ...]
    robot_from_lidar: Pose2


@dataclass(frozen=True, slots=True)
class TickDocument:
    """A tick that was recorded.

    Attributes:
        number: Ticks of the server before it.
        original_picture: The record has the picture as the camera sent it, not encoded anew.
        seq: Number of its picture.
        stamp_ns: Capture time of the picture.
        heard: What was heard, in its order.
        goals: By robot.
        plans_m: Waypoints (H, 2) by robot, metres, robot frame.
        reasons: Why robots with a goal were not led, or what was provisional; where a map is made.
        failed: It raised an error.
        belief: What was known of the camera; None where nothing is, or where it is as with the tick before.
        kept: That was from an earlier run of the server.
    """

    number: int
    original_picture: bool
    seq: int
    stamp_ns: int
    heard: tuple[HeardStamps, ...]
    goals: dict[str, Goal]
    plans_m: dict[str, FloatArray]
    reasons: dict[str, str]
    failed: bool
    belief: Belief | None
    kept: bool


def encode_tick(
    tick: ObservedTick, heard: Sequence[Listening], *, number: int, calibration: CalibrationState | None
) -> str:
    """Return the document of a tick.

    Args:
        tick: What the service showed.
        heard: What it heard.
        number: Ticks of the server before it.
        calibration: Of the camera, where it is to be told.
    """
    result = tick.result
    routes = result.site.routes if result is not None and result.site is not None else {}
    document: dict[str, Any] = {
        "number": number,
        "seq": tick.frame.seq,
        "stamp_ns": tick.frame.stamp_ns,
        "original_picture": tick.frame.jpeg is not None,
        "heard": [_heard(each) for each in heard],  # the empty ones, too: their turns count
        "goals": {
            robot: {"id": goal.id, "pixel_uv": goal.pixel_uv, "size_px": goal.size_px}
            for robot, goal in tick.goals.items()
        },
        "plans_m": {plan.robot: plan.waypoints_m.tolist() for plan in result.plans} if result is not None else {},
        "published": sorted(tick.published),
        "reasons": {robot: route.reason for robot, route in routes.items()},
        "timings_ms": {key: round(value, 2) for key, value in result.timings_ms.items()} if result is not None else {},
        "failed": result is None,
    }
    if calibration is not None and calibration.camera is not None:
        camera = {"mean": calibration.camera.vector.tolist(), "covariance": calibration.covariance.tolist()}
        kept = math.isinf(calibration.travel_m)
        document["calibration"] = {"status": calibration.status, "kept": kept, **camera}
    return json.dumps(document, separators=(",", ":"))


def decode_tick(text: str) -> TickDocument:
    """Return the tick of a document.

    Raises:
        FileError: It is none.
    """
    try:
        fields = json.loads(text)
        known = fields.get("calibration")
        return TickDocument(
            number=int(fields["number"]),
            original_picture=bool(fields["original_picture"]),
            seq=int(fields["seq"]),
            stamp_ns=int(fields["stamp_ns"]),
            heard=tuple(_heard_stamps(each) for each in fields["heard"]),
            goals={str(robot): _goal(goal) for robot, goal in fields["goals"].items()},
            plans_m={str(robot): _waypoints(points) for robot, points in fields["plans_m"].items()},
            reasons={str(robot): str(reason) for robot, reason in fields["reasons"].items()},
            failed=bool(fields["failed"]),
            belief=Belief(np.array(known["mean"], float), np.array(known["covariance"], float)) if known else None,
            kept=bool(known["kept"]) if known else False,
        )
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FileError(f"tick {text[:80]!r}: expected a document of this program: {error!r}") from error


def _heard(listening: Listening) -> dict[str, Any]:
    heard = listening.heard
    offset_ns = heard.clock_offset_ns
    return {
        "robot": listening.robot,
        "offset_ns": offset_ns,
        "odom": [odometry.stamp_ns - offset_ns for odometry in heard.odometry],
        "scan": [scan.stamp_ns - offset_ns for scan in heard.scans],
        "lidar": list(heard.robot_from_lidar),
    }


def _heard_stamps(fields: dict[str, Any]) -> HeardStamps:
    x_m, y_m, yaw_rad = (float(value) for value in fields.get("lidar", IDENTITY))  # records of before have none
    robot, offset_ns = str(fields["robot"]), int(fields["offset_ns"])
    return HeardStamps(robot, offset_ns, _ints(fields["odom"]), _ints(fields["scan"]), Pose2(x_m, y_m, yaw_rad))


def _ints(values: Sequence[Any]) -> tuple[int, ...]:
    return tuple(int(value) for value in values)


def _goal(fields: dict[str, Any]) -> Goal:
    (u, v), (width, height) = fields["pixel_uv"], fields["size_px"]
    return Goal(str(fields["id"]), (float(u), float(v)), (int(width), int(height)))


def _waypoints(points: Sequence[Any]) -> FloatArray:
    return np.array(points, dtype=np.float64).reshape(-1, 2)
