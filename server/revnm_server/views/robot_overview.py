"""What there is to show of one robot: what it does, why it does not, and what of it the picture and the ticks tell."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_client.messages import Scan
from revnm_server.frame import RobotSighting
from revnm_server.mapping.tag_plane import path_in_picture
from revnm_server.robots.mission import Goal, RobotMission
from revnm_server.robots.robot_link import RobotLink
from revnm_server.tick.site_report import SiteRoute
from revnm_server.tick.tick_memory import Remembered, SentPlan
from revnm_server.views.view import GoalView, RobotView, Status, TimingView, pairs, rounded, scan_view

FOREIGN_STOP = "the robot holds a stop that did not come from this server: resume it"

_DRIVING_S = 0.5
_SILENT_S = 2.0  # robots say how they are twice a second


@dataclass(frozen=True, slots=True)
class LastOfRobot:
    """What the ticks have left of one robot; None where there is nothing.

    Attributes:
        seen: Its last sighting.
        sent: The last plan that was sent to it.
        latency: From picture to plan.
        route: Where the map's planner leads it.
        scan: What its LiDAR measured.
    """

    seen: RobotSighting | None
    sent: SentPlan | None
    latency: TimingView | None
    route: SiteRoute | None
    scan: Scan | None

    @classmethod
    def of(cls, robot: str, ticks: Remembered) -> LastOfRobot:
        """Return what is remembered of a robot."""
        site = ticks.site
        return cls(
            ticks.seen.get(robot),
            ticks.sent.get(robot),
            ticks.latencies.get(robot),
            site.routes.get(robot) if site is not None else None,
            site.scans.get(robot) if site is not None else None,
        )


def holds_foreign_stop(wanted: RobotMission, link: RobotLink) -> bool:
    """Return whether a robot stands for somebody else's stop, as of a server that has ended since."""
    return not wanted.stopped and wanted.order is None and link.stop_latched is True


def robot_view(
    link: RobotLink,
    wanted: RobotMission,
    last: LastOfRobot,
    *,
    trouble: str | None,
    refused: str,
    size_px: tuple[int, int] | None,
    tag_size_m: float,
    seq: int,
) -> RobotView:
    """Return what there is to show of a robot now.

    Args:
        link: What it says.
        wanted: What the operator wants of it.
        last: What the ticks have left of it.
        trouble: Why no robot can get plans; None where that is well.
        refused: Why it refuses what it was told last; empty where it does not.
        size_px: Of the camera's picture.
        tag_size_m: Side of its tag, for drawing its path.
        seq: Number of its last plan.
    """
    seen = last.seen
    now_ns = time.time_ns()
    seen_age_s = (now_ns - seen.stamp_ns) / 1e9 if seen is not None else None
    sending = last.sent is not None and time.monotonic() - last.sent.at_s <= _DRIVING_S
    unheeded = _unheeded(link) if sending else None
    led = last.route.reason if last.route is not None else ""
    trouble = unheeded or trouble or led or _sighting_trouble(seen_age_s)
    held = holds_foreign_stop(wanted, link)
    does, reason = _judge(wanted, held=held, driving=sending and unheeded is None, trouble=trouble, refused=refused)
    if does == "driving":
        reason = "; ".join(text for text in (_robot_trouble(link), led) if text) or None
    shown = last.sent if does == "driving" else None
    return RobotView(
        name=link.robot,
        status=does,
        reason=reason,
        goal=_goal_view(wanted.goal, size_px),
        pixel=pairs(seen.pixel[None], digits=1)[0] if seen is not None else None,
        heading=pairs(seen.heading[None], digits=4)[0] if seen is not None else None,
        sighting_age_s=rounded(seen_age_s, 3),
        tag_px=rounded(seen.side_px, 1) if seen is not None else None,
        path_px=pairs(_path_px(shown, last.route, tag_size_m), digits=1) if shown is not None else [],
        waypoints_m=pairs(shown.waypoints_m, digits=3) if shown is not None else [],
        plan_age_s=round((now_ns - last.sent.stamp_ns) / 1e9, 3) if last.sent is not None else None,
        picture_to_plan_ms=last.latency,
        scan=scan_view(last.scan, now_ns=now_ns) if last.scan is not None else None,
        clock_offset_ms=_told_ms(link, "clock_offset_ms"),
        round_trip_ms=_told_ms(link, "round_trip_ms"),
        robot_state=link.state,
        robot_state_age_s=rounded(link.state_age_s, 3),
        epoch=wanted.epoch,
        seq=seq,
    )


def _path_px(sent: SentPlan, route: SiteRoute | None, tag_size_m: float) -> FloatArray:
    """Return the way through the learnt camera; where there is none, the waypoints by the robot's tag."""
    if route is not None and route.way_px is not None:
        return route.way_px
    if sent.sighting is None:
        return np.empty((0, 2))
    return path_in_picture(sent.waypoints_m, sent.sighting, tag_size_m=tag_size_m)


def _judge(wanted: RobotMission, *, held: bool, driving: bool, trouble: str, refused: str) -> tuple[Status, str | None]:
    """Return what the robot is doing, and why.

    Args:
        wanted: What the operator wants of it.
        held: The robot stands for a stop of somebody else.
        driving: It is being given plans, and is there.
        trouble: What keeps plans from being made, or from reaching it.
        refused: Why it refuses what it was told last.
    """
    if wanted.stopped:
        return "stopped", _unconfirmed("the stop", refused) if wanted.order is not None else None
    if held:
        return "stopped", FOREIGN_STOP
    if wanted.goal is None:
        return "no_goal", _unconfirmed("to go on", refused) if wanted.order is not None else None
    if wanted.arrived:
        return "arrived", None
    return ("driving", None) if driving else ("waiting", trouble)


def _unconfirmed(order: str, refused: str) -> str:
    return f"the robot has not confirmed {order}" + (f", and says: {refused}" if refused else "")


def _robot_trouble(link: RobotLink) -> str | None:
    """Return why a robot that is given plans does not move, as far as it says."""
    if link.state is None or link.state["moving"] or not link.state["reason"]:
        return None
    return f"robot: {link.state['reason']}"


def _unheeded(link: RobotLink) -> str | None:
    """Return why nobody knows whether a robot heeds its plans, or why it does not; None where it does."""
    if link.state_age_s is None:
        return "the robot has not been heard yet"
    if link.state_age_s > _SILENT_S:
        return f"the robot was heard {link.state_age_s:.1f} s ago"
    if link.followed is not None:
        return f"the robot follows another server, {link.followed}: take it out of the settings of one of the two"
    return None


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
