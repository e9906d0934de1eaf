"""Faults while the robot drives: does it stand in time, touch nothing, and go on by itself where that is allowed?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from revnm_client.messages import STANDSTILL
from revnm_sim.bench.protocol import trial_seed
from revnm_sim.bench.suites.courses import draw_course
from revnm_sim.bench.suites.drive import Drive
from revnm_sim.bench.suites.faults import FAULTS, Fault
from revnm_sim.bench.suites.suite import Suite
from revnm_sim.bench.trial import CONTROL_S, TIME_LIMIT_S

GRACE_S = 0.5  # beyond the rule's limit
_BEGIN_SHARE = (0.1, 0.7)  # of the way
_DRIVES_MPS = 0.1


@dataclass(frozen=True, slots=True)
class FaultKey:
    """Which run: equal keys give equal results.

    Attributes:
        fault: Name of the fault.
        seed: Of the benchmark.
        number: Of the run; faults share the random scenes of the numbers.
    """

    fault: str
    seed: int
    number: int


@dataclass(frozen=True, slots=True)
class FaultResult:
    """What came of a run.

    Attributes:
        contact: The body touched something, at any time.
        began_s: Simulated time at which the fault began; None if the robot never got so far.
        hold_s: How long it lasted.
        stop_s: From its beginning until standstill was commanded and remained so until its end; None if the robot was
            driving at its end.
        drove_again: The robot had stood, and drove after the fault's end.
        arrived: Within 0.25 m of the goal in 60 s of driving, untouched.
        duration_s: Simulated time until the run ended.
        reason: Why the robot stood at the end of the fault; None if it drove.
    """

    contact: bool
    began_s: float | None
    hold_s: float
    stop_s: float | None
    drove_again: bool
    arrived: bool
    duration_s: float
    reason: str | None


def fault_keys(*, runs: int, seed: int) -> list[FaultKey]:
    """Return so many runs with each fault."""
    return [FaultKey(name, seed, number) for name in FAULTS for number in range(runs)]


@threadpool_limits.wrap(limits=1, user_api="blas")
def run_fault(key: FaultKey) -> FaultResult:
    """Drive in a random scene, with the fault at some moment of driving.

    Raises:
        ContractError: The scene could not be drawn.
    """
    rng = np.random.default_rng([key.seed, key.number, list(FAULTS).index(key.fault)])
    fault = FAULTS[key.fault](rng)
    course = draw_course("random", seed=key.seed, number=key.number)
    seed = trial_seed(key.seed, pair=key.number, camera=0, repeat=0)
    with Drive(course, seed=seed, wires=fault) as drive:
        run = FaultRun(drive, fault)
        began_s = run.until_fault(rng.uniform(*_BEGIN_SHARE) * drive.way_m)
        stop_s, reason = (None, None) if began_s is None else run.through_fault()
        drove = fault.heals and began_s is not None and run.after_fault()
        touched = drive.simulation.had_contact
        return FaultResult(
            contact=touched,
            began_s=began_s,
            hold_s=round(fault.hold_s, 3),
            stop_s=stop_s,
            drove_again=drove and stop_s is not None,
            arrived=drive.at_goal and not touched,
            duration_s=round(drive.time_s, 3),
            reason=reason,
        )


class FaultRun:
    """The three parts of a run."""

    def __init__(self, drive: Drive, fault: Fault) -> None:
        self._drive, self._fault = drive, fault

    def until_fault(self, begin_m: float) -> float | None:
        """Drive so far and until the robot is moving; return the time, seconds, or None if it never is."""
        drive = self._drive
        while not drive.ended and drive.time_s < TIME_LIMIT_S:
            moving = drive.step().velocity.v_mps > _DRIVES_MPS
            if moving and drive.simulation.path_m >= begin_m:
                return round(drive.time_s, 3)
        return None

    def through_fault(self) -> tuple[float | None, str | None]:
        """Let the fault pass; return after how long the robot stood to its end, seconds, and why it stood then."""
        drive, end_s = self._drive, self._drive.time_s + self._fault.hold_s
        self._fault.begin()
        ticks = [drive.step()]
        while drive.time_s < end_s and not drive.ended:
            ticks.append(drive.step())
        self._fault.end()
        return standing_after_s([tick.velocity == STANDSTILL for tick in ticks]), ticks[-1].reason

    def after_fault(self) -> bool:
        """Drive to the goal or the end of time; return whether the robot drove at all."""
        drive, drove = self._drive, False
        end_s = TIME_LIMIT_S + self._fault.hold_s
        while not drive.ended and drive.time_s < end_s:
            drove |= drive.step().velocity != STANDSTILL
        return drove


def standing_after_s(standing: Sequence[bool]) -> float | None:
    """Return the time from the first tick until the robot stands for the rest of them; None if it never does."""
    moving = [tick for tick, stands in enumerate(standing) if not stands]
    first = moving[-1] + 1 if moving else 0
    return round(first * CONTROL_S, 3) if first < len(standing) else None


def fault_rows(results: Mapping[FaultKey, FaultResult]) -> list[dict[str, Any]]:
    """Return a row for each fault."""
    by_fault: dict[str, list[FaultResult]] = {}
    for key, result in results.items():
        by_fault.setdefault(key.fault, []).append(result)
    return [_row(name, found) for name, found in by_fault.items()]


def fault_bar(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return in words whether the bar is met, and by which faults it is not."""
    missed = [row["fault"] for row in rows if not row["bar_met"]]
    return (
        f"bar: 0 contacts, standing {GRACE_S} s after the rule's limit at the latest, and arriving by itself where the "
        f"fault ends: {'missed: ' + ', '.join(missed) if missed else 'met'}"
    )


def fault_note(key: FaultKey, result: FaultResult) -> str:
    """Return what went wrong in a run, empty if nothing did."""
    fault = FAULTS[key.fault]
    wrong = {
        "contact": result.contact,
        "the fault never began": result.began_s is None,
        "did not stand in time": result.began_s is not None and not _in_time(fault.limit_s, result),
        "did not arrive": fault.heals and not result.arrived,
    }
    found = ", ".join(what for what, is_so in wrong.items() if is_so)
    if not found:
        return ""
    return (
        f"{key.fault} {key.number}: {found}: from {result.began_s} s for {result.hold_s} s, stood after "
        f"{result.stop_s} s ({result.reason or 'driving'}), ended at {result.duration_s} s"
    )


def _in_time(limit_s: float | None, result: FaultResult) -> bool:
    return limit_s is None or (result.stop_s is not None and result.stop_s <= limit_s + GRACE_S)


def _row(name: str, results: Sequence[FaultResult]) -> dict[str, Any]:
    fault, runs = FAULTS[name], len(results)
    stops = [result.stop_s for result in results if result.stop_s is not None]
    judged = fault.limit_s is not None
    contacts, arrivals = sum(r.contact for r in results), sum(r.arrived for r in results)
    in_time = sum(_in_time(fault.limit_s, result) for result in results)
    return {
        "fault": name,
        "runs": runs,
        "contacts": contacts,
        "stop_p95_s": round(float(np.percentile(stops, 95)), 3) if judged and stops else None,
        "latest_stop_s": max(stops) if judged and stops else None,
        "limit_s": fault.limit_s,
        "stood_in_time": in_time if judged else None,
        "recovered": sum(r.drove_again for r in results) if judged and fault.heals else None,
        "arrivals": arrivals if fault.heals else None,
        "bar_met": contacts == 0 and in_time == runs and (arrivals == runs or not fault.heals),
    }


FAULT_SUITE = Suite("faults", FaultKey, FaultResult, run_fault, fault_rows, fault_bar, fault_note)
