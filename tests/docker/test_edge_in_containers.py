"""The server with the shipped example of settings, and a robot's client, each in a container, over TLS both ways."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.server.waiting import eventually

from revnm_client.errors import LinkError
from revnm_server.api_client import ServerAddress, call

from .podman import GUARDED, need_images, podman, run

pytestmark = pytest.mark.slow

EXAMPLE = Path(__file__).parents[2] / "docker" / "server.example.yaml"
TOKEN = "0123456789abcdefXYZ"
ROBOT = """
robot: rover
server: tls/127.0.0.1:7447
profile: megarover
security: {authority: rover/authority.pem, certificate: rover/robot.pem, key: rover/robot.key}
"""


@pytest.fixture
def address(tmp_path: Path) -> Iterator[ServerAddress]:
    need_images()
    remove()
    for command in (("init", "--host", "127.0.0.1"), ("robot", "rover")):
        mount = ("--user", "0", "--volume", f"{tmp_path}:/out", "--workdir", "/out")
        podman("run", "--rm", "--network", "none", *mount, "revnm-server", "pki", *command)
    (tmp_path / "token.txt").write_text(TOKEN + "\n")
    (tmp_path / "robot.yaml").write_text(ROBOT)
    for path in (tmp_path, *tmp_path.rglob("*")):
        os.chown(path, 10001, 10001)
    server = ("--volume", f"{EXAMPLE}:/etc/revnm/server.yaml:ro", "--volume", f"{tmp_path}/pki:/etc/revnm/pki:ro")
    server += (
        "--volume",
        f"{tmp_path}/token.txt:/run/secrets/REVNM_HTTP__TOKEN:ro",
        "--publish",
        "127.0.0.1:8000:8000",
    )
    robot = ("--volume", f"{tmp_path}/robot.yaml:/etc/revnm/robot.yaml:ro")
    robot += ("--volume", f"{tmp_path}/pki/rover:/etc/revnm/rover:ro", "--network", "container:edge-server")
    limits = ("--memory", "2g", "--pids-limit", "256")
    try:
        podman("run", "--detach", "--name", "edge-server", *GUARDED, *limits, *server, "revnm-server")
        podman("run", "--detach", "--name", "edge-robot", *GUARDED, *limits, *robot, "revnm-robot")
        yield ServerAddress("https://127.0.0.1:8000", TOKEN, tmp_path / "pki" / "server.pem")
    finally:
        remove()


def remove() -> None:
    """Remove the containers, also those of a run that was cut."""
    for name in ("edge-robot", "edge-server"):  # the first is in the network of the second
        run("podman", "rm", "--force", "--time", "5", "--volumes", name)


def rover(address: ServerAddress) -> dict[str, Any]:
    """What the server knows of the robot; nothing while it does not answer."""
    threading.Event().wait(0.5)
    try:
        view: dict[str, Any] = call(address, "GET", "/api/v1/state")["robots"][0]
    except LinkError:
        return {}
    return view


def test_they_hear_each_other_and_the_health_check_is_good(address: ServerAddress) -> None:
    try:
        heard = eventually(lambda: rover(address).get("robot_state"), within_s=200.0)
    except AssertionError as error:
        said = [run("podman", "logs", name).stderr for name in ("edge-server", "edge-robot")]
        raise AssertionError("\n".join([str(error), *said])) from error
    assert heard["reason"] == "no odometry yet"
    assert run("podman", "healthcheck", "run", "edge-server").returncode == 0
    with pytest.raises(LinkError, match="401"):
        call(ServerAddress(address.url, None, address.certificate), "GET", "/api/v1/state")
    podman("stop", "--time", 15, "edge-server")
    assert podman("inspect", "--format", "{{.State.ExitCode}}", "edge-server") == "0"
