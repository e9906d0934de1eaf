"""Gathers what is known of camera, robots and ticks into one :class:`revnm_server.view.ServerView`."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from revnm_client import keys
from revnm_client.geometry import FloatArray
from revnm_client.messages import Scan
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
    Status,
    Timings,
    TimingView,
    pairs,
    path_in_picture,
    scan_view,
)

_DRIVING_S = 0.5
_ALIVE_S = 3.0
_MAX_FAULT_LENGTH = 300
_HANGS_S = 2.0
_LATENCY = "picture_to_plan"


@dataclass(frozen=True, slots=True)
class SentPlan:
    """A plan that was published.

    Attributes:
        at_s: When, monotonic clock.
        stamp_ns: Capture of the picture that it was made from, server's clock.
        waypoints_m: (H, 2) in the robot's frame.
        sighting: Where the robot was seen then or lately; None if it is known by its odometry only.
    """

    at_s: float
    stamp_ns: int
    waypoints_m: FloatArray
    sighting: RobotSighting | None


@dataclass(frozen=True, slots=True)
class Tally:
    """What was counted since the server started.

    Attributes:
        stages_ms: By stage, how often it ran and how long it took in all, milliseconds.
        failures: Ticks that failed.
        plans: Plans sent, by robot.
    """

    stages_ms: dict[str, tuple[int, float]]
    failures: int
    plans: dict[str, int]


@dataclass(frozen=True, slots=True)
class SeenTick:
    """A tick that worked, for those who draw it.

    Attributes:
        stamp_ns: Capture of its picture, server's clock.
        size_px: Width and height of that picture.
        result: What it gave.
    """

    stamp_ns: int
    size_px: tuple[int, int]
    result: TickResult


@dataclass(slots=True)
class _Known:
    """What the ticks have left; guarded by the overview's lock."""

    tick: SeenTick | None = None
    timings: Timings = field(default_factory=Timings)
    latencies: dict[str, Timings] = field(default_factory=dict)
    seen: dict[str, RobotSighting] = field(default_factory=dict)
    sent: dict[str, SentPlan] = field(default_factory=dict)
    fault: str | None = None
    failures: int = 0
    plans: dict[str, int] = field(default_factory=dict)
    ticking_since_s: float | None = None


@dataclass(frozen=True, slots=True)
class _Last:
    """What the ticks have left of one robot."""

    seen: RobotSighting | None
    sent: SentPlan | None
    latency: TimingView | None
    route: SiteRoute | None
    scan: Scan | None


class Overview:
    """Remembers the last tick and answers what there is to show. Thread-safe.

    Args:
        camera: For its status.
        mission: For what is wanted.
        links: For what the robots say.
        courier: For what they replied.
        tag_size_m: Side of the robots' tags, for drawing paths.
        robot_size_m: Length and width of a robot, for drawing it.
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
        robot_size_m: tuple[float, float],
        notes: Sequence[str] = (),
        recording: Callable[[], RecordingView] | None = None,
    ) -> None:
        self._camera = camera
        self._mission = mission
        self._links = links
        self._courier = courier
        self._tag_size_m, self._robot_size_m = tag_size_m, robot_size_m
        self._notes = tuple(notes)
        self._recording = recording
        self._lock = threading.Lock()
        self._known = _Known()

    def note_begin(self) -> None:
        """Remember that a tick has begun."""
        with self._lock:
            self._known.ticking_since_s = time.monotonic()

    def note_end(self) -> None:
        """Remember that no tick runs."""
        with self._lock:
            self._known.ticking_since_s = None

    def hangs_s(self) -> float | None:
        """Return for how long the tick has been at one picture, where that is far too long."""
        with self._lock:
            since_s = self._known.ticking_since_s
        age_s = time.monotonic() - since_s if since_s is not None else 0.0
        return age_s if age_s > _HANGS_S else None

    def note_tick(self, tick: SeenTick, sent: Mapping[str, SentPlan]) -> None:
        """Remember a tick that worked and what it published."""
        result, now_ns = tick.result, time.time_ns()
        with self._lock:
            self._known.fault = None
            self._known.tick = tick
            self._known.timings.add(result.timings_ms)
            for robot, plan in sent.items():
                kept = self._known.latencies.setdefault(robot, Timings())
                kept.add({_LATENCY: (now_ns - plan.stamp_ns) / 1e6})
            self._known.seen.update({s.robot: s for s in result.sightings if s.robot in self._links})
            self._known.sent.update(sent)
            for robot in sent:
                self._known.plans[robot] = self._known.plans.get(robot, 0) + 1

    def note_fault(self, error: Exception) -> bool:
        """Remember a tick that failed; return whether the one before had worked."""
        with self._lock:
            new = self._known.fault is None
            self._known.failures += 1
            self._known.fault = f"tick failed: {type(error).__name__}: {error}"[:_MAX_FAULT_LENGTH]
        return new

    def site(self) -> SiteReport | None:
        """Return the last tick's report of the camera and its map, if it made one."""
        tick = self.tick()
        return tick.result.site if tick is not None else None

    def tick(self) -> SeenTick | None:
        """Return the last tick that worked."""
        with self._lock:
            return self._known.tick

    def tally(self) -> Tally:
        """Return what was counted since the start."""
        with self._lock:
            known = self._known
            return Tally(known.timings.totals_ms(), known.failures, dict(known.plans))

    def view(self) -> ServerView:
        """Return what there is to show now; never waits for the tick, the network or the disk."""
        status = self._camera.status()
        with self._lock:
            known = self._known
            fault, timings = known.fault, known.timings.view()
            latencies = {robot: kept.view()[_LATENCY] for robot, kept in known.latencies.items()}
            seen, sent = dict(known.seen), dict(known.sent)
            site = known.tick.result.site if known.tick is not None else None
        hangs_s = self.hangs_s()
        fault = fault if hangs_s is None else f"the tick hangs: it has been at one picture for {hangs_s:.0f} s"
        trouble = _camera_trouble(status) if status.state is not CameraState.RUNNING else fault
        routes, scans = (site.routes, site.scans) if site is not None else ({}, {})
        lasts = {
            robot: _Last(seen.get(robot), sent.get(robot), latencies.get(robot), routes.get(robot), scans.get(robot))
            for robot in self._mission.names
        }
        robots = [self._robot(robot, status, trouble, last) for robot, last in lasts.items()]
        return self._assemble(status, fault, robots, timings, site)

    def _assemble(
        self,
        status: CameraStatus,
        fault: str | None,
        robots: list[RobotView],
        timings: dict[str, TimingView],
        site: SiteReport | None,
    ) -> ServerView:
        reasons, frame = self._unready(status, fault), self._camera.latest()
        return ServerView(
            camera=CameraView(
                url=self._camera.redacted_url,
                state=status.state.value,
                size_px=status.size_px,
                fps=_rounded(status.fps, 1),
                frame_age_s=_rounded(status.frame_age_s, 3),
                frame_stamp_ms=round(frame.stamp_ns / 1e6, 1) if frame is not None else None,
                reason=status.reason,
                calibration=CalibrationView.of(site.calibration) if site is not None else None,
            ),
            robots=robots,
            timings_ms=timings,
            ready=not reasons,
            reasons=reasons,
            warnings=self._warnings(status, site),
            rejected=self._rejected(status) | (site.rejected if site is not None else {}),
            robot_size_m=self._robot_size_m,
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
        now_ns = time.time_ns()
        seen_age_s = (now_ns - seen.stamp_ns) / 1e9 if seen is not None else None
        driving = last.sent is not None and time.monotonic() - last.sent.at_s <= _DRIVING_S
        led = last.route.reason if last.route is not None else ""
        held = link.state is not None and link.state["stopped"] is True
        does, reason = _judge(
            wanted, held=held, driving=driving, trouble=trouble or led or _sighting_trouble(seen_age_s)
        )
        if does == "driving":
            reason = "; ".join(text for text in (_robot_trouble(link), led) if text) or None
        shown = last.sent if does == "driving" else None
        return RobotView(
            name=robot,
            status=does,
            reason=reason,
            goal=_goal_view(wanted.goal, status.size_px),
            pixel=pairs(seen.pixel[None], digits=1)[0] if seen is not None else None,
            heading=pairs(seen.heading[None], digits=4)[0] if seen is not None else None,
            sighting_age_s=_rounded(seen_age_s, 3),
            tag_px=_rounded(seen.side_px, 1) if seen is not None else None,
            path_px=pairs(self._path_px(shown, last.route), digits=1) if shown is not None else [],
            waypoints_m=pairs(shown.waypoints_m, digits=3) if shown is not None else [],
            plan_age_s=round((now_ns - last.sent.stamp_ns) / 1e9, 3) if last.sent is not None else None,
            picture_to_plan_ms=last.latency,
            scan=scan_view(last.scan, now_ns=now_ns) if last.scan is not None else None,
            clock_offset_ms=_told_ms(link, "clock_offset_ms"),
            round_trip_ms=_told_ms(link, "round_trip_ms"),
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


def _told_ms(link: RobotLink, key: str) -> float | None:
    """Return a number of milliseconds that the robot tells of itself; None if it does not."""
    told = link.state.get(key) if link.state is not None else None
    return float(told) if isinstance(told, int | float) and not isinstance(told, bool) else None


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
