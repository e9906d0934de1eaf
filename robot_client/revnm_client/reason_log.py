"""The log of a drive: one line whenever the robot begins to drive, stops, or stands for another reason than before.

Conditions that come and go must not fill the log: after some lines at once there is one every five seconds, which says
how many changes were left out, and since when its condition has lasted.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from revnm_client.json_payload import Scalar
from revnm_client.messages import STANDSTILL, Velocity

_log = logging.getLogger(__name__)

_AGES = {"plan": "plan_age_ms", "scan": "scan_age_ms", "odometry": "odometry_age_ms"}
_COUNTERS = {"refused": "rejected", "malformed": "malformed", "failures": "tick_failures"}
_DRIVING = "driving"
_AT_ONCE = 6.0
_LINES_PER_S = 0.2
_LATE_S = 0.5


def condition(reason: str | None) -> str:
    """Return the reason without its numbers, so that a growing age is one condition and not many."""
    return _DRIVING if reason is None else re.sub(r"\d+(\.\d+)?", "#", reason)


@dataclass(frozen=True, slots=True)
class _Change:
    """When a condition began, and what was before: how long, whether the robot drove, what was commanded last."""

    at_s: float
    lasted_s: float
    drove: bool
    commanded: Velocity


class ReasonLog:
    """Says when a line is due, and writes it."""

    def __init__(self, reason: str | None, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Begin with a reason that needs no line."""
        self._clock_s = clock_s
        self._refilled_s = clock_s()
        self._change = _Change(self._refilled_s, 0.0, drove=False, commanded=STANDSTILL)
        self._commanded = STANDSTILL
        self._told = self._seen = condition(reason)
        self._changes = 0
        self._lines_left = _AT_ONCE

    def due(self, reason: str | None) -> bool:
        """Note the reason of a tick; return whether a line is to be written now: the condition is not the last line's.

        Where there were too many lines lately it returns True in a later tick, if the condition is still another.
        """
        now_s, seen = self._clock_s(), condition(reason)
        self._lines_left = min(_AT_ONCE, self._lines_left + (now_s - self._refilled_s) * _LINES_PER_S)
        self._refilled_s = now_s
        if seen != self._seen:
            drove = self._seen == _DRIVING or self._commanded != STANDSTILL
            self._change = _Change(now_s, now_s - self._change.at_s, drove, self._commanded)
            self._changes += 1
            self._seen = seen
        if seen == self._told or self._lines_left < 1.0:
            return False
        self._lines_left -= 1.0
        self._told = seen
        return True

    def keep(self, commanded: Velocity) -> None:
        """Remember what was commanded in a tick, for the line that tells of the next change."""
        self._commanded = commanded

    def write(self, reason: str | None, commanded: Velocity, state: Mapping[str, Scalar]) -> None:
        """Write that the condition has changed, when it is :meth:`due`.

        Args:
            reason: Why the robot stands, or that it gets itself out of somewhere; None while it drives.
            commanded: In this tick.
            state: The robot's state message.
        """
        change, left_out = self._change, max(0, self._changes - 1)
        since_s = self._clock_s() - change.at_s
        parts = [
            _told(reason, moves=commanded != STANDSTILL),
            *([f"since {since_s:.1f} s"] if since_s > _LATE_S else []),
            f"commanded {_velocity(commanded)} after {_velocity(change.commanded)}",
            f"{'drove' if change.drove else 'stood'} {change.lasted_s:.1f} s before",
            *([f"{left_out} changes left out"] if left_out else []),
            "ages " + ", ".join(f"{name} {_age(state.get(key))}" for name, key in _AGES.items()),
            ", ".join(f"{name} {state.get(key, 0)}" for name, key in _COUNTERS.items()),
        ]
        shown = ("v_mps", "w_radps", "plan_seq", "goal_id", *_AGES.values(), *_COUNTERS.values())
        fields = {"reason": reason, "since_s": round(since_s, 3), "lasted_s": round(change.lasted_s, 3)}
        _log.info("; ".join(parts), extra={key: state.get(key) for key in shown} | fields | {"left_out": left_out})
        self._changes = 0


def _told(reason: str | None, *, moves: bool) -> str:
    if reason is None:
        return _DRIVING
    return reason if moves else f"stopped: {reason}"


def _velocity(velocity: Velocity) -> str:
    return f"{velocity.v_mps:.2f} m/s {velocity.w_radps:+.2f} rad/s"


def _age(value: Scalar) -> str:
    return "none" if value is None else f"{value} ms"
