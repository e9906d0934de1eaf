"""Keeps what was heard last, and moves the plan to where it lies in the newest scan.

Everything is placed by stamps of the robot's clock, so this machine's own clock does not matter.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.json_payload import Scalar
from revnm_client.messages import Plan, Scan
from revnm_client.plan_tracking import OdometryBuffer, TrackedPlan, track
from revnm_client.senses import Senses
from revnm_client.server_ears import ServerEars
from revnm_client.watch.picture import View

_FRESH_S = 1.0


class ViewKeeper:
    """Takes in what comes; gives the view."""

    def __init__(self, robot: str, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._robot = robot
        self._clock_s = clock_s
        self._odometry = OdometryBuffer()
        self._scan: Scan | None = None
        self._scan_s = self._plan_s = self._state_s = -_FRESH_S
        self._plan: TrackedPlan | None = None
        self._state: dict[str, Scalar] | None = None

    def listen(self, senses: Senses, ears: ServerEars) -> None:
        """Take in what has come; never blocks."""
        now_s = self._clock_s()
        if (state := ears.states.take()) is not None:
            self._state, self._state_s = state, now_s
        if (odometry := senses.take_odometry()) is not None and not self._odometry.add(odometry):
            self._plan = None
        if (scan := senses.take_scan()) is not None:
            self._scan, self._scan_s = scan, now_s
        if (plan := ears.plans.take()) is not None and (tracked := self._tracked(plan)) is not None:
            self._plan, self._plan_s = tracked, now_s

    def view(self) -> View:
        """Return what is known; scan and plan only where they came within the last second."""
        now_s = self._clock_s()
        scan = self._scan if now_s - self._scan_s < _FRESH_S else None
        return View(
            robot=self._robot,
            points_m=None if scan is None else replace(scan, robot_from_lidar=self._lidar()).points_m(),
            path_m=self._path_m(scan) if now_s - self._plan_s < _FRESH_S else None,
            state=self._state,
            state_age_s=now_s - self._state_s,
        )

    def _lidar(self) -> Pose2:
        """Return where the robot's state says that its LiDAR sits; in its middle where it says nothing."""
        told = [(self._state or {}).get(key) for key in ("lidar_x_m", "lidar_y_m", "lidar_yaw_rad")]
        return Pose2(*(value if isinstance(value, int | float) else 0.0 for value in told))

    def _tracked(self, plan: Plan) -> TrackedPlan | None:
        """Return the plan with its place in the odometry frame; None while clock or place is unknown."""
        offset_ms = None if self._state is None else self._state.get("clock_offset_ms")
        if not isinstance(offset_ms, int | float):
            return None
        pose = self._odometry.at(plan.stamp_ns - round(offset_ms * 1e6))
        return None if pose is None else track(plan, pose, 0)

    def _path_m(self, scan: Scan | None) -> FloatArray | None:
        pose = None if scan is None else self._odometry.at(scan.stamp_ns)
        return None if self._plan is None or pose is None else self._plan.path_m(pose)
