"""Faults while driving: each fault by hand, rows by hand, and a run whose robot stands in time and goes on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Odometry, Plan, Scan
from revnm_sim.bench.suites.fault_suite import (
    FaultKey,
    FaultResult,
    fault_bar,
    fault_keys,
    fault_note,
    fault_rows,
    run_fault,
    standing_after_s,
)
from revnm_sim.bench.suites.faults import (
    FAULTS,
    ClockStep,
    LidarSilent,
    LidarStuck,
    OdometryJump,
    PlanFlood,
    RouterFrozen,
    ServerKilled,
)

STOOD = FaultResult(
    contact=False,
    began_s=5.0,
    hold_s=3.0,
    stop_s=0.3,
    drove_again=True,
    arrived=True,
    duration_s=25.0,
    reason="scan is 3.0 s old",
)


def plan(seq: int) -> Plan:
    return Plan(seq * 200_000_000, np.array([[1.0, 0.0]]), epoch=1, seq=seq, goal_id="goal")


def scan(stamp_ns: int, range_m: float) -> Scan:
    return Scan(stamp_ns, -math.pi, math.pi / 2.0, 0.05, 12.0, np.full(4, range_m, dtype=np.float32))


def odometry(stamp_s: float, x_m: float) -> Odometry:
    return Odometry(round(stamp_s * 1e9), Pose2(x_m, 0.0, 0.0), STANDSTILL)


# Each fault.


def test_a_killed_server_says_nothing_more() -> None:
    fault = ServerKilled(np.random.default_rng(0))
    assert [got.seq for got in fault.plans([plan(1)])] == [1]
    fault.begin()
    assert fault.plans([plan(2)]) == []
    assert not fault.heals


def test_a_frozen_router_gives_what_waited_at_once_or_drops_it() -> None:
    after = []
    for seed in range(10):
        fault = RouterFrozen(np.random.default_rng(seed))
        fault.begin()
        assert fault.plans([plan(1)]) == fault.plans([plan(2)]) == []
        fault.end()
        after.append([got.seq for got in fault.plans([plan(3)])])
        assert [got.seq for got in fault.plans([plan(4)])] == [4]
    assert sorted(map(tuple, set(map(tuple, after)))) == [(1, 2, 3), (3,)]


def test_a_silent_lidar_and_a_stuck_one() -> None:
    silent, stuck = LidarSilent(np.random.default_rng(0)), LidarStuck(np.random.default_rng(0))
    for fault in (silent, stuck):
        assert fault.scan(scan(1, 2.0)) is not None
        fault.begin()
    assert silent.scan(scan(2, 1.0)) is None
    repeated = stuck.scan(scan(2, 1.0))
    assert repeated.stamp_ns == 2
    assert repeated.ranges_m.tolist() == [2.0] * 4
    stuck.end()
    assert stuck.scan(scan(3, 0.5)).ranges_m.tolist() == [0.5] * 4


def test_odometry_jumps_by_metres_for_good_or_lags_for_a_while() -> None:
    kinds = set()
    for seed in range(12):
        fault = OdometryJump(np.random.default_rng(seed))
        assert fault.odometry(odometry(1.0, 2.0)) == odometry(1.0, 2.0)
        fault.begin()
        first, then = fault.odometry(odometry(1.05, 2.0)), fault.odometry(odometry(1.1, 2.3))
        during = fault.plans([plan(1)])
        fault.end()
        assert [got.seq for got in (*during, *fault.plans([plan(2)]))] == [1, 2]  # none is lost
        after = fault.odometry(odometry(1.15, 2.3))
        if first.stamp_ns != 1_050_000_000:
            kinds.add("lag")
            assert during
            assert 0.5e9 <= 1_050_000_000 - first.stamp_ns <= 3.0e9
            assert after == odometry(1.15, 2.3)
            continue
        kinds.add("jump")
        assert not during
        a, b = first.odom_from_robot, then.odom_from_robot
        assert 1.0 <= math.dist(a[:2], (2.0, 0.0)) <= 5.0
        assert a.inverse() @ b == pytest.approx(Pose2(0.3, 0.0, 0.0), abs=1e-9)  # what it drives is right
        assert after.odom_from_robot == b
        assert fault.hold_s == 0.0
    assert kinds == {"lag", "jump"}


def test_a_flood_is_of_new_numbers_and_old_plans_and_numbers_go_on_after_it() -> None:
    fault = PlanFlood(np.random.default_rng(0))
    before = [fault.plans([plan(seq)])[0].seq for seq in range(1, 6)]
    assert before == [1, 2, 3, 4, 5]
    fault.begin()
    flood = fault.plans([plan(6)])
    assert len(flood) == 51  # 50 ms of 1 kHz, and the one that was due
    new = [got for got in flood if got.seq > 5]
    assert 15 < len(new) < 51
    assert min(got.stamp_ns for got in flood) < plan(6).stamp_ns
    highest = max(got.seq for got in flood)
    fault.end()
    assert [got.seq for got in fault.plans([plan(7)])] == [highest + 1]


def test_a_set_clock_is_unknown_and_then_right() -> None:
    fault = ClockStep(np.random.default_rng(0))
    assert fault.clock_offset_ns(7) == 7
    assert fault.clock_shift_ns == 0
    fault.begin()
    assert fault.clock_offset_ns(7) is None
    assert abs(fault.clock_shift_ns) == 5_000_000_000
    fault.end()
    assert fault.clock_offset_ns(7) == 7
    assert abs(fault.clock_shift_ns) == 5_000_000_000


# Judging.


@pytest.mark.parametrize(
    ("standing", "after_s"),
    [
        ([True], 0.0),
        ([False], None),
        ([False, False, True], 0.1),
        ([True, False, True, True], 0.1),  # it drove on once
        ([True, True, False], None),
    ],
)
def test_standing_counts_from_when_it_lasts(standing: list[bool], after_s: float | None) -> None:
    assert standing_after_s(standing) == after_s


def test_rows_by_hand() -> None:
    silent = [STOOD, replace(STOOD, stop_s=0.25), replace(STOOD, stop_s=None, drove_again=False, reason=None)]
    flood = [replace(STOOD, stop_s=None, drove_again=False), replace(STOOD, contact=True, arrived=False)]
    killed = [replace(STOOD, stop_s=1.0, drove_again=False, arrived=False)]
    results = {FaultKey("lidar_silent", 1, number): result for number, result in enumerate(silent)}
    results |= {FaultKey("plan_flood", 1, number): result for number, result in enumerate(flood)}
    results |= {FaultKey("server_killed", 1, number): result for number, result in enumerate(killed)}
    first, second, third = fault_rows(results)
    assert first == {
        "fault": "lidar_silent",
        "runs": 3,
        "contacts": 0,
        "stop_p95_s": 0.297,  # 0.25 + 0.95 × 0.05, of the two that stood
        "latest_stop_s": 0.3,
        "limit_s": 0.3,
        "stood_in_time": 2,
        "recovered": 2,
        "arrivals": 3,
        "bar_met": False,
    }
    assert (second["contacts"], second["limit_s"], second["arrivals"], second["bar_met"]) == (1, None, 1, False)
    assert (third["stood_in_time"], third["arrivals"], third["bar_met"]) == (1, None, True)  # 1.0 s is 0.5 + 0.5
    assert fault_bar([first, second, third]).endswith("missed: lidar_silent, plan_flood")
    assert fault_bar([third]).endswith(": met")
    assert "did not stand in time" in fault_note(FaultKey("lidar_silent", 1, 2), silent[2])
    assert fault_note(FaultKey("lidar_silent", 1, 0), STOOD) == ""


def test_every_fault_gets_as_many_runs() -> None:
    keys = fault_keys(runs=3, seed=1)
    assert [key.fault for key in keys] == [name for name in FAULTS for _ in range(3)]


# A run.


def test_a_robot_whose_lidar_falls_silent_stands_and_goes_on_and_runs_repeat() -> None:
    key = FaultKey("lidar_silent", 1000, 0)
    result = run_fault(key)
    assert (result.contact, result.drove_again, result.arrived) == (False, True, True)
    assert result.stop_s is not None
    assert result.stop_s <= 0.3 + 0.05  # the rule's limit, at the next tick
    assert result.began_s is not None
    assert result.duration_s > result.began_s + result.hold_s
    assert run_fault(key) == result
