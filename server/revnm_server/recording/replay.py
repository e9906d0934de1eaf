"""Makes the plans of a record again, and compares them with those that were made."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.calibration.adjustment import Belief
from revnm_server.ports import Heard
from revnm_server.recording.record_reader import RecordedTick
from revnm_server.recording.tick_document import TickDocument
from revnm_server.service import TickSource
from revnm_server.tick.pipeline import TickResult

_LEAST_AGREEMENT = 0.95  # share of ticks in which both or neither must have a plan


class RecordedSenses:
    """A robot's senses as they were: in each turn they hear what was heard in it."""

    def __init__(self) -> None:
        self._turns: deque[Heard] = deque()

    @property
    def rejected(self) -> dict[str, int]:
        """Nothing is refused: it was not recorded as heard."""
        return {}

    def give(self, turns: Iterable[Heard]) -> None:
        """Set what is heard next; what was not asked for before is forgotten."""
        self._turns = deque(turns)

    def listen(self) -> Heard:
        """Return what was heard in the next turn."""
        return self._turns.popleft() if self._turns else Heard()


@dataclass(slots=True)
class RobotComparison:
    """A robot's plans, then and now.

    Attributes:
        ticks: In which it had a goal.
        then: In which it got a plan when they were recorded.
        now: In which it gets one now.
        alike: In which it got one both times or neither time.
        reasons_alike: In which the reason is the same.
        distances_m: Between the waypoints, where both have a plan.
    """

    ticks: int = 0
    then: int = 0
    now: int = 0
    alike: int = 0
    reasons_alike: int = 0
    distances_m: list[FloatArray] = field(default_factory=list)

    def add(self, then_m: FloatArray | None, now_m: FloatArray | None, *, same_reason: bool) -> None:
        """Take a tick: the waypoints (H, 2) of both plans."""
        self.ticks += 1
        self.then += then_m is not None
        self.now += now_m is not None
        self.alike += (then_m is None) == (now_m is None)
        self.reasons_alike += same_reason
        if then_m is not None and now_m is not None:
            count = min(len(then_m), len(now_m))
            self.distances_m.append(np.linalg.norm(then_m[:count] - now_m[:count], axis=1))

    def row(self, robot: str) -> dict[str, Any]:
        """Return a row of the report."""
        apart = np.concatenate(self.distances_m) if self.distances_m else np.empty(0)
        p50, p95, most = (
            (round(float(value), 4) for value in (*np.percentile(apart, (50.0, 95.0)), apart.max()))
            if apart.size
            else (None, None, None)
        )
        return {
            "robot": robot,
            "ticks": self.ticks,
            "plans_recorded": self.then,
            "plans_replayed": self.now,
            "plans_in_both": len(self.distances_m),
            "agreement": round(self.alike / self.ticks, 4),
            "same_reason": round(self.reasons_alike / self.ticks, 4),
            "p50_m": p50,
            "p95_m": p95,
            "max_m": most,
        }


@dataclass(slots=True)
class Comparison:
    """All of a replay.

    Attributes:
        ticks: Made again.
        originals: Of these, with the picture as the camera sent it.
        missing: Messages that were heard and the record lacks.
        failed_then: Ticks that failed when they were recorded.
        failed_now: Ticks that fail now.
        robots: By name.
    """

    ticks: int = 0
    originals: int = 0
    missing: int = 0
    failed_then: int = 0
    failed_now: int = 0
    robots: dict[str, RobotComparison] = field(default_factory=dict)

    def rows(self) -> list[dict[str, Any]]:
        """Return a row of each robot that had a goal."""
        return [comparison.row(robot) for robot, comparison in sorted(self.robots.items())]

    def within(self, tolerance_m: float) -> bool:
        """Tell whether each robot's waypoints are nearer than that in 95 of 100, and plans are there when they were."""
        rows = self.rows()
        near = all(row["p95_m"] is None or row["p95_m"] <= tolerance_m for row in rows)
        return near and all(row["agreement"] >= _LEAST_AGREEMENT for row in rows)


def known_before(first: TickDocument) -> Belief | None:
    """Return what the server knew of the camera before the first tick of a record, as far as that tells.

    That is what it knew after that tick, unless it learnt that in it: where a record begins with the server.
    """
    return first.belief if first.number > 0 or first.kept else None


def replay(
    ticks: Iterable[RecordedTick],
    pipeline: TickSource,
    senses: Mapping[str, RecordedSenses],
    *,
    progress: Callable[[], object],
) -> Comparison:
    """Make every tick again.

    Args:
        ticks: In their order.
        pipeline: Put together as the one that made them, fresh.
        senses: What it listens to, by robot.
        progress: Is called after every tick.
    """
    comparison = Comparison()
    for tick in ticks:
        for robot, sense in senses.items():
            sense.give(heard for name, heard in tick.heard if name == robot)
        try:
            result = pipeline.step(tick.frame, tick.document.goals)
        except Exception:  # as in life, the next tick may work
            result = None
        _compare(comparison, tick, result)
        progress()
    return comparison


def _compare(comparison: Comparison, tick: RecordedTick, result: TickResult | None) -> None:
    then = tick.document
    comparison.ticks += 1
    comparison.originals += then.original_picture
    comparison.missing += tick.missing
    comparison.failed_then += then.failed
    comparison.failed_now += result is None
    now_m = {plan.robot: plan.waypoints_m for plan in result.plans} if result is not None else {}
    routes = result.site.routes if result is not None and result.site is not None else {}
    for robot in then.goals:
        reason = routes[robot].reason if robot in routes else None
        comparison.robots.setdefault(robot, RobotComparison()).add(
            then.plans_m.get(robot), now_m.get(robot), same_reason=reason == then.reasons.get(robot)
        )
