"""A drive as lines of characters: scan and plan around the robot, its front up, and its state above. Pure.

Plain ASCII only, so that it looks the same on a serial console.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_client.json_payload import Scalar

_REACH_M = 3.0  # from the robot to the upper edge
_SILENT_S = 2.0
_LEGEND = "# LiDAR   o plan   ^ robot, its front up"


class Size(NamedTuple):
    """Of a terminal, in characters."""

    columns: int
    lines: int


@dataclass(frozen=True, slots=True)
class View:
    """What is drawn.

    Attributes:
        robot: Its name.
        points_m: (M, 2) hits of the newest scan, robot frame; None where none is fresh.
        path_m: (P, 2) the plan, robot frame at that scan; None where none is fresh.
        state: The state that the robot's client told last; None before the first.
        state_age_s: Since that came.
    """

    robot: str
    points_m: FloatArray | None = None
    path_m: FloatArray | None = None
    state: Mapping[str, Scalar] | None = None
    state_age_s: float = math.inf


def draw(view: View, size: Size) -> list[str]:
    """Return the lines, as many as the terminal has, none longer than it is wide."""
    head = [_headline(view), *_figures(view)]
    rows = size.lines - len(head) - 1
    lines = [*head, *_map(view, Size(size.columns, rows)), _foot(rows)] if rows >= 1 else head
    return ["".join(c if " " <= c <= "~" else "?" for c in line)[: size.columns] for line in lines[: size.lines]]


def _headline(view: View) -> str:
    state = view.state
    if state is None:
        return f"{view.robot}  its client is not heard yet"
    if view.state_age_s > _SILENT_S:
        return f"{view.robot}  ITS CLIENT IS SILENT for {view.state_age_s:.0f} s"
    speed = f"{_number(state, 'v_mps', '.2f')} m/s {_number(state, 'w_radps', '+.2f')} rad/s"
    if state.get("reason") is None:
        return f"{view.robot}  DRIVES  {speed}  plan {_number(state, 'plan_seq', 'd')} to {state.get('goal_id') or '-'}"
    if state.get("moving"):
        return f"{view.robot}  {state['reason']}  {speed}"
    return f"{view.robot}  STANDS: {state['reason']}"


def _figures(view: View) -> list[str]:
    state = view.state or {}
    ages = " ".join(f"{name} {_number(state, f'{name}_age_ms', '.0f')}" for name in ("plan", "scan", "odometry"))
    clock = f"clock {_number(state, 'clock_offset_ms', '+.1f')} round trip {_number(state, 'round_trip_ms', '.1f')}"
    counts = f"refused {_number(state, 'rejected', 'd')}  malformed {_number(state, 'malformed', 'd')}"
    last = state.get("last_malformed") or state.get("last_refusal")
    return [
        f"ms: {ages}  {clock}  tick p95 {_number(state, 'tick_p95_ms', '.1f')}",
        f"{_nearest(view.points_m)}  stops in {_number(state, 'stopping_m', '.2f')} m  {counts}"
        + (f", last: {last}" if last else ""),
    ]


def _number(state: Mapping[str, Scalar], key: str, form: str) -> str:
    """Return a number of the state; a dash where there is none, or something else."""
    value = state.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "-"
    return format(round(value) if form == "d" else value, form)


def _nearest(points_m: FloatArray | None) -> str:
    if points_m is None:
        return "no scan"
    if not len(points_m):
        return "nothing in reach"
    x, y = points_m[np.argmin(np.hypot(points_m[:, 0], points_m[:, 1]))]
    return f"nearest {math.hypot(x, y):.2f} m at {math.degrees(math.atan2(y, x)):+.0f} deg"


def _row_m(rows: int) -> float:
    return _REACH_M / max(rows // 2, 1)


def _foot(rows: int) -> str:
    return f"{_LEGEND}   row {_row_m(rows):.2f} m   Ctrl-C ends"


def _map(view: View, size: Size) -> list[str]:
    """Return the map: a character is half as wide as it is high."""
    canvas = np.full((size.lines, size.columns), " ")
    if view.path_m is not None:
        _put(canvas, _dense(view.path_m, 0.5 * _row_m(size.lines)), "o")
    if view.points_m is not None:
        _put(canvas, view.points_m, "#")
    _put(canvas, np.zeros((1, 2)), "^")
    return ["".join(row).rstrip() for row in canvas]


def _put(canvas: np.ndarray, points_m: FloatArray, mark: str) -> None:
    """Mark the cells of points (M, 2), robot frame, on a canvas (rows, columns) of characters."""
    rows, columns = canvas.shape
    row = np.rint(rows // 2 - points_m[:, 0] / _row_m(rows))
    column = np.rint(columns // 2 - points_m[:, 1] / (0.5 * _row_m(rows)))
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    canvas[row[inside].astype(int), column[inside].astype(int)] = mark


def _dense(path_m: FloatArray, step_m: float) -> FloatArray:
    """Return points (N, 2) along a path (P, 2), ``step_m`` apart."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path_m, axis=0).T))])
    at = np.arange(0.0, along[-1] + step_m, step_m)
    return np.stack([np.interp(at, along, path_m[:, axis]) for axis in (0, 1)], axis=1)
