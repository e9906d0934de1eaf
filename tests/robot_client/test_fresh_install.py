from __future__ import annotations

import subprocess
import sys
import venv
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
UNREACHABLE = (
    "NewConnectionError",
    "ConnectTimeoutError",
    "NameResolutionError",
    "Failed to establish a new connection",
    "Temporary failure in name resolution",
    "ProxyError",
)
HEAVY = {"torch", "onnxruntime", "cv2", "fastapi", "scipy", "numba", "pybullet", "pydantic"}
LOOK = f"""
import importlib.util, sys
import revnm_client.runner, revnm_client.cli
print(sorted(name for name in {sorted(HEAVY)} if importlib.util.find_spec(name)))
print(sys.modules.keys() & {HEAVY})
"""


def run(*command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=300)


def test_the_client_alone_installs_and_pulls_nothing_heavy(tmp_path):
    venv.create(tmp_path / "venv", with_pip=False, symlinks=True)
    python = tmp_path / "venv" / "bin" / "python"
    pip = (sys.executable, "-m", "pip", "--python", python)
    installed = run(
        *pip, "install", "--quiet", "--retries", 1, "--timeout", 15,
        "--constraint", REPOSITORY / "constraints.txt", REPOSITORY / "robot_client",
    )  # fmt: skip
    if installed.returncode != 0 and any(word in installed.stderr for word in UNREACHABLE):
        pytest.skip(f"the package index cannot be reached: {installed.stderr.strip()[-300:]}")
    assert installed.returncode == 0, installed.stderr

    look = run(python, "-I", "-W", "error", "-c", LOOK)
    assert look.returncode == 0, look.stderr
    assert look.stdout.splitlines() == ["[]", "set()"]
    assert run(python.with_name("revnm-robot"), "run", "--help").returncode == 0
    listed = run(*pip, "list", "--format", "freeze").stdout
    assert {"eclipse-zenoh", "numpy", "rosbags", "revnm-client"} <= {
        line.split("==")[0] for line in listed.splitlines()
    }
