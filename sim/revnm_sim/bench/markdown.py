"""``report.md``: the benchmark's figures for people, with the paper's beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from revnm_sim.bench.paper import DIFFERENCES, METHOD_NOTES, PAPER
from revnm_sim.bench.report import table

Row = Mapping[str, Any]


def summary(rows: Sequence[Row]) -> str:
    """Return the rows as a Markdown table that fits a terminal."""
    return table([_short(row) for row in rows])


def markdown(rows: Sequence[Row], comparisons: Sequence[Row], figures: Sequence[str], command: str) -> str:
    """Return the whole report.

    Args:
        rows: As of :func:`revnm_sim.bench.metrics.rows`.
        comparisons: As of :func:`revnm_sim.bench.metrics.comparisons`.
        figures: Names of picture files in the report's folder.
        command: The command line that made it.
    """
    first = rows[0]["method"]
    against = [row for row in comparisons if row["method"] == first]
    parts = ["# Benchmark", f"```sh\n{command}\n```", *_success(rows), *_reading(rows)]
    if against:
        parts += [f"## Against `{first}`, trial by trial", table([_difference(row) for row in against]), _PAIRED]
    if figures:
        parts += ["## Pictures", _PICTURES, *(f"![{name}]({name})" for name in figures)]
    return "\n\n".join(parts) + "\n"


def _success(rows: Sequence[Row]) -> list[str]:
    """Return a table for every world."""
    parts = []
    for world in dict.fromkeys(row["world"] for row in rows):
        mine = [row for row in rows if row["world"] == world]
        paper = any((world, row["method"]) in PAPER for row in mine)
        parts += [f"## {world}", table([{**_short(row), **(_paper(row) if paper else {})} for row in mine])]
        parts.append(f"The straight way is blocked in {mine[0]['blocked_rate']:.0%} of these trials. {_ROUNDS}")
    return parts


def _short(row: Row) -> dict[str, Any]:
    return {
        "world": row["world"],
        "method": row["method"],
        "perception": row["perception"],
        "trials": row["trials"],
        "SR [95 %]": _interval(row, "success_rate", "success"),
        "by pair": _bounds(row, "success_by_pair"),
        "SPL [95 %]": _interval(row, "spl", "spl"),
        "SPL geodesic": f"{row['spl_geodesic']:.2f}",
        "hidden": _hidden(row),
        "collisions": f"{row['collision_rate']:.1%}",
        "timeouts": f"{row['timeout_rate']:.1%}",
        "clearance m": f"{row['median_clearance_m']:.2f}",
        "time s": row["mean_success_s"],
        "tick ms": f"{row['p50_tick_ms']:.1f}",
    }


def _hidden(row: Row) -> str:
    if not row["hidden_trials"]:
        return ""
    return f"{row['hidden_success_rate']:.2f} / {row['hidden_spl']:.2f} of {row['hidden_trials']}"


def _paper(row: Row) -> dict[str, Any]:
    return {"paper SR / SPL": PAPER.get((row["world"], row["method"]), "")}


def _difference(row: Row) -> dict[str, Any]:
    return {
        "world": row["world"],
        "perception": row["perception"],
        "method": row["method"],
        "other": row["other"],
        "trials": row["trials"],
        "only method": row["only_method"],
        "only other": row["only_other"],
        "ΔSR [95 %]": _interval(row, "difference", "difference", sign="+"),
        "by pair": _bounds(row, "difference_by_pair", sign="+"),
        "McNemar p": row["mcnemar_p"],
        "ΔSR hidden": "" if row["hidden_difference"] is None else f"{row['hidden_difference']:+.2f}",
    }


def _interval(row: Row, value: str, name: str, *, sign: str = "") -> str:
    return f"{row[value]:{sign}.2f} {_bounds(row, name, sign=sign)}"


def _bounds(row: Row, name: str, *, sign: str = "") -> str:
    return f"[{row[f'{name}_low']:{sign}.2f}, {row[f'{name}_high']:{sign}.2f}]"


def _reading(rows: Sequence[Row]) -> list[str]:
    methods = dict.fromkeys(row["method"] for row in rows)
    notes = [f"- `{method}`: {METHOD_NOTES[method]}." for method in methods if method in METHOD_NOTES]
    paper = [f"**Beside the paper.** {DIFFERENCES}"] if any((r["world"], r["method"]) in PAPER for r in rows) else []
    return ["## How to read it", "\n".join(notes), _PROTOCOL, *paper]


_ROUNDS = "The controller rounds some things by itself, so even `straight` arrives at times."
_PROTOCOL = (
    "A trial succeeds within the goal's radius (0.5 m; 1.0 m in the warehouse; a world file may have its own) in 60 s "
    "and without contact of the robot's rectangle; SR is the rate of it. All methods share the robot's controller and "
    "safety, and meet the same trials. The robot's pose in the picture is the simulator's; hidden, it keeps the last "
    "one. SPL, success weighted by path length, refers to the planner's way, which ends at the goal while a trial "
    "ends at its radius; `SPL geodesic` to the shortest way. `hidden` has SR and SPL of the trials with 1 m or more of "
    "the planner's way on floor that the camera does not see. Clearance is the median over the trials of the least "
    "distance to anything; time is that of the trials that succeeded; tick is the median time of making a plan, the "
    "simulator's stand-ins for tag detector and exact depth included, on a machine that may have had other work. "
    "Intervals are 95 % cluster bootstraps over pair and camera, and `by pair` over pairs alone: the cameras of one "
    "pair share its way, so those are wider, and for methods that do not look through the camera they are the right "
    "ones. Where all trials ended alike they are Clopper and Pearson's."
)
_PAIRED = (
    "`only method`: trials in which just the first of the two succeeded. The intervals are cluster bootstraps of the "
    "paired difference; p is McNemar's, exact, but counts the cameras of a pair as independent: it is too small."
)
_PICTURES = (
    "Trajectories: of each world the trial in which the methods' outcomes differ most, over the camera's view and from "
    "the top. S and G are start and goal, a cross marks where a run failed, the triangle is the camera. Ego depth: "
    "poses on the planner's way of each world's first trial, with the exo depth around them (the circle is the robot), "
    "what exo2ego imagines from it, and the truth; near is bright."
)
