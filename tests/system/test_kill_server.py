"""The server dies or hangs while the robot drives: the robot stands, and goes on when the server is back."""

from __future__ import annotations

import signal
import time
from pathlib import Path

from tests.server.waiting import eventually

from .speed_gauge import SpeedGauge
from .stage import Stage, stage

STANDS_WITHIN_S = 0.7
DRIVES_MPS = 0.2


def start_driving(system: Stage, gauge: SpeedGauge) -> None:
    """Set the goal and wait until the robot truly drives."""
    eventually(system.server.ready, within_s=20.0)
    assert system.server.set_goal().status_code == 200
    gauge.wait_faster(DRIVES_MPS, within_s=10.0)


def test_killed_it_leaves_a_robot_that_stands_and_restarted_one_that_goes_on(tmp_path: Path) -> None:
    with stage(tmp_path) as system:
        gauge = SpeedGauge(system.simulation)
        start_driving(system, gauge)
        killed_s = time.monotonic()
        system.server.process.signal(signal.SIGKILL)
        assert gauge.wait_standing(within_s=5.0) - killed_s < STANDS_WITHIN_S
        stood_m = system.simulation.path_m

        system.server.start()
        assert system.simulation.path_m - stood_m < 0.01
        gauge.wait_faster(DRIVES_MPS, within_s=15.0)
        eventually(system.arrived, within_s=30.0)
        gauge.wait_standing(within_s=5.0)
        assert system.to_goal_m() < 0.5
        assert not system.simulation.had_contact


def test_frozen_it_leaves_a_robot_that_stands_and_thawed_one_that_goes_on(tmp_path: Path) -> None:
    with stage(tmp_path) as system:
        gauge = SpeedGauge(system.simulation)
        start_driving(system, gauge)
        frozen_s = time.monotonic()
        system.server.process.signal(signal.SIGSTOP)
        assert gauge.wait_standing(within_s=5.0) - frozen_s < STANDS_WITHIN_S

        system.server.process.signal(signal.SIGCONT)
        gauge.wait_faster(DRIVES_MPS, within_s=15.0)
        eventually(system.arrived, within_s=30.0)
        gauge.wait_standing(within_s=5.0)
        assert system.to_goal_m() < 0.5
        assert not system.simulation.had_contact
