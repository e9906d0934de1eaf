"""The log of a drive: one line whenever the robot begins to drive, stops, or stands for another reason than before."""

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


def condition(reason: str | None) -> str:
    """Return the reason without its numbers, so that a growing age is one condition and not many."""
    return "driving" if reason is None else re.sub(r"\d+(\.\d+)?", "#", reason)


class ReasonLog:
    """Writes the lines; knows how long the condition before lasted and what was commanded in it last."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._since_s = clock_s()
        self._drove = False
        self._before = STANDSTILL

    def keep(self, commanded: Velocity) -> None:
        """Remember what was commanded in a tick, for the line that tells of the next change."""
        self._before = commanded

    def write(self, reason: str | None, commanded: Velocity, state: Mapping[str, Scalar]) -> None:
        """Write that the condition has changed.

        Args:
            reason: Why the robot stands, or that it gets itself out of somewhere; None while it drives.
            commanded: In the tick that changed it.
            state: The robot's state message.
        """
        now_s = self._clock_s()
        lasted_s = now_s - self._since_s
        parts = [
            _told(reason, moves=commanded != STANDSTILL),
            f"commanded {_velocity(commanded)} after {_velocity(self._before)}",
            f"{'drove' if self._drove else 'stood'} {lasted_s:.1f} s before",
            "ages " + ", ".join(f"{name} {_age(state.get(key))}" for name, key in _AGES.items()),
            ", ".join(f"{name} {state.get(key, 0)}" for name, key in _COUNTERS.items()),
        ]
        shown = ("v_mps", "w_radps", "plan_seq", "goal_id", *_AGES.values(), *_COUNTERS.values())
        fields = {key: state.get(key) for key in shown} | {"reason": reason, "lasted_s": round(lasted_s, 3)}
        _log.info("; ".join(parts), extra=fields)
        self._since_s, self._drove = now_s, reason is None or commanded != STANDSTILL


def _told(reason: str | None, *, moves: bool) -> str:
    if reason is None:
        return "driving"
    return reason if moves else f"stopped: {reason}"


def _velocity(velocity: Velocity) -> str:
    return f"{velocity.v_mps:.2f} m/s {velocity.w_radps:+.2f} rad/s"


def _age(value: Scalar) -> str:
    return "none" if value is None else f"{value} ms"
