"""Judges what was seen of a robot: is all there that a drive needs, and if not, what to do. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from revnm_client import keys
from revnm_client.doctor.blind_sectors import blind_degrees, sectors
from revnm_client.doctor.observation import Observation, Received, Series
from revnm_client.geometry import FloatArray
from revnm_client.messages import Mounting, Odometry, Scan
from revnm_client.plan_tracking import OdometryBuffer
from revnm_client.safety import SafetyConfig
from revnm_client.settings import FootprintSettings, RobotSettings

_LARGEST_OFFSET_S = 0.1
_LONGEST_ROUND_TRIP_S = 0.1
_LOWEST_SCAN_HZ = 5.0
_LOWEST_ODOMETRY_HZ = 10.0
_AHEAD_DEG = 30
_ASIDE_DEG = 90
_FEW = 0.1


class Verdict(StrEnum):
    """How good something is."""

    OK = "OK"
    WARN = "WARN"
    FAULT = "FAULT"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        verdict: How good it is.
        subject: What was looked at.
        text: What was found, and what to do about it.
    """

    verdict: Verdict
    subject: str
    text: str


def examine(seen: Observation, settings: RobotSettings) -> list[Finding]:
    """Judge what was seen of a robot."""
    scans = _placed(seen.scans, settings.lidar.mounting)
    findings = [*_clock(seen, settings)]
    findings += _coming("scan", keys.scan(settings.robot), seen.scans, seen)
    if seen.scans.items:
        limit_s = settings.safety.max_scan_age_s
        findings += [_scan(scans, limit_s), _view(scans), _own_hits(scans, settings.footprint)]
        findings.append(_stamps("scan", seen.scans, limit_s))
    findings += _coming("odometry", keys.odom(settings.robot), seen.odometry, seen)
    if seen.odometry.items:
        limit_s = settings.safety.max_odometry_age_s
        findings += [_odometry(seen.odometry, limit_s), _stamps("odometry", seen.odometry, limit_s)]
    if seen.scans.items and seen.odometry.items:
        findings.append(_together(seen))
    if seen.rejected:
        text = f"{seen.rejected} scans or odometries were malformed and dropped, the last: {seen.last_error}"
        findings.append(Finding(Verdict.WARN, "messages", text))
    if seen.trouble is not None:
        findings.append(Finding(Verdict.FAULT, "base", f"{seen.trouble}: the robot will not move until that is over"))
    return [*findings, *_plans(seen, settings), *_client(seen)]


def _placed(scans: Series[Scan], lidar: Mounting) -> Series[Scan]:
    """Return the scans with where the LiDAR sits, which no message tells."""
    return Series([Received(lidar.place(each.message), each.received_ns) for each in scans.items])


def _clock(seen: Observation, settings: RobotSettings) -> Iterator[Finding]:
    if seen.clock is None:
        return
    offset_ns, round_trip_ns = seen.clock.offset_ns, seen.clock.round_trip_ns
    if offset_ns is None or round_trip_ns is None:
        asked = f"do its settings have a robot called {settings.robot}, and its certificate that name?"
        text = f"the server does not tell its time: {asked}"
        yield Finding(Verdict.FAULT, "clock", text)
        return
    text = f"server's clock {offset_ns * 1e-6:+.1f} ms from this one's, round trip {round_trip_ns * 1e-6:.1f} ms"
    if abs(offset_ns) > _LARGEST_OFFSET_S * 1e9:
        advice = "it is corrected, but run chrony or systemd-timesyncd on both machines"
        yield Finding(Verdict.WARN, "clock", f"{text}: {advice}")
    elif round_trip_ns > _LONGEST_ROUND_TRIP_S * 1e9:
        yield Finding(Verdict.WARN, "clock", f"{text}: the network is slow: use 5 GHz Wi-Fi, or another channel")
    else:
        yield Finding(Verdict.OK, "clock", text)


def _coming(subject: str, key: str, series: Series[Scan] | Series[Odometry], seen: Observation) -> Iterator[Finding]:
    if series.items:
        return
    if key in seen.last_error:
        yield Finding(Verdict.FAULT, subject, f"all that came was refused: {seen.last_error}")
        return
    text = f"none came in {seen.seconds:g} s: is its driver running, and does a bridge carry it to {key}?"
    yield Finding(Verdict.FAULT, subject, text)


def _scan(series: Series[Scan], limit_s: float) -> Finding:
    newest = series.messages[-1]
    turn_deg = math.degrees(abs(newest.angle_increment_rad) * (len(newest.ranges_m) - 1))
    text = f"{series.rate_hz:.1f} Hz, {len(newest.ranges_m)} beams over {turn_deg:.0f}°, {_nearest(newest)}"
    return _paced("scan", text, series, limit_s, _LOWEST_SCAN_HZ)


def _nearest(scan: Scan) -> str:
    points = scan.points_m()
    if not len(points):
        return "nothing in reach"
    x, y = points[np.argmin(np.hypot(points[:, 0], points[:, 1]))]
    return f"nearest {math.hypot(x, y):.2f} m at {math.degrees(math.atan2(y, x)):.0f}°"


def _paced(
    subject: str, text: str, series: Series[Scan] | Series[Odometry], limit_s: float, lowest_hz: float
) -> Finding:
    """Judge whether messages come often enough, and without pauses that stop the robot."""
    if series.rate_hz == 0.0 or series.longest_gap_s > limit_s:
        pause = f"{series.longest_gap_s:.2f} s" if series.rate_hz else "longer than was looked"
        advice = f"the longest pause was {pause}: the robot stands after {limit_s:g} s without one"
        return Finding(Verdict.FAULT, subject, f"{text}: {advice}")
    stamps = [message.stamp_ns for message in series.messages]
    if len(set(stamps)) == 1:
        return Finding(Verdict.FAULT, subject, f"{text}: the same stamp in all of them: its driver hangs")
    if series.rate_hz < lowest_hz:
        return Finding(Verdict.WARN, subject, f"{text}: expected {lowest_hz:.0f} Hz or more")
    return Finding(Verdict.OK, subject, text)


def _view(series: Series[Scan]) -> Finding:
    """Judge where the LiDAR cannot see; 0° is the front, left is positive."""
    blind = blind_degrees(series.messages)
    where = ", ".join(str(sector) for sector in sectors(blind))
    bearing = np.abs(np.arange(-180, 180))
    if blind[bearing <= _AHEAD_DEG].all():
        text = f"blind ahead ({where}): is the LiDAR mounted the other way round? Then say so: lidar.yaw_rad"
        return Finding(Verdict.FAULT, "view", text)
    if not where:
        return Finding(Verdict.OK, "view", "all around")
    if any(blind[bearing <= _AHEAD_DEG]):
        return Finding(Verdict.WARN, "view", f"blind at {where}: partly ahead; it may hit what stands there")
    if any(blind[bearing <= _ASIDE_DEG]):
        return Finding(Verdict.WARN, "view", f"blind at {where}: it may turn into what stands beside it")
    return Finding(Verdict.OK, "view", f"blind at {where}: what was seen there is remembered for 2 s")


def _own_hits(series: Series[Scan], outline: FootprintSettings) -> Finding:
    inside = [_within(scan.points_m(), outline) for scan in series.messages]
    most = max(inside, key=len)
    if sum(len(points) > 0 for points in inside) <= _FEW * len(inside):
        return Finding(Verdict.OK, "outline", f"{outline.length_m:g} m × {outline.width_m:g} m, no returns within")
    x, y = most.mean(axis=0)
    text = (
        f"{len(most)} beams end within the robot's own outline, about {math.hypot(x, y):.2f} m away at "
        f"{math.degrees(math.atan2(y, x)):.0f}°: the LiDAR sees the robot. Mask these beams in its driver (range 0), "
        "or mend footprint or lidar"
    )
    return Finding(Verdict.FAULT, "outline", text)


def _within(points_m: FloatArray, outline: FootprintSettings) -> FloatArray:
    """Return those of the points (M, 2), robot frame, that lie within the outline."""
    from_middle = np.abs(points_m - (outline.center_x_m, 0.0))
    return points_m[(from_middle < (outline.length_m / 2.0, outline.width_m / 2.0)).all(axis=1)]


def _odometry(series: Series[Odometry], limit_s: float) -> Finding:
    velocity = series.messages[-1].velocity
    text = f"{series.rate_hz:.1f} Hz, {velocity.v_mps:.2f} m/s, {velocity.w_radps:+.2f} rad/s"
    return _paced("odometry", text, series, limit_s, _LOWEST_ODOMETRY_HZ)


def _stamps(subject: str, series: Series[Scan] | Series[Odometry], limit_s: float) -> Finding:
    """Judge the stamps against this machine's clock, in which the robot judges ages."""
    subject, lag_s = f"{subject} stamps", series.lag_s
    if lag_s < -SafetyConfig().max_ahead_s:
        text = f"{-lag_s:.2f} s in the future: the clock of the computer that stamps is wrong: run chrony on it"
        return Finding(Verdict.FAULT, subject, text)
    if lag_s > limit_s:
        text = (
            f"{lag_s:.2f} s old when they come, expected {limit_s:g} s at most: its computer's clock is wrong (run "
            "chrony), it stamps by another clock (use_sim_time?), or it is late"
        )
        return Finding(Verdict.FAULT, subject, text)
    return Finding(Verdict.OK, subject, f"{1e3 * lag_s:.0f} ms old when they come")


def _together(seen: Observation) -> Finding:
    """Judge whether the odometry says where the robot was at each scan, as the robot's brain needs it."""
    buffer, known, restarts = OdometryBuffer(), [], 0
    events: list[Received[Odometry] | Received[Scan]] = [*seen.odometry.items, *seen.scans.items]
    for message in (event.message for event in sorted(events, key=lambda event: event.received_ns)):
        if isinstance(message, Odometry):
            restarts += not buffer.add(message)
        else:
            known.append(buffer.at(message.stamp_ns) is not None)
    missed = known.count(False)
    if missed > _FEW * len(known):
        text = f"{missed} of {len(known)} scans have no odometry within 100 ms of their stamps: they are not used"
        return Finding(Verdict.FAULT, "scan and odometry", f"{text}. Both must be stamped by one clock")
    if restarts:
        text = f"the odometry's pose jumped {restarts} times: the robot forgets what it saw and stands a moment"
        return Finding(Verdict.WARN, "scan and odometry", text)
    return Finding(Verdict.OK, "scan and odometry", "the place of every scan is known")


def _plans(seen: Observation, settings: RobotSettings) -> Iterator[Finding]:
    if seen.clock is None:
        return
    if not seen.plans.items:
        text = "none came, as it is while no goal is set; with a goal set, ask revnm-server doctor"
        yield Finding(Verdict.OK, "plans", text)
        return
    lag_s = seen.plans.lag_s + (seen.clock.offset_ns or 0) * 1e-9
    text = f"{seen.plans.rate_hz:.1f} Hz, {1e3 * lag_s:.0f} ms from picture to robot"
    if lag_s > settings.safety.max_plan_age_s:
        advice = f"expected {settings.safety.max_plan_age_s:g} s at most: server or network is too slow"
        yield Finding(Verdict.FAULT, "plans", f"{text}: {advice}")
    else:
        yield Finding(Verdict.OK, "plans", text)


def _client(seen: Observation) -> Iterator[Finding]:
    if seen.clock is None:
        return
    if seen.state is None:
        yield Finding(Verdict.OK, "client", "none runs on this robot now: revnm-robot run starts it")
    else:
        reason = seen.state["reason"]
        yield Finding(Verdict.OK, "client", "runs, and " + ("drives" if reason is None else f"stands: {reason}"))
