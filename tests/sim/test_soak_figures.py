"""The arithmetic of a soak's tables, and what it makes of them."""

from __future__ import annotations

import os
from typing import Any

import pytest

from revnm_sim.soak.faults import FaultTiming
from revnm_sim.soak.figures import (
    Latencies,
    broken_bars,
    counts,
    fault_rows,
    growth_percent,
    missed_goal_row,
    process_row,
    verdict_of,
)
from revnm_sim.soak.goals import Goal
from revnm_sim.soak.operator import Drive

GOAL = Goal((1.0, 2.0), (320.0, 240.0), 3.0, 54.0)


def row(*, server_mb: float = 400.0, threads: int = 20, reached: int = 2, missed: int = 0) -> dict[str, Any]:
    return {
        "contacts": 0,
        "reached": reached,
        "missed": missed,
        "faults": 3,
        "restarts": 1,
        "server_mb": server_mb,
        "server_threads": threads,
        "robot_mb": 60.0,
        "robot_threads": 7,
    }


def timing(kind: str, stood_s: float | None, recovered_s: float | None, *, takes_plan: bool = True) -> FaultTiming:
    return FaultTiming(kind, takes_plan, kind.endswith("killed"), stood_s, recovered_s)


def test_growth_is_of_the_last_third_against_the_first_after_warm_up() -> None:
    # Two of eleven are warm-up; of the nine that are left the medians are 200 and 210.
    values = [100.0, 150.0, 200.0, 201.0, 199.0, 200.0, 200.0, 200.0, 210.0, 210.0, 250.0]
    assert growth_percent(values) == 5.0
    assert growth_percent(values[:9]) is None


def test_a_kind_of_fault_tells_its_slowest() -> None:
    rows = fault_rows(
        [
            timing("b", 0.4, 1.0),
            timing("b", 0.6, None),
            timing("b", None, 2.0),
            timing("a", 5.0, 0.5, takes_plan=False),
        ]
    )
    assert [r["fault"] for r in rows] == ["a", "b"]
    assert rows[0]["slowest_standstill_s"] is None
    assert rows[1] == {
        "fault": "b",
        "count": 3,
        "while_driving": 2,
        "slowest_standstill_s": 0.6,
        "slowest_recovery_s": 2.0,
        "not_recovered": 1,
    }


def test_goals_faults_and_restarts_are_counted() -> None:
    drives = [Drive(GOAL, True, (1.0, 2.0), ""), Drive(GOAL, False, (0.0, 0.0), "waiting: camera stale")]
    timings = [timing("server_killed", 0.5, 4.0), timing("scan_silent", 0.5, 1.0)]
    assert counts(drives, timings) == {"reached": 1, "missed": 1, "faults": 2, "restarts": 1}
    missed = missed_goal_row(drives[1])
    assert (missed["off_m"], missed["reason"]) == (2.24, "waiting: camera stale")  # √5


def test_latencies_are_medians_of_what_was_shown_and_none_where_nothing_was() -> None:
    latencies = Latencies()
    for tick, trip in ((20.0, 1.0), (30.0, None), (40.0, 3.0)):
        robot = {
            "picture_to_plan_ms": None,
            "round_trip_ms": trip,
            "robot_state": {"tick_p50_ms": 5.0, "tick_p95_ms": None},
        }
        latencies.add({"timings_ms": {"tick": {"p50": tick, "p95": 2.0 * tick}}, "robots": [robot]})
    taken = latencies.take()
    assert (taken["tick_p50_ms"], taken["tick_p95_ms"]) == (30.0, 60.0)
    assert (taken["robot_tick_p50_ms"], taken["robot_tick_p95_ms"]) == (5.0, None)
    assert taken["picture_to_plan_p50_ms"] is None
    assert (taken["round_trip_p50_ms"], taken["round_trip_p95_ms"]) == (2.0, 2.9)
    assert set(latencies.take().values()) == {None}


def test_latencies_bear_a_robot_that_has_said_nothing() -> None:
    latencies = Latencies()
    robot = {"picture_to_plan_ms": None, "round_trip_ms": None, "robot_state": None}
    latencies.add({"timings_ms": {}, "robots": [robot]})
    assert set(latencies.take().values()) == {None}


def test_a_process_tells_its_memory_and_threads() -> None:
    own = process_row("server", os.getpid())
    assert own["server_mb"] > 10.0
    assert own["server_threads"] >= 1


def test_growth_and_threads_are_of_the_rows_in_which_processes_live_on() -> None:
    rows = [row(server_mb=300.0, threads=50)] * 4 + [row(server_mb=400.0)] * 11 + [row(server_mb=408.0, threads=21)] * 4
    verdict = verdict_of(rows, fault_rows([timing("a", 0.5, 3.0)]), ready_s=4.321, undisturbed=15)
    assert verdict["ready_s"] == 4.32
    assert (verdict["reached"], verdict["reached_percent"], verdict["restarts"]) == (38, 100.0, 19)
    assert verdict["server_growth_percent"] == 2.0
    assert (verdict["server_threads_first"], verdict["server_threads_most"]) == (20, 21)
    assert (verdict["slowest_standstill_s"], verdict["slowest_recovery_s"]) == (0.5, 3.0)
    assert broken_bars(verdict) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"reached_percent": 94.9}, "goals reached: 94.9 %, expected 95"),
        ({"reached_percent": None}, "goals reached: None %"),
        ({"contacts": 1}, "contacts: 1"),
        ({"slowest_standstill_s": 0.71}, "slowest standstill: 0.71 s, expected 0.7 s"),
        ({"not_recovered": 2}, "faults without recovery in 30 s: 2"),
        ({"server_growth_percent": 5.1}, "memory of the server: 5.1 % more"),
        ({"robot_growth_percent": 5.1}, "memory of the robot: 5.1 % more"),
    ],
)
def test_each_bar_that_does_not_hold_is_told(change: dict[str, float | None], said: str) -> None:
    verdict = verdict_of([row()] * 12, fault_rows([timing("a", 0.7, 3.0)]), ready_s=4.0, undisturbed=12)
    assert broken_bars(verdict) == []
    assert [text for text in broken_bars(verdict | change) if said in text]


def test_a_soak_without_a_finished_goal_shows_nothing() -> None:
    verdict = verdict_of([row(reached=0)] * 12, [], ready_s=4.0, undisturbed=9)
    assert broken_bars(verdict) == ["goals reached: None %, expected 95 % or more"]
