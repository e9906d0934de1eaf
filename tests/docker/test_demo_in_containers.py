"""``compose.yaml`` as it is printed: three containers on a real kernel, and a robot that arrives."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.server.waiting import eventually

from revnm_client.errors import LinkError
from revnm_sim.live.server_api import ServerApi
from revnm_sim.scenario import demo_scenario

from .podman import need_images, podman, run

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SEED = 0
COMPOSE = (Path(sys.executable).with_name("podman-compose"), "--file", ROOT / "docker" / "compose.yaml")


@pytest.fixture
def api() -> Iterator[ServerApi]:
    need_images()
    run(*COMPOSE, "down", "--volumes")  # of a run that was cut
    try:
        up = run(*COMPOSE, "up", "--detach", "--no-build")
        assert up.returncode == 0, up.stdout + up.stderr
        yield ServerApi("http://127.0.0.1:8000")
    finally:
        run(*COMPOSE, "down", "--volumes")


def robot(api: ServerApi) -> dict[str, Any]:
    """What the server says of the robot; asked twice a second, since the demo needs the machine itself."""
    threading.Event().wait(0.5)
    try:
        view: dict[str, Any] = api.state()["robots"][0]
    except LinkError as error:
        return {"status": "no answer", "reason": str(error)}
    return view


def logs() -> str:
    return "\n".join(
        f"== {name}\n{podman('logs', '--tail', 20, f'revnm-demo_{name}_1')}"
        for name in ("server", "simulator", "robot")
    )


def test_the_robot_arrives(api: ServerApi) -> None:
    try:
        eventually(lambda: robot(api) and api.not_ready() is None, within_s=300.0)  # its loops are compiled first
        scenario = demo_scenario(SEED)
        pixel, _ = scenario.camera.project(np.array([*scenario.goal_m, 0.0]))
        api.set_goal("rover", u=float(pixel[0]), v=float(pixel[1]))
        eventually(lambda: robot(api)["status"] == "arrived", within_s=300.0)
    except AssertionError as error:
        raise AssertionError(f"{error}: {api.not_ready()}, {robot(api)}\n{logs()}") from error
    assert run("podman", "healthcheck", "run", "revnm-demo_server_1").returncode == 0
    podman("stop", "--time", 15, "revnm-demo_server_1")
    assert podman("inspect", "--format", "{{.State.ExitCode}}", "revnm-demo_server_1") == "0"
