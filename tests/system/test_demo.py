"""The demo as a newcomer runs it: three processes, the shipped models, a goal, arrival."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from revnm_server.calibration.store import load_belief


def _demo(*options: str, **environment: str) -> str:
    command = [str(Path(sys.executable).with_name("revnm-sim")), "demo", "--headless", "--seed", "3", *options]
    env = {**os.environ, **environment}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=env)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_headless_demo_arrives_without_contact() -> None:
    assert "arrived" in _demo()


@pytest.mark.slow
def test_the_map_planner_arrives_with_a_camera_that_it_learns_on_the_way(tmp_path: Path) -> None:
    shown = _demo("--planner", "bev", REVNM_PERCEPTION__CALIBRATION_DIR=str(tmp_path))
    assert "server map" in shown
    kept = load_belief(tmp_path / "camera.json", "camera", (1280, 960))
    assert kept is not None
