"""The demo's world as it would be set up: an IP camera, a ROS 2 robot, a network between, a server; all within reach.

Simulator, camera, network and the robot's bridge run here, server and robot client as processes of their own.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from revnm_client.errors import LinkError
from revnm_client.link import open_client
from revnm_sim.live.children import Children
from revnm_sim.live.demo import CHILD_ENV, ROBOT, free_address
from revnm_sim.live.rtsp_server import RtspServer
from revnm_sim.live.server_api import ServerApi
from revnm_sim.live.simulator import LiveSettings, LiveSimulator
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import TAG_ID, Simulation
from revnm_sim.soak.bridge import open_bridge
from revnm_sim.soak.relay import Relay

FPS = 10.0
_POLL_S = 0.05
_READY_WITHIN_S = 120.0
_ROBOT_YAML = """\
robot: {robot}
server: tcp/{server}
profile: megarover
driver: {{kind: zenoh, connect: tcp/{bridge}}}
"""


@dataclass(frozen=True, slots=True)
class System:
    """All of it, running.

    Attributes:
        children: The processes ``server`` and ``robot``.
        api: The server's.
        camera: The IP camera.
        network: Between the robot and the server.
        live: The simulator.
        simulation: What it runs.
        ready_s: After how long the server was ready at first.
    """

    children: Children
    api: ServerApi
    camera: RtspServer
    network: Relay
    live: LiveSimulator
    simulation: Simulation
    ready_s: float

    @property
    def place_m(self) -> tuple[float, float]:
        """Where the robot truly is, (x, y), world frame."""
        pose = self.simulation.true_pose
        return pose.x_m, pose.y_m

    def state(self) -> dict[str, Any] | None:
        """Return what the server shows; None where it does not answer.

        Raises:
            ChildError: A process has ended that should not have.
        """
        self.children.check()
        try:
            return self.api.state()
        except LinkError:
            return None

    def works(self) -> bool:
        """Whether the robot moves by a plan, or has arrived."""
        state = self.state()
        if state is None or state["camera"]["state"] != "running":
            return False
        robot = state["robots"][0]
        return bool(robot["status"] == "arrived" or (robot["status"] == "driving" and _moves(robot)))


def wait(condition: Callable[[], bool], *, within_s: float) -> bool:
    """Wait for a condition, looking every 0.05 s; return whether it came to be in time."""
    pause, deadline_s = threading.Event(), time.monotonic() + within_s
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        pause.wait(_POLL_S)
    return True


def _moves(robot: dict[str, Any]) -> bool:
    """Tell by its state, which must be new, whether a robot moves."""
    return robot["robot_state"] is not None and robot["robot_state_age_s"] < 1.0 and robot["robot_state"]["moving"]


@contextmanager
def running(scenario: Scenario, seed: int, folder: Path) -> Iterator[System]:
    """Start everything, and wait until the server is ready.

    Args:
        scenario: What is simulated.
        seed: Of the errors of LiDAR and odometry.
        folder: For logs, settings, the state file and the calibration.

    Raises:
        ChildError: A process has ended.
        LinkError: The server is not ready within two minutes, in which it may compile.
    """
    zenoh, http, network_address, bridge_address = (free_address() for _ in range(4))
    with ExitStack() as stack:
        camera = stack.enter_context(RtspServer(fps=FPS))
        network = stack.enter_context(Relay(network_address, zenoh))
        children = stack.enter_context(Children(folder))
        simulation = stack.enter_context(Simulation(scenario, seed))
        stack.enter_context(open_bridge(f"tcp/{bridge_address}", f"tcp/{network_address}"))
        live = stack.enter_context(_driving(simulation, bridge_address, camera))
        api, began_s = ServerApi(f"http://{http}"), time.monotonic()
        children.start("server", "revnm_server.cli", _server_words(camera, zenoh, http, folder), env=CHILD_ENV)
        settings = folder / "robot.yaml"
        settings.write_text(_ROBOT_YAML.format(robot=ROBOT, server=network_address, bridge=bridge_address))
        children.start("robot", "revnm_client.cli", ["run", "--config", str(settings)], env=CHILD_ENV)
        if not wait(lambda: _is_ready(children, api), within_s=_READY_WITHIN_S):
            raise LinkError(f"the server was not ready within {_READY_WITHIN_S:.0f} s: {api.not_ready()}")
        yield System(children, api, camera, network, live, simulation, time.monotonic() - began_s)


def _server_words(camera: RtspServer, zenoh: str, http: str, folder: Path) -> list[str]:
    state_file = folder / "state.json"
    for path in (state_file, folder / "camera.json", folder / "camera.places.json"):
        path.unlink(missing_ok=True)
    words = ["serve", "--camera", camera.url, "--listen", f"tcp/{zenoh}", "--http", http]
    return [
        *words,
        "--robot",
        f"{ROBOT}={TAG_ID}",
        "--state-file",
        str(state_file),
        "--calibration-dir",
        str(folder),
    ]


def _is_ready(children: Children, api: ServerApi) -> bool:
    children.check()
    return api.not_ready() is None


@contextmanager
def _driving(simulation: Simulation, bridge: str, camera: RtspServer) -> Iterator[LiveSimulator]:
    """Let the robot drive and the camera film it, in a thread of their own."""
    stop, settings = threading.Event(), LiveSettings(ROBOT, None, fps=FPS)
    with (
        open_client([f"tcp/{bridge}"]) as session,
        LiveSimulator(simulation, session, settings, show=camera.show) as live,
    ):
        thread = threading.Thread(target=live.run, args=(stop,), name="simulator")
        thread.start()
        try:
            yield live
        finally:
            stop.set()
            thread.join()
