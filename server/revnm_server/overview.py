"""Gathers what is known of camera, robots and ticks into one :class:`revnm_server.view.ServerView`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from revnm_client import keys
from revnm_client.geometry import FloatArray
from revnm_server.camera import CameraSource, CameraState, CameraStatus
from revnm_server.frame import RobotSighting
from revnm_server.mission import Goal, Mission, RobotMission
from revnm_server.orders import OrderCourier
from revnm_server.pipeline import TickResult
from revnm_server.robot_link import RobotLink
from revnm_server.site_report import SiteReport, SiteRoute
from revnm_server.view import (
    CalibrationView,
    CameraView,
    GoalView,
    RecordingView,
    RobotView,
    ServerView,
    Timings,
    TimingView,
    pairs,
    path_in_picture,
)

_DRIVING_S = 0.5
_ALIVE_S = 3.0
_MAX_FAULT_LENGTH = 300

Status = Literal["no_goal", "driving", "arrived", "stopped", "waiting"]


@dataclass(frozen=True, slots=True)
class SentPlan:
    """A plan that was published.

    Attributes:
        at_s: When, monotonic clock.
        waypoints_m: (H, 2) in the robot's frame.
        sighting: Where the robot was seen then or lately; None if it is known by its odometry only.
    """

    at_s: float
    waypoints_m: FloatArray
    sighting: RobotSighting | None


@dataclass(slots=True)
class _Known:
    """What the ticks have left; guarded by the overview's lock."""

    timings: Timings = field(default_factory=Timings)
    seen: dict[str, RobotSighting] = field(default_factory=dict)
    sent: dict[str, SentPlan] = field(default_factory=dict)
    site: SiteReport | None = None
    fault: str | None = None


@dataclass(frozen=True, slots=True)
class _Last:
    """What the ticks have left of one robot."""

    seen: RobotSighting | None
    sent: SentPlan | None
    route: SiteRoute | None


class Overview:
    """Remembers the last tick and answers what there is to show. Thread-safe.

    Args:
        camera: For its status.
        mission: For what is wanted.
        links: For what the robots say.
        courier: For what they replied.
        tag_size_m: Side of the robots' tags, for drawing paths.
        notes: Warnings that hold all the time.
        recording: Tells of the run record.
    """

    def __init__(
        self,
        camera: CameraSource,
        mission: Mission,
        links: Mapping[str, RobotLink],
        courier: OrderCourier,
        *,
        tag_size_m: float,
        notes: Sequence[str] = (),
        recording: Callable[[], RecordingView] | None = None,
    ) -> None:
        self._camera = camera
        self._mission = mission
        self._links = links
        self._courier = courier
        self._tag_size_m = tag_size_m
        self._notes = tuple(notes)
        self._recording = recording
        self._lock = threading.Lock()
        self._known = _Known()

    def note_tick(self, result: TickResult, sent: Mapping[str, SentPlan]) -> None:
        """Remember a tick that worked and what it published."""
        with self._lock:
            self._known.fault = None
            self._known.site = result.site
            self._known.timings.add(result.timings_ms)
            self._known.seen.update({s.robot: s for s in result.sightings if s.robot in self._links})
            self._known.sent.update(sent)

    def note_fault(self, error: Exception) -> bool:
        """Remember a tick that failed; return whether the one before had worked."""
        with self._lock:
            new = self._known.fault is None
            self._known.fault = f"tick failed: {type(error).__name__}: {error}"[:_MAX_FAULT_LENGTH]
        return new

    def site(self) -> SiteReport | None:
        """Return the last tick's report of the camera and its map, if it made one."""
        with self._lock:
            return self._known.site

    def view(self) -> ServerView:
        """Return what there is to show now; never waits for the tick, the network or the disk."""
        status = self._camera.status()
        with self._lock:
            known = self._known
            fault, timings = known.fault, known.timings.view()
            seen, sent, site = dict(known.seen), dict(known.sent), known.site
        trouble = _camera_trouble(status) if status.state is not CameraState.RUNNING else fault
        routes = site.routes if site is not None else {}
        robots = [
            self._robot(robot, status, trouble, _Last(seen.get(robot), sent.get(robot), routes.get(robot)))
            for robot in self._mission.names
        ]
        return self._assemble(status, fault, robots, timings, site)

    def _assemble(
        self,
        status: CameraStatus,
        fault: str | None,
        robots: list[RobotView],
        timings: dict[str, TimingView],
        site: SiteReport | None,
    ) -> ServerView:
        reasons = self._unready(status, fault)
        return ServerView(
            camera=CameraView(
                url=self._camera.redacted_url,
                state=status.state.value,
                size_px=status.size_px,
                fps=_rounded(status.fps, 1),
                frame_age_s=_rounded(status.frame_age_s, 3),
                reason=status.reason,
                calibration=CalibrationView.of(site.calibration) if site is not None else None,
            ),
            robots=robots,
            timings_ms=timings,
            ready=not reasons,
            reasons=reasons,
            warnings=self._warnings(status, site),
            rejected=self._rejected(status) | (site.rejected if site is not None else {}),
            recording=self._recording() if self._recording is not None else None,
        )

    def _warnings(self, status: CameraStatus, site: SiteReport | None) -> list[str]:
        passing = [text for text in (status.warning, self._mission.save_error) if text is not None]
        return [*self._notes, *passing, *(site.warnings if site is not None else ())]

    def _rejected(self, status: CameraStatus) -> dict[str, int]:
        counts = self._courier.rejected
        for link in self._links.values():
            counts |= link.rejected
        scheme, _, name = self._camera.redacted_url.partition("://")
        if scheme == "zenoh":
            counts[keys.image(name)] = status.rejected
        return counts

    def _unready(self, status: CameraStatus, fault: str | None) -> list[str]:
        reasons = []
        if status.state is not CameraState.RUNNING:
            reasons.append(_camera_trouble(status))
        if fault is not None:
            reasons.append(fault)
        ages = [link.state_age_s for link in self._links.values()]
        if not any(age is not None and age <= _ALIVE_S for age in ages):
            names = ", ".join(self._links) or "none is configured"
            reasons.append(f"no robot reports its state: {names}")
        return reasons

    def _robot(self, robot: str, status: CameraStatus, trouble: str | None, last: _Last) -> RobotView:
        wanted, link, seen = self._mission.of(robot), self._links[robot], last.seen
        seen_age_s = (time.time_ns() - seen.stamp_ns) / 1e9 if seen is not None else None
        driving = last.sent is not None and time.monotonic() - last.sent.at_s <= _DRIVING_S
        led = last.route.reason if last.route is not None else ""
        held = link.state is not None and link.state["stopped"] is True
        does, reason = _judge(
            wanted, held=held, driving=driving, trouble=trouble or led or _sighting_trouble(seen_age_s)
        )
        if does == "driving":
            reason = _robot_trouble(link) or led or None
        shown = last.sent if does == "driving" else None
        return RobotView(
            name=robot,
            status=does,
            reason=reason,
            goal=_goal_view(wanted.goal, status.size_px),
            pixel=pairs(seen.pixel[None], digits=1)[0] if seen is not None else None,
            heading=pairs(seen.heading[None], digits=4)[0] if seen is not None else None,
            sighting_age_s=_rounded(seen_age_s, 3),
            path_px=pairs(self._path_px(shown, last.route), digits=1) if shown is not None else [],
            waypoints_m=pairs(shown.waypoints_m, digits=3) if shown is not None else [],
            robot_state=link.state,
            robot_state_age_s=_rounded(link.state_age_s, 3),
            epoch=wanted.epoch,
            seq=self._mission.seq(robot),
        )

    def _path_px(self, sent: SentPlan, route: SiteRoute | None) -> FloatArray:
        """Return the way through the learnt camera; where there is none, the waypoints by the robot's tag."""
        if route is not None and route.way_px is not None:
            return route.way_px
        if sent.sighting is None:
            return np.empty((0, 2))
        return path_in_picture(sent.waypoints_m, sent.sighting, tag_size_m=self._tag_size_m)


def _judge(wanted: RobotMission, *, held: bool, driving: bool, trouble: str) -> tuple[Status, str | None]:
    """Return what the robot is doing, and why.

    Args:
        wanted: What the operator wants of it.
        held: The robot says that its stop is latched.
        driving: It is being given plans.
        trouble: What keeps plans from being made.
    """
    if wanted.stopped:
        return "stopped", "the robot has not confirmed the stop" if wanted.order is not None else None
    if held and wanted.order is None:
        return "stopped", "the robot holds a stop that did not come from this server: resume it"
    if wanted.goal is None:
        return "no_goal", "the robot has not confirmed to go on" if wanted.order is not None else None
    if wanted.arrived:
        return "arrived", None
    return ("driving", None) if driving else ("waiting", trouble)


def _camera_trouble(status: CameraStatus) -> str:
    return f"camera {status.state.value}: {status.reason}"


def _robot_trouble(link: RobotLink) -> str | None:
    """Return why a robot that is given plans does not move, as far as it says."""
    if link.state is None or link.state["moving"] or not link.state["reason"]:
        return None
    return f"robot: {link.state['reason']}"


def _sighting_trouble(age_s: float | None) -> str:
    if age_s is None:
        return "the robot's tag has not been seen yet"
    if age_s <= _DRIVING_S:
        return "the first plan is on its way"
    return f"the robot's tag was seen {age_s:.1f} s ago"


def _goal_view(goal: Goal | None, size_px: tuple[int, int] | None) -> GoalView | None:
    if goal is None:
        return None
    width, height = size_px or goal.size_px
    u, v = goal.normalised
    return GoalView(round(float(u) * width, 1), round(float(v) * height, 1), goal.id)


def _rounded(value: float | None, digits: int) -> float | None:
    return round(value, digits) if value is not None else None
