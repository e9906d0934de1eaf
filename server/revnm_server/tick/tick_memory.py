"""Remembers what the ticks left: the last one, its timings, plans and faults."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from revnm_client.geometry import FloatArray
from revnm_server.frame import RobotSighting
from revnm_server.tick.pipeline import TickResult
from revnm_server.tick.site_report import SiteReport
from revnm_server.tick.timings import Timings
from revnm_server.views.view import TimingView

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


@dataclass(frozen=True, slots=True)
class Remembered:
    """What the ticks have left, as of one moment.

    Attributes:
        site: The last tick's report of the camera and its map; None where there is none.
        timings: By stage.
        latencies: From picture to plan, by robot that was sent any.
        seen: The last sighting of each robot.
        sent: The last plan of each robot.
        fault: Why the last tick failed, or that one hangs; None where all is well.
    """

    site: SiteReport | None
    timings: dict[str, TimingView]
    latencies: dict[str, TimingView]
    seen: dict[str, RobotSighting]
    sent: dict[str, SentPlan]
    fault: str | None


@dataclass(slots=True)
class _Known:
    """What the ticks have left; guarded by the memory's lock."""

    tick: SeenTick | None = None
    timings: Timings = field(default_factory=Timings)
    latencies: dict[str, Timings] = field(default_factory=dict)
    seen: dict[str, RobotSighting] = field(default_factory=dict)
    sent: dict[str, SentPlan] = field(default_factory=dict)
    fault: str | None = None
    failures: int = 0
    plans: dict[str, int] = field(default_factory=dict)
    ticking_since_s: float | None = None


class TickMemory:
    """Takes what ticks leave from one thread, and tells it to any."""

    def __init__(self) -> None:
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

    def ticking(self) -> bool:
        """Return whether a tick runs."""
        return self._known.ticking_since_s is not None

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
            self._known.seen.update({s.robot: s for s in result.sightings})
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

    def tick(self) -> SeenTick | None:
        """Return the last tick that worked."""
        with self._lock:
            return self._known.tick

    def tally(self) -> Tally:
        """Return what was counted since the start."""
        with self._lock:
            known = self._known
            return Tally(known.timings.totals_ms(), known.failures, dict(known.plans))

    def remembered(self) -> Remembered:
        """Return what the ticks have left, as of now."""
        hangs_s = self.hangs_s()
        with self._lock:
            known = self._known
            return Remembered(
                site=known.tick.result.site if known.tick is not None else None,
                timings=known.timings.view(),
                latencies={robot: kept.view()[_LATENCY] for robot, kept in known.latencies.items()},
                seen=dict(known.seen),
                sent=dict(known.sent),
                fault=known.fault if hangs_s is None else _hanging(hangs_s),
            )


def _hanging(hangs_s: float) -> str:
    return f"the tick hangs: it has been at one picture for {hangs_s:.0f} s"
