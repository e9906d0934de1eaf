"""The table at the end of a headless demo."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from revnm_sim.physics import CLEARANCE_LIMIT_M


@dataclass(frozen=True, slots=True)
class DriveSummary:
    """How a drive went.

    Attributes:
        arrived: Whether the server said so in time.
        duration_s: From the goal to the arrival or the end of the time.
        path_m: Length of the path driven.
        goal_error_m: True distance to the goal at the end.
        closest_m: Least distance between body and obstacles; at most ``CLEARANCE_LIMIT_M``.
        contact: Whether the body touched an obstacle.
        stages_ms: 50th and 95th percentile by stage of the server's tick.
        robot_tick_ms: The same of the robot's tick; None where unknown.
    """

    arrived: bool
    duration_s: float
    path_m: float
    goal_error_m: float
    closest_m: float
    contact: bool
    stages_ms: Mapping[str, tuple[float, float]]
    robot_tick_ms: tuple[float | None, float | None]


def format_summary(summary: DriveSummary) -> str:
    """Return the summary as a small table."""
    far = summary.closest_m >= CLEARANCE_LIMIT_M
    rows = [
        ("arrived", "yes" if summary.arrived else "no"),
        ("contact", "yes" if summary.contact else "no"),
        ("time", f"{summary.duration_s:.1f} s"),
        ("path length", f"{summary.path_m:.2f} m"),
        ("distance to goal", f"{summary.goal_error_m:.2f} m"),
        ("closest obstacle", f"{'over ' if far else ''}{summary.closest_m:.2f} m"),
    ]
    lines = [f"{name:<18}{value:>10}" for name, value in rows]
    lines += ["", f"{'tick, ms':<18}{'p50':>8}{'p95':>8}"]
    timed = {f"server {stage}": each for stage, each in summary.stages_ms.items()}
    for name, (p50, p95) in {**timed, "robot tick": summary.robot_tick_ms}.items():
        lines.append(f"{name:<18}{_number(p50)}{_number(p95)}")
    return "\n".join(lines)


def _number(value_ms: float | None) -> str:
    return f"{'–':>8}" if value_ms is None else f"{value_ms:>8.1f}"
