"""Gathers what is known of camera, robots and ticks into one :class:`revnm_server.view.ServerView`."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from revnm_client import keys
from revnm_client.geometry import FloatArray
from revnm_server.camera import CameraSource, CameraState, CameraStatus
from revnm_server.frame import RobotSighting
from revnm_server.mission import Goal, Mission, RobotMission
from revnm_server.orders import OrderCourier
from revnm_server.pipeline import TickResult
from revnm_server.robot_link import RobotLink
from revnm_server.view import (
    CameraView,
    GoalView,
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
        sighting: What it was made from.
    """

    at_s: float
    waypoints_m: FloatArray
    sighting: RobotSighting


@dataclass(slots=True)
class _Known:
    """What the ticks have left; guarded by the overview's lock."""

    timings: Timings = field(default_factory=Timings)
    seen: dict[str, RobotSighting] = field(default_factory=dict)
    sent: dict[str, SentPlan] = field(default_factory=dict)
    fault: str | None = None


class Overview:
    """Remembers the last tick and answers what there is to show. Thread-safe.

    Args:
        camera: For its status.
        mission: For what is wanted.
        links: For what the robots say.
        courier: For what they replied.
        tag_size_m: Side of the robots' tags, for drawing paths.
    """

    def __init__(
        self,
        camera: CameraSource,
        mission: Mission,
        links: Mapping[str, RobotLink],
        courier: OrderCourier,
        *,
        tag_size_m: float,
    ) -> None:
        self._camera = camera
        self._mission = mission
        self._links = links
        self._courier = courier
        self._tag_size_m = tag_size_m
        self._lock = threading.Lock()
        self._known = _Known()

    def note_tick(self, result: TickResult, sent: Mapping[str, SentPlan]) -> None:
        """Remember a tick that worked and what it published."""
        with self._lock:
            self._known.fault = None
            self._known.timings.add(result.timings_ms)
            self._known.seen.update({s.robot: s for s in result.sightings if s.robot in self._links})
            self._known.sent.update(sent)

    def note_fault(self, error: Exception) -> bool:
        """Remember a tick that failed; return whether the one before had worked."""
        with self._lock:
            new = self._known.fault is None
            self._known.fault = f"tick failed: {type(error).__name__}: {error}"[:_MAX_FAULT_LENGTH]
        return new

    def view(self) -> ServerView:
        """Return what there is to show now; never waits for the tick, the network or the disk."""
        status = self._camera.status()
        with self._lock:
            known = self._known
            fault, timings = known.fault, known.timings.view()
            seen, sent = dict(known.seen), dict(known.sent)
        robots = [self._robot(robot, status, fault, seen.get(robot), sent.get(robot)) for robot in self._mission.names]
        return self._assemble(status, fault, robots, timings)

    def _assemble(
        self,
        status: CameraStatus,
        fault: str | None,
        robots: list[RobotView],
        timings: dict[str, TimingView],
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
            ),
            robots=robots,
            timings_ms=timings,
            ready=not reasons,
            reasons=reasons,
            warnings=[text for text in (status.warning, self._mission.save_error) if text is not None],
            rejected=self._rejected(status),
        )

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

    def _robot(
        self,
        robot: str,
        status: CameraStatus,
        fault: str | None,
        seen: RobotSighting | None,
        sent: SentPlan | None,
    ) -> RobotView:
        wanted, link = self._mission.of(robot), self._links[robot]
        seen_age_s = (time.time_ns() - seen.stamp_ns) / 1e9 if seen is not None else None
        driving = sent is not None and time.monotonic() - sent.at_s <= _DRIVING_S
        trouble = _camera_trouble(status) if status.state is not CameraState.RUNNING else fault
        held = link.state is not None and link.state["stopped"] is True
        does, reason = _judge(wanted, held=held, driving=driving, trouble=trouble or _sighting_trouble(seen_age_s))
        if does == "driving":
            reason = _robot_trouble(link)
        shown = sent if does == "driving" else None
        return RobotView(
            name=robot,
            status=does,
            reason=reason,
            goal=_goal_view(wanted.goal, status.size_px),
            pixel=pairs(seen.pixel[None], digits=1)[0] if seen is not None else None,
            heading=pairs(seen.heading[None], digits=4)[0] if seen is not None else None,
            sighting_age_s=_rounded(seen_age_s, 3),
            path_px=pairs(self._path_px(shown), digits=1) if shown is not None else [],
            waypoints_m=pairs(shown.waypoints_m, digits=3) if shown is not None else [],
            robot_state=link.state,
            robot_state_age_s=_rounded(link.state_age_s, 3),
            epoch=wanted.epoch,
            seq=self._mission.seq(robot),
        )

    def _path_px(self, sent: SentPlan) -> FloatArray:
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
