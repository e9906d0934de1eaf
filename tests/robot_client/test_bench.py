"""What ``revnm-robot bench`` measures with, and the command itself."""

from __future__ import annotations

import json
import math
import os

import numpy as np
import pytest

from revnm_client.cli import main
from revnm_client.geometry import Pose2
from revnm_client.mppi import Footprint
from revnm_client.speed import course
from revnm_client.speed.live_loop import LoopCost
from revnm_client.speed.one_core import call_on_one_core


def test_the_course_is_cluttered_and_free() -> None:
    for state in course.inputs(60, 0.4):
        clear = np.hypot(*state.points_m.T).min()
        assert Footprint().circumscribed_m + 0.03 < clear < 1.0
        assert len(state.points_m) == course.BEAMS
        assert math.hypot(*state.waypoints_m[1]) == pytest.approx(0.4, rel=0.01)


def test_the_scan_sees_pillars_before_walls() -> None:
    # From the middle of the right edge of the course, facing the pillar of radius 0.15 m at (2.2, 0.4).
    pose = Pose2(1.5, 0.4, 0.0)
    ranges = course.scan(pose, 0).ranges_m
    assert ranges[360] == pytest.approx(2.2 - 0.15 - 1.5, abs=1e-5)
    # To the left, 0.1 m past the middle of the pillar of radius 0.2 m at (1.6, 1.6).
    assert ranges[360 + 180] == pytest.approx(1.6 - 0.4 - math.sqrt(0.2**2 - 0.1**2), abs=1e-5)
    x, y = pose.apply(course.scan(pose, 0).points_m()).T
    assert max(np.abs(x).max(), np.abs(y).max()) == pytest.approx(2.6, abs=1e-5)


def test_missed_deadlines_are_periods_without_a_velocity() -> None:
    # 10 s are 200 periods, so 201 velocities are due; 198 came. 1.5 s of a core in 10 s are 15 %.
    cost = LoopCost(np.array([[4.0, 5.0], [4.2, 9.0], [8.0, 6.0]]), 198, 10.004, 1.5, 60.04)
    assert cost.row() == {
        "p50_ms": 4.2, "p95_ms": 6.0, "cpu_percent": 15.0, "rss_mb": 60.0, "missed_deadlines_percent": 1.5,
    }  # fmt: skip


def test_what_is_measured_has_one_core_and_nobody_else_loses_any(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    before = os.sched_getaffinity(0)
    assert len(call_on_one_core(os.sched_getaffinity, 0)) == 1
    assert call_on_one_core(os.getenv, "OPENBLAS_NUM_THREADS") == "1"
    assert os.sched_getaffinity(0) == before
    assert (os.environ.get("OPENBLAS_NUM_THREADS"), os.environ["OMP_NUM_THREADS"]) == (None, "7")


def test_bench_measures_controller_and_loop(tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--ticks", "3", "--loop-seconds", "2", "--out", str(tmp_path / "new")]) == 0
    report = json.loads((tmp_path / "new" / "report.json").read_text())
    rows = {row["name"]: row for row in report["rows"]}
    assert {"mppi_2000x56", "mppi_1000x30", "loop_1000x30"} <= rows.keys()
    assert rows["mppi_2000x56"]["p50_ms"] > 0.0
    loop = rows["loop_1000x30"]
    assert 0.0 < loop["cpu_percent"] <= 100.0
    assert 20.0 < loop["rss_mb"] < 500.0
    assert 0.0 <= loop["missed_deadlines_percent"] < 100.0
    assert {"command", "versions", "machine"} <= report.keys()
    assert "| loop_1000x30 |" in capsys.readouterr().out


@pytest.mark.parametrize("bad", [["--ticks", "0"], ["--loop-seconds", "-1"], ["--loop-seconds", "0.5"]])
def test_bench_refuses_senseless_numbers(bad: list[str], tmp_path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *bad, "--out", str(tmp_path)]) == 2
    assert bad[0] in capsys.readouterr().err
