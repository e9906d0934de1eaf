"""The builds for graphics cards are too large to make here: pip resolves them, and installs nothing."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PINS = (ROOT / "constraints.txt", ROOT / "docker" / "accelerators.txt")


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.mark.parametrize(
    ("accelerator", "runtime"), [("cuda", "onnxruntime-gpu"), ("openvino", "onnxruntime-openvino")]
)
def test_all_that_an_accelerator_brings_is_pinned(accelerator: str, runtime: str, tmp_path: Path) -> None:
    script = [
        sys.executable,
        ROOT / "docker" / "requirements.py",
        "--accelerator",
        accelerator,
        "robot_client",
        "server",
    ]
    (tmp_path / "needed.txt").write_text(subprocess.run(script, cwd=ROOT, capture_output=True, text=True).stdout)
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--dry-run",
        "--ignore-installed",
        "--only-binary",
        ":all:",
    ]
    command += ["--report", str(tmp_path / "report.json"), "--requirement", str(tmp_path / "needed.txt")]
    command += [word for pins in PINS for word in ("--constraint", str(pins))]
    resolved = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert resolved.returncode == 0, resolved.stderr
    found = {normal(each["metadata"]["name"]) for each in json.loads((tmp_path / "report.json").read_text())["install"]}
    pinned = {normal(line.split("==")[0]) for pins in PINS for line in pins.read_text().splitlines() if "==" in line}
    assert runtime in found
    assert "onnxruntime" not in found
    assert found <= pinned
