"""The whole system in a small hall: server and robot client as processes, the simulator in a thread of the test.

The simulator is in the test's own process so that the true pose can be read whatever happens to the router.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from tests.server.free_port import free_port
from tests.server.tiny_bundle import write_tiny_bundle
from tests.server.waiting import eventually

from revnm_client.geometry import Pose2
from revnm_client.link import open_client
from revnm_sim.camera import Camera
from revnm_sim.live import LiveSettings, LiveSimulator
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import TAG_ID, Simulation
from revnm_sim.world import Bounds, Primitive, Shape, World

from .process import Process

ROBOT, CAMERA = "rover", "cam0"

_GRAY = (170, 170, 175)
_WALLS = tuple(
    Primitive(Shape.BOX, (x, y, 0.25), (width, depth, 0.5), 0.0, _GRAY)
    for x, y, width, depth in ((0.0, 2.6, 7.2, 0.2), (0.0, -2.6, 7.2, 0.2), (3.5, 0.0, 0.2, 5.0), (-3.5, 0.0, 0.2, 5.0))
)
_PILLAR = Primitive(Shape.CYLINDER, (0.0, 1.6, 0.3), (0.4, 0.4, 0.6), 0.0, (160, 90, 60))

# The camera hangs above the floor with x to the right and y up in the picture, as the tiny bundle expects.
SCENARIO = Scenario(
    world=World("hall", Bounds(-3.4, -2.5, 3.4, 2.5), (150, 150, 150), (*_WALLS, _PILLAR)),
    camera=Camera(640, 480, math.radians(75.0), (0.0, 0.0, 4.3), math.pi / 2, math.pi / 2),
    start=Pose2(-2.0, -0.6, 0.0),
    goal_m=(1.6, 0.5),
    seed=0,
)


class Stage:
    """A simulator at work, a server that can be killed and started again, and a robot client."""

    def __init__(self, folder: Path, simulation: Simulation) -> None:
        self.folder = folder
        self.simulation = simulation
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.url = f"http://127.0.0.1:{free_port()}"
        self.server: Process
        self.robot: Process
        self.simulator: LiveSimulator
        self._http = httpx.Client(base_url=self.url, timeout=5.0, trust_env=False)
        self._bundle = write_tiny_bundle(folder / "bundle")

    def start_server(self) -> Process:
        """Start the server and wait until it answers; also after it was killed."""
        arguments = ["serve", "--camera", f"zenoh://{CAMERA}", "--listen", self.endpoint]
        arguments += ["--http", self.url.removeprefix("http://"), "--robot", f"{ROBOT}={TAG_ID}"]
        arguments += ["--bundle", str(self._bundle), "--state-file", str(self.state_file)]
        self.server = Process("revnm-server", arguments, log=self.folder / "server.log")
        eventually(self._answers, within_s=90.0)
        return self.server

    def start_robot(self) -> Process:
        """Start the robot client."""
        arguments = ["run", "--robot", ROBOT, "--connect", self.endpoint]
        self.robot = Process("revnm-robot", arguments, log=self.folder / "robot.log")
        return self.robot

    @property
    def state_file(self) -> Path:
        """Where the server keeps goals and stops."""
        return self.folder / "state.json"

    def call(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Call the server's API."""
        return self._http.request(method, path, **options)

    def state(self) -> dict[str, Any]:
        """Return the server's state."""
        document: dict[str, Any] = self.call("GET", "/api/v1/state").json()
        return document

    def rover(self) -> dict[str, Any]:
        """Return what the server knows of the robot."""
        view: dict[str, Any] = self.state()["robots"][0]
        return view

    def ready(self) -> bool:
        """Whether the server would drive the robot now."""
        return self.call("GET", "/readyz").status_code == 200

    def set_goal(self) -> httpx.Response:
        """Send the robot to the goal of the scenario, as a click would."""
        (u, v), _ = SCENARIO.camera.project(np.array([*SCENARIO.goal_m, 0.0]))
        return self.call("PUT", f"/api/v1/robots/{ROBOT}/goal", json={"u": float(u), "v": float(v)})

    def arrived(self) -> bool:
        """Whether the server says so; what runs must still run."""
        self.server.check()
        self.robot.check()
        return bool(self.rover()["status"] == "arrived")

    def to_goal_m(self) -> float:
        """True distance from robot to goal."""
        pose = self.simulation.true_pose
        return math.dist((pose.x_m, pose.y_m), SCENARIO.goal_m)

    def close(self) -> None:
        """Give the connection back."""
        self._http.close()

    def _answers(self) -> bool:
        self.server.check()
        try:
            return self.call("GET", "/healthz").status_code == 200
        except httpx.TransportError:
            return False


@contextmanager
def stage(folder: Path, *, camera: str = CAMERA) -> Iterator[Stage]:
    """Start everything.

    Args:
        folder: For the bundle, the logs and the state file.
        camera: The name under which the simulator publishes; the server listens to ``CAMERA``.
    """
    stop = threading.Event()
    with ExitStack() as stack:
        simulation = stack.enter_context(Simulation(SCENARIO, SCENARIO.seed))
        system = Stage(folder, simulation)
        stack.callback(system.close)
        stack.callback(lambda: system.server.__exit__())
        system.start_server()
        session = stack.enter_context(open_client([system.endpoint]))
        system.simulator = stack.enter_context(LiveSimulator(simulation, session, LiveSettings(ROBOT, camera)))
        thread = threading.Thread(target=system.simulator.run, args=(stop,))
        thread.start()
        stack.callback(thread.join, 10.0)
        stack.callback(stop.set)
        stack.enter_context(system.start_robot())
        yield system
