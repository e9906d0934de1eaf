"""The tables of a soak, and whether its bars hold. Linux only: what a process takes is read from ``/proc``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from revnm_sim.soak.faults import FaultTiming
from revnm_sim.soak.operator import Drive

LEAST_REACHED_PERCENT = 95.0
STANDS_WITHIN_S = 0.7
MOST_GROWTH_PERCENT = 5.0
_WARM_UP = 0.1  # of the rows of processes that live on: caches fill
_GROWTH_ROWS = 10  # fewer are too short a time to tell growth from warming up
_SHOWN = tuple(f"{name}_{p}_ms" for name in ("picture_to_plan", "tick", "robot_tick") for p in ("p50", "p95"))


class Latencies:
    """The latencies that the server has shown since the last row."""

    def __init__(self) -> None:
        self._shown_ms: dict[str, list[float]] = {name: [] for name in (*_SHOWN, "round_trip_ms")}

    def add(self, state: dict[str, Any]) -> None:
        """Take what the document ``/api/v1/state`` tells; what it does not know is left out."""
        robot = state["robots"][0]
        told = robot["robot_state"] or {}
        timings = {"picture_to_plan": robot["picture_to_plan_ms"], "tick": state["timings_ms"].get("tick")}
        found = {f"{name}_{p}_ms": timing[p] for name, timing in timings.items() if timing for p in ("p50", "p95")}
        found |= {f"robot_tick_{p}_ms": told.get(f"tick_{p}_ms") for p in ("p50", "p95")}
        found["round_trip_ms"] = robot["round_trip_ms"]
        for name, shown_ms in found.items():
            if shown_ms is not None:
                self._shown_ms[name].append(shown_ms)

    def take(self) -> dict[str, float | None]:
        """Return the median of each and forget them; of the round trip, both percentiles. None where nothing came."""
        shown, trips = self._shown_ms, self._shown_ms["round_trip_ms"]
        taken = {name: _percentile(shown[name], 50.0) for name in _SHOWN}
        taken |= {f"round_trip_p{percent}_ms": _percentile(trips, percent) for percent in (50, 95)}
        for values in shown.values():
            values.clear()
        return taken


def _percentile(values: Sequence[float], percent: float) -> float | None:
    return round(float(np.percentile(values, percent)), 2) if values else None


def process_row(name: str, pid: int) -> dict[str, float]:
    """Return what a process takes: memory in MB, and its threads."""
    lines = Path(f"/proc/{pid}/status").read_text(encoding="ascii").splitlines()
    taken = dict(line.split(":", 1) for line in lines)
    memory_kib, threads = (int(taken[key].split()[0]) for key in ("VmRSS", "Threads"))
    return {f"{name}_mb": round(memory_kib / 1024.0, 1), f"{name}_threads": threads}


def counts(drives: Sequence[Drive], timings: Sequence[FaultTiming]) -> dict[str, int]:
    """Return how many goals were reached and missed, and how many faults and restarts there were."""
    reached = sum(drive.reached for drive in drives)
    restarts = sum(timing.kills for timing in timings)
    return {"reached": reached, "missed": len(drives) - reached, "faults": len(timings), "restarts": restarts}


def fault_rows(timings: Sequence[FaultTiming]) -> list[dict[str, Any]]:
    """Return a row a kind of fault, in the order of their names."""
    kinds = sorted({timing.kind for timing in timings})
    return [_fault_row(kind, [timing for timing in timings if timing.kind == kind]) for kind in kinds]


def _fault_row(kind: str, timings: Sequence[FaultTiming]) -> dict[str, Any]:
    stood = [t.stood_after_s for t in timings if t.takes_plan and t.stood_after_s is not None]
    recovered = [t.recovered_after_s for t in timings if t.recovered_after_s is not None]
    return {
        "fault": kind,
        "count": len(timings),
        "while_driving": len(stood) if timings[0].takes_plan else None,
        "slowest_standstill_s": round(max(stood), 2) if stood else None,
        "slowest_recovery_s": round(max(recovered), 2) if recovered else None,
        "not_recovered": len(timings) - len(recovered),
    }


def missed_goal_row(drive: Drive) -> dict[str, Any]:
    """Return where a robot should have been, where it was, and why."""
    return {
        "goal_x_m": round(drive.goal.place_m[0], 2),
        "goal_y_m": round(drive.goal.place_m[1], 2),
        "robot_x_m": round(drive.place_m[0], 2),
        "robot_y_m": round(drive.place_m[1], 2),
        "off_m": round(drive.off_m, 2),
        "reason": drive.reason,
    }


def growth_percent(values: Sequence[float]) -> float | None:
    """Compare the medians of the last and the first third, warm-up left out; None where there are too few."""
    if len(values) < _GROWTH_ROWS:
        return None
    warm = values[math.ceil(_WARM_UP * len(values)) :]
    third = len(warm) // 3
    return round(100.0 * float(np.median(warm[-third:]) / np.median(warm[:third]) - 1.0), 2)


def verdict_of(
    rows: Sequence[dict[str, Any]], faults: Sequence[dict[str, Any]], *, ready_s: float, undisturbed: int
) -> dict[str, Any]:
    """Return the row of the whole.

    Args:
        rows: Of the minutes.
        faults: Of the kinds of fault.
        ready_s: After how long the server was ready.
        undisturbed: How many of the last rows are of processes that were not killed any more: of these the growth.
    """
    last = rows[len(rows) - undisturbed :] or rows
    ended = {key: sum(row[key] for row in rows) for key in ("reached", "missed", "contacts", "faults", "restarts")}
    drives = ended["reached"] + ended["missed"]
    return {
        "ready_s": round(ready_s, 2),
        **ended,
        "reached_percent": round(100.0 * ended["reached"] / drives, 1) if drives else None,
        "slowest_standstill_s": _most(faults, "slowest_standstill_s"),
        "slowest_recovery_s": _most(faults, "slowest_recovery_s"),
        "not_recovered": sum(fault["not_recovered"] for fault in faults),
        "server_growth_percent": growth_percent([row["server_mb"] for row in last]),
        "robot_growth_percent": growth_percent([row["robot_mb"] for row in last]),
        "server_threads_first": last[0]["server_threads"],
        "server_threads_most": max(row["server_threads"] for row in last),
        "server_threads_last": last[-1]["server_threads"],
    }


def _most(rows: Sequence[dict[str, Any]], key: str) -> float | None:
    return max((row[key] for row in rows if row[key] is not None), default=None)


def broken_bars(verdict: dict[str, Any]) -> list[str]:
    """Return what does not hold of what a soak must show; what was not measured holds."""
    percent = verdict["reached_percent"]
    bars = [
        (
            percent is not None and percent >= LEAST_REACHED_PERCENT,
            f"goals reached: {percent} %, expected 95 % or more",
        ),
        (verdict["contacts"] == 0, f"contacts: {verdict['contacts']}, expected none"),
        (verdict["not_recovered"] == 0, f"faults without recovery in 30 s: {verdict['not_recovered']}, expected none"),
        (
            (verdict["slowest_standstill_s"] or 0.0) <= STANDS_WITHIN_S,
            f"slowest standstill: {verdict['slowest_standstill_s']} s, expected {STANDS_WITHIN_S} s or less",
        ),
    ]
    for name in ("server", "robot"):
        growth = verdict[f"{name}_growth_percent"]
        text = f"memory of the {name}: {growth} % more, expected {MOST_GROWTH_PERCENT} % or less"
        bars.append(((growth or 0.0) <= MOST_GROWTH_PERCENT, text))
    return [text for holds, text in bars if not holds]
