"""The demo as a newcomer runs it: three processes, the shipped models, a goal, arrival."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_the_headless_demo_arrives_without_contact() -> None:
    command = [str(Path(sys.executable).with_name("revnm-sim")), "demo", "--headless", "--seed", "3"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "arrived" in done.stdout
