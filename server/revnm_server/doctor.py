"""Judges a server by what it shows of itself: is all there that a drive needs, and if not, what to do.

Pure: it is given the view, of a server that runs or of one that was started to be looked at.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from revnm_server.views.view import CameraView, RobotView, ServerView

_FEWEST_FPS = 5.0
_OLDEST_FRAME_S = 0.5
_LEAST_TAG_PX = 24.0
_OLDEST_SIGHTING_S = 1.0
_LONGEST_HIDDEN_S = 3.0
_OLDEST_STATE_S = 3.0
_LARGEST_OFFSET_MS = 100.0


class Verdict(StrEnum):
    """How good something is."""

    GOOD = "good"
    WARNING = "warning"
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


def examine(view: ServerView, *, tags: Mapping[str, int], tick_hz: float) -> list[Finding]:
    """Judge a server.

    Args:
        view: What it shows after some seconds.
        tags: Id of each robot's tag.
        tick_hz: Most ticks a second that it was set to.
    """
    findings = [_camera(view.camera)]
    if view.camera.state == "running":
        findings.append(_tick(view, tick_hz))
    for robot in view.robots:
        if view.camera.state == "running":
            findings.append(_tag(robot, tags.get(robot.name)))
        findings += _link(robot)
    findings += [Finding(Verdict.WARNING, "server", text) for text in view.warnings]
    findings += _rejected(view.rejected)
    return findings


def _camera(camera: CameraView) -> Finding:
    if camera.state != "running" or camera.size_px is None or camera.frame_age_s is None:
        return Finding(Verdict.FAULT, "camera", f"{camera.url} is {camera.state}: {camera.reason}")
    width, height = camera.size_px
    fps = camera.fps or 0.0
    text = f"{width} × {height} at {fps:.1f} pictures a second, the newest {1e3 * camera.frame_age_s:.0f} ms old"
    if fps < _FEWEST_FPS:
        return Finding(
            Verdict.WARNING, "camera", f"{text}: expected {_FEWEST_FPS:.0f} or more: see the camera's frame rate"
        )
    if camera.frame_age_s > _OLDEST_FRAME_S:
        return Finding(Verdict.WARNING, "camera", f"{text}: the network or this machine is too slow for it")
    return Finding(Verdict.GOOD, "camera", text)


def _tick(view: ServerView, tick_hz: float) -> Finding:
    tick = view.timings_ms.get("tick")
    if tick is None:
        trouble = "; ".join(view.reasons) or "no picture was processed"
        return Finding(Verdict.FAULT, "tick", trouble)
    text = f"p50 {tick.p50:.0f} ms, p95 {tick.p95:.0f} ms"
    if tick.p95 > 1e3 / tick_hz:
        advice = f"expected {1e3 / tick_hz:.0f} ms at most for {tick_hz:g} ticks a second: robots are led less often"
        return Finding(Verdict.WARNING, "tick", f"{text}: {advice}")
    return Finding(Verdict.GOOD, "tick", text)


def _tag(robot: RobotView, tag_id: int | None) -> Finding:
    subject = f"{robot.name}: tag"
    if tag_id is None:
        return Finding(
            Verdict.WARNING, subject, "the server has this robot, these settings have not: give it the same ones"
        )
    if robot.tag_px is None or robot.sighting_age_s is None or robot.sighting_age_s > _OLDEST_SIGHTING_S:
        return _unseen(robot, tag_id)
    text = f"id {tag_id} seen, {robot.tag_px:.0f} px along its shortest side"
    if robot.tag_px < _LEAST_TAG_PX:
        advice = f"expected {_LEAST_TAG_PX:.0f} px where robots drive: a larger tag, or more pixels from the camera"
        return Finding(Verdict.WARNING, subject, f"{text}: {advice}")
    return Finding(Verdict.GOOD, subject, text)


def _unseen(robot: RobotView, tag_id: int) -> Finding:
    age_s, since = robot.sighting_age_s, "is not in the picture"
    if age_s is not None:
        since = f"was last seen {age_s:.1f} s ago"
    text = f"AprilTag 36h11, id {tag_id}, {since}: place the robot in sight, check the id and the light"
    hidden_a_moment = age_s is not None and age_s <= _LONGEST_HIDDEN_S
    return Finding(Verdict.WARNING if hidden_a_moment else Verdict.FAULT, f"{robot.name}: tag", text)


def _link(robot: RobotView) -> Iterator[Finding]:
    subject = f"{robot.name}: link"
    if robot.robot_state is None or robot.robot_state_age_s is None or robot.robot_state_age_s > _OLDEST_STATE_S:
        text = "the robot is not heard: is revnm-robot running, connected to this server, and named so?"
        yield Finding(Verdict.FAULT, subject, text)
        return
    yield Finding(Verdict.GOOD, subject, f"heard {robot.robot_state_age_s:.1f} s ago")
    offset_ms = robot.clock_offset_ms
    if offset_ms is None:
        text = "the robot does not know by how much its clock differs from the server's: it will not move"
        yield Finding(Verdict.FAULT, f"{robot.name}: clock", text)
    elif abs(offset_ms) > _LARGEST_OFFSET_MS:
        text = f"{offset_ms:.0f} ms off: it is corrected, but run chrony or systemd-timesyncd on both machines"
        yield Finding(Verdict.WARNING, f"{robot.name}: clock", text)
    else:
        yield Finding(Verdict.GOOD, f"{robot.name}: clock", f"{offset_ms:.1f} ms off")


def _rejected(rejected: Mapping[str, int]) -> Iterator[Finding]:
    for key, count in rejected.items():
        if count:
            text = f"{count} messages were refused: malformed, or their stamps are off by more than a second"
            yield Finding(Verdict.WARNING, key, text)
