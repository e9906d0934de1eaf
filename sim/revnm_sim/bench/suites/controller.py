"""The controller's courses: does the robot arrive without touching anything, how fast, and how smoothly?"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from revnm_client.geometry import FloatArray
from revnm_client.messages import Velocity
from revnm_sim.bench.protocol import trial_seed
from revnm_sim.bench.suites.courses import COURSES, draw_course
from revnm_sim.bench.suites.drive import Drive, Wires
from revnm_sim.bench.suites.suite import Suite
from revnm_sim.bench.trial import CONTROL_S, TIME_LIMIT_S

LEAST_ARRIVALS = 0.97
SCENES_PER_REPEAT = 10  # so many random scenes for one repetition of each other course
_STANDS_MPS = 0.02
_STANDS_RADPS = 0.02
_STANDS_S = 0.5


@dataclass(frozen=True, slots=True)
class CourseKey:
    """Which trial: equal keys give equal results, computing times apart.

    Attributes:
        course: Name of the course.
        seed: Of the benchmark.
        number: Of the course among those of its name.
    """

    course: str
    seed: int
    number: int


@dataclass(frozen=True, slots=True)
class CourseResult:
    """What came of a trial.

    Attributes:
        arrived: Within 0.25 m of the goal in 60 s, untouched.
        contact: The body touched something, or was touched while it drove or had stood for less than 0.5 s.
        hit_while_standing: It was touched when it had stood for 0.5 s or more.
        duration_s: Simulated time until it ended.
        path_m: Driven.
        way_m: Length of the expert's way.
        closest_m: Least clearance of the body.
        dv_mps2: Mean size of the change of the commanded speed.
        dw_radps2: The same of the turning rate.
        tick_p50_ms: Median time of the robot's tick while it drove.
        end_m: Where the robot was at the end, (x, y, yaw), metres and radians.
        reason: Why the robot stood at the end; None if it drove.
    """

    arrived: bool
    contact: bool
    hit_while_standing: bool
    duration_s: float
    path_m: float
    way_m: float
    closest_m: float
    dv_mps2: float
    dw_radps2: float
    tick_p50_ms: float
    end_m: list[float]
    reason: str | None


def course_keys(*, scenes: int, seed: int) -> list[CourseKey]:
    """Return the trials of so many random scenes, and of a tenth as many of each other course, but one at least."""
    repeats = max(1, scenes // SCENES_PER_REPEAT)
    counts = {name: scenes if name == "random" else repeats for name in COURSES}
    return [CourseKey(name, seed, number) for name, count in counts.items() for number in range(count)]


@threadpool_limits.wrap(limits=1, user_api="blas")
def run_course(key: CourseKey) -> CourseResult:
    """Drive a course to its end.

    Raises:
        ContractError: It could not be drawn.
    """
    course = draw_course(key.course, seed=key.seed, number=key.number)
    seed = trial_seed(key.seed, pair=key.number, camera=0, repeat=0)
    with Drive(course, seed=seed, wires=Wires()) as drive:
        commands: list[Velocity] = []
        tick_ms: list[float] = []
        standing_s = 0.0
        while not drive.ended and drive.time_s < TIME_LIMIT_S:
            before = drive.simulation.true_pose
            tick = drive.step()
            after = drive.simulation.true_pose
            standing = _stands(math.dist(before[:2], after[:2]), math.remainder(after[2] - before[2], math.tau))
            if standing or not drive.simulation.had_contact:  # a push is no driving
                standing_s = standing_s + CONTROL_S if standing else 0.0
            commands.append(tick.velocity)
            if tick.mppi_ms:
                tick_ms.append(tick.mppi_ms)
        simulation, touched = drive.simulation, drive.simulation.had_contact
        dv_mps2, dw_radps2 = roughness(commands)
        return CourseResult(
            arrived=drive.at_goal and not touched,
            contact=touched and standing_s < _STANDS_S,
            hit_while_standing=touched and standing_s >= _STANDS_S,
            duration_s=round(drive.time_s, 3),
            path_m=round(simulation.path_m, 4),
            way_m=round(drive.way_m, 4),
            closest_m=round(simulation.closest_m, 4),
            dv_mps2=round(dv_mps2, 4),
            dw_radps2=round(dw_radps2, 4),
            tick_p50_ms=round(float(np.median(tick_ms)), 3) if tick_ms else 0.0,
            end_m=[round(value, 3) for value in simulation.true_pose],
            reason=tick.reason,
        )


def roughness(commands: Sequence[Velocity]) -> tuple[float, float]:
    """Return the mean size of the changes from command to command, m/s² and rad/s²; the first starts from standing."""
    values: FloatArray = np.array([(0.0, 0.0), *((c.v_mps, c.w_radps) for c in commands)])
    speed, turn = np.abs(np.diff(values, axis=0)).mean(axis=0) / CONTROL_S
    return float(speed), float(turn)


def course_rows(results: Mapping[CourseKey, CourseResult]) -> list[dict[str, Any]]:
    """Return a row for each course, and one for all of them together."""
    by_course: dict[str, list[CourseResult]] = {}
    for key, result in results.items():
        by_course.setdefault(key.course, []).append(result)
    rows = [_row(course, found) for course, found in by_course.items()]
    return [*rows, _row("all", list(results.values()))]


def course_bar(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return in words whether the bar is met."""
    total = rows[-1]
    contacts, rate = total["contacts"], total["arrival_rate"]
    met = contacts == 0 and rate >= LEAST_ARRIVALS
    return (
        f"bar: 0 contacts and at least {LEAST_ARRIVALS:.0%} arrivals: {'met' if met else 'missed'} "
        f"({contacts} contacts, {rate:.1%} arrivals)"
    )


def course_note(key: CourseKey, result: CourseResult) -> str:
    """Return what went wrong in a trial, empty if nothing did."""
    if result.arrived:
        return ""
    what = "contact" if result.contact else "hit while standing" if result.hit_while_standing else "late"
    x, y, yaw = result.end_m
    return (
        f"{key.course} {key.number}: {what} after {result.duration_s:.1f} s and {result.path_m:.2f} m at "
        f"({x:.2f}, {y:.2f}) m, {yaw:.2f} rad: {result.reason or 'driving'}"
    )


def _row(course: str, results: Sequence[CourseResult]) -> dict[str, Any]:
    arrived = [result for result in results if result.arrived]
    return {
        "course": course,
        "trials": len(results),
        "contacts": sum(result.contact for result in results),
        "hit_while_standing": sum(result.hit_while_standing for result in results),
        "arrivals": len(arrived),
        "arrival_rate": round(len(arrived) / len(results), 4),
        "mean_speed_mps": round(sum(r.path_m for r in results) / sum(r.duration_s for r in results), 3),
        "mean_dv_mps2": round(float(np.mean([result.dv_mps2 for result in results])), 3),
        "mean_dw_radps2": round(float(np.mean([result.dw_radps2 for result in results])), 3),
        "least_clearance_m": min(result.closest_m for result in results),
        "p50_time_s": round(float(np.median([r.duration_s for r in arrived])), 2) if arrived else None,
        "p50_mppi_ms": round(float(np.median([result.tick_p50_ms for result in results])), 2),
    }


def _stands(moved_m: float, turned_rad: float) -> bool:
    return moved_m <= _STANDS_MPS * CONTROL_S and abs(turned_rad) <= _STANDS_RADPS * CONTROL_S


CONTROLLER = Suite("controller", CourseKey, CourseResult, run_course, course_rows, course_bar, course_note)
