"""The settings in docs/security, as they stand there: server, robot client, and what stands for the robot's bridge."""

from __future__ import annotations

import json
import os
import re
import shutil
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from tests.server.free_port import free_port
from tests.server.waiting import eventually

from revnm_client import cdr, keys
from revnm_client.agent import RobotAgent
from revnm_client.control_messages import decode_state
from revnm_client.link import open_router
from revnm_client.messages import Velocity
from revnm_client.runner import RobotRunner
from revnm_client.settings import load_settings as load_robot_settings
from revnm_client.settings.assembly import agent_config, runner_settings
from revnm_server.cli import main
from revnm_server.robots.access import router_security
from revnm_server.settings import load_settings as load_server_settings

EXAMPLES = Path(__file__).parents[2] / "docs/security"
SERVER, BRIDGE = "192.168.1.5:7447", "127.0.0.1:7447"


@pytest.fixture(params=sorted(path.name for path in EXAMPLES.iterdir() if path.is_dir()))
def example(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder with one example: addresses are of this machine, and what the guide tells to make is made."""
    folder = tmp_path / "example"
    shutil.copytree(EXAMPLES / request.param, folder)
    monkeypatch.chdir(folder)
    assert main(["pki", "init", "--host", "127.0.0.1"]) == 0
    assert main(["pki", "robot", "rover"]) == 0
    shutil.copytree("pki/rover", "rover")
    Path("passwords.txt").write_text("rover:PASSWORD\n")
    Path("password.txt").write_text("PASSWORD\n")
    server, bridge = (f"127.0.0.1:{free_port()}" for _ in range(2))
    for path in folder.iterdir():
        if path.is_file():
            text = path.read_text().replace(SERVER, server).replace(BRIDGE, bridge)
            path.write_text(text.replace("0.0.0.0:7447", server))
    yield folder
    os.chdir(tmp_path)


def bridge_settings(path: Path) -> zenoh.Config:
    """Return the bridge's settings without its plug-in, which is no part of a session."""
    text = re.sub(r"plugins: \{.*?\n  \},\n", "", path.read_text(), flags=re.DOTALL)
    config = zenoh.Config.from_json5(text)
    assert json.loads(config.get_json("mode")) == "router"
    return config


def test_server_client_and_bridge_find_each_other(example: Path) -> None:
    server = load_server_settings(Path("server.yaml"), overrides={"http": {"token": "a" * 16, "insecure": False}})
    robot = load_robot_settings(Path("robot.yaml"))
    stop = threading.Event()
    heard: list[tuple[str, bytes]] = []
    with ExitStack() as stack:
        security = router_security(server.zenoh, server.robots, [])
        router = stack.enter_context(open_router(server.zenoh.listen, security=security))
        for key in (keys.state("rover"), keys.odom("rover")):
            router.declare_subscriber(
                key, lambda sample: heard.append((str(sample.key_expr), sample.payload.to_bytes()))
            )
        bridge = stack.enter_context(zenoh.open(bridge_settings(Path("bridge.json5"))))
        velocities: list[bytes] = []
        bridge.declare_subscriber(keys.cmd_vel("rover"), lambda sample: velocities.append(sample.payload.to_bytes()))
        runner = RobotRunner(runner_settings(robot), RobotAgent(agent_config(robot)))
        thread = threading.Thread(target=runner.run, args=(stop,))
        thread.start()
        stack.callback(thread.join, 10.0)
        stack.callback(stop.set)

        eventually(lambda: keys.state("rover") in dict(heard), within_s=20.0)
        assert decode_state(dict(heard)[keys.state("rover")])["reason"] == "no odometry yet"
        eventually(lambda: bridge.put(keys.odom("rover"), b"o") or (keys.odom("rover"), b"o") in heard)
        eventually(lambda: velocities)
        assert cdr.decode_velocity(velocities[-1]) == Velocity(0.0, 0.0)
        assert not any(key == keys.cmd_vel("rover") for key, _ in heard)
