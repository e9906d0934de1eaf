"""The log of a drive: one line whenever the robot begins to drive, stops, or stands for another reason than before.

A condition that comes and goes in every other tick must not fill the log: after some lines at once there is one every
few seconds, which says how many changes were left out.
"""

from __future__ import annotations

import logging
import re
import time
from collections.abc import Callable, Mapping

from revnm_client.json_payload import Scalar
from revnm_client.messages import STANDSTILL, Velocity

_log = logging.getLogger(__name__)

_AGES = {"plan": "plan_age_ms", "scan": "scan_age_ms", "odometry": "odometry_age_ms"}
_COUNTERS = {"refused": "rejected", "malformed": "malformed", "failures": "tick_failures"}
_AT_ONCE = 6.0
_LINES_PER_S = 0.2


def condition(reason: str | None) -> str:
    """Return the reason without its numbers, so that a growing age is one condition and not many."""
    return "driving" if reason is None else re.sub(r"\d+(\.\d+)?", "#", reason)


class ReasonLog:
    """Says when a line is due and writes it; knows how long the condition before lasted and what was commanded last."""

    def __init__(self, reason: str | None, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Begin with a reason that needs no line."""
        self._clock_s = clock_s
        self._since_s = self._refilled_s = clock_s()
        self._drove = False
        self._before = STANDSTILL
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
        self._changes += seen != self._seen
        self._seen = seen
        if seen == self._told or self._lines_left < 1.0:
            return False
        self._lines_left -= 1.0
        self._told = seen
        return True

    def keep(self, commanded: Velocity) -> None:
        """Remember what was commanded in a tick, for the line that tells of the next change."""
        self._before = commanded

    def write(self, reason: str | None, commanded: Velocity, state: Mapping[str, Scalar]) -> None:
        """Write that the condition has changed, when it is :meth:`due`.

        Args:
            reason: Why the robot stands, or that it gets itself out of somewhere; None while it drives.
            commanded: In the tick that changed it.
            state: The robot's state message.
        """
        now_s = self._clock_s()
        lasted_s, left_out = now_s - self._since_s, max(0, self._changes - 1)
        before = f"{'drove' if self._drove else 'stood'} {lasted_s:.1f} s before"
        parts = [
            _told(reason, moves=commanded != STANDSTILL),
            f"commanded {_velocity(commanded)} after {_velocity(self._before)}",
            f"{left_out} changes in {lasted_s:.1f} s left out" if left_out else before,
            "ages " + ", ".join(f"{name} {_age(state.get(key))}" for name, key in _AGES.items()),
            ", ".join(f"{name} {state.get(key, 0)}" for name, key in _COUNTERS.items()),
        ]
        shown = ("v_mps", "w_radps", "plan_seq", "goal_id", *_AGES.values(), *_COUNTERS.values())
        fields = {"reason": reason, "lasted_s": round(lasted_s, 3), "left_out": left_out}
        _log.info("; ".join(parts), extra={key: state.get(key) for key in shown} | fields)
        self._since_s, self._drove, self._changes = now_s, reason is None or commanded != STANDSTILL, 0


def _told(reason: str | None, *, moves: bool) -> str:
    if reason is None:
        return "driving"
    return reason if moves else f"stopped: {reason}"


def _velocity(velocity: Velocity) -> str:
    return f"{velocity.v_mps:.2f} m/s {velocity.w_radps:+.2f} rad/s"


def _age(value: Scalar) -> str:
    return "none" if value is None else f"{value} ms"
