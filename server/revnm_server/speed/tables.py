"""What was measured, as rows of a report, and what they mean against the bars."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

STAGES = ("depth", "tag", "map", "exo2ego", "policy", "learn", "tick")
OURS = "onnxruntime"
_NETWORKS = ("depth", "exo2ego", "policy")
_TICK_BAR_MS = {"edge": 30.0, "paper": 250.0}
_ROBOTS_BAR = 4.0  # times one robot, for 16
_FASTER_BAR = 4.0

Row = dict[str, Any]
Timings = Sequence[dict[str, float]]


def stage_rows(preset: str, robots: int, backend: str, timings: Timings) -> list[Row]:
    """Return a row for each stage that ran."""
    return [
        {
            "preset": preset,
            "robots": robots,
            "stage": stage,
            "backend": backend,
            "ticks": len(times),
            "p50_ms": round(float(np.percentile(times, 50.0)), 2),
            "p95_ms": round(float(np.percentile(times, 95.0)), 2),
        }
        for stage in STAGES
        if (times := [each[stage] for each in timings if stage in each])
    ]


def one_after_the_other(networks: Timings, rows: Sequence[Row]) -> list[dict[str, float]]:
    """Add a ``tick`` to what another runtime's networks took: all of it in series, and the rest as in our rows.

    Args:
        networks: Durations of ``depth``, ``exo2ego`` and ``policy``.
        rows: Of the same preset and robots; ``tag`` and ``map`` are those of no network.
    """
    rest_ms = sum(row["p50_ms"] for row in rows if row["stage"] in ("tag", "map"))
    return [{**each, "tick": sum(each.values()) + rest_ms} for each in networks]


def summary(rows: Sequence[Row]) -> list[Row]:
    """Return for each preset and number of robots how fast the tick is, and how often faster than other runtimes."""
    p50 = {(row["preset"], row["robots"], row["backend"], row["stage"]): row["p50_ms"] for row in rows}
    found = []
    for preset, robots in dict.fromkeys((row["preset"], row["robots"]) for row in rows):
        tick = p50[preset, robots, OURS, "tick"]
        one = p50.get((preset, 1, OURS, "tick"))
        found.append(
            {"preset": preset, "robots": robots, "what": "tick p50, ms", "value": tick, **_bar(preset, robots)}
        )
        if one and robots > 1:
            bar = {"bar": f"<= {_ROBOTS_BAR:g}" if robots == 16 else None}
            found.append(
                {"preset": preset, "robots": robots, "what": "x one robot", "value": round(tick / one, 2), **bar}
            )
        for other in sorted({row["backend"] for row in rows} - {OURS}):
            found += _ratios(p50, preset, robots, other)
    return [{**row, "met": _met(row["value"], row["bar"])} for row in found]


def _bar(preset: str, robots: int) -> Row:
    return {"bar": f"<= {_TICK_BAR_MS[preset]:g}" if robots == 1 and preset in _TICK_BAR_MS else None}


def _ratios(p50: dict[tuple[str, int, str, str], float], preset: str, robots: int, other: str) -> list[Row]:
    """Return how many times faster than another runtime whole ticks are, and their networks alone."""
    found = []
    for name, parts in (("tick", ("tick",)), ("networks", _NETWORKS)):
        if any((preset, robots, backend, part) not in p50 for backend in (OURS, other) for part in parts):
            continue
        slow, fast = (sum(p50[preset, robots, backend, part] for part in parts) for backend in (other, OURS))
        bar = f">= {_FASTER_BAR:g}" if name == "networks" else None  # some of a tick runs beside it here, not there
        value = round(slow / fast, 2)
        found.append({"preset": preset, "robots": robots, "what": f"{name}, x {other}", "value": value, "bar": bar})
    return found


def _met(value: float, bar: str | None) -> str:
    if bar is None:
        return ""
    sign, number = bar.split()
    return "yes" if (value <= float(number) if sign == "<=" else value >= float(number)) else "no"
