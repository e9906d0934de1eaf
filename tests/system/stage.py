"""The whole system in a small hall: server and robot client as processes, the simulator in a thread of the test.

The simulator is in the test's own process so that the true pose can be read whatever happens to the router.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.server.free_port import free_port

from revnm_client.link import open_client
from revnm_sim.live.simulator import LiveSettings, LiveSimulator
from revnm_sim.simulation import Simulation

from .hall import CAMERA, ROBOT, SCENARIO
from .process import Process
from .server import Server


@dataclass
class Stage:
    """What is at work.

    Attributes:
        simulation: The world, with the true pose.
        simulator: Publishes what its sensors measure.
        server: Can be killed and started again.
        robot: The client; can be, too.
    """

    simulation: Simulation
    simulator: LiveSimulator
    server: Server
    robot: Process

    def arrived(self) -> bool:
        """Whether the server says so; what runs must still run."""
        self.server.process.check()
        self.robot.check()
        return bool(self.server.rover()["status"] == "arrived")

    def to_goal_m(self) -> float:
        """True distance from robot to goal."""
        pose = self.simulation.true_pose
        return math.dist((pose.x_m, pose.y_m), SCENARIO.goal_m)


@contextmanager
def at_work(simulator: LiveSimulator) -> Iterator[LiveSimulator]:
    """Run a simulator in a thread."""
    stop = threading.Event()
    thread = threading.Thread(target=simulator.run, args=(stop,))
    thread.start()
    try:
        yield simulator
    finally:
        stop.set()
        thread.join(10.0)


@contextmanager
def stage(folder: Path, *, camera: str = CAMERA) -> Iterator[Stage]:
    """Start everything on this machine; the server's router is the only one.

    Args:
        folder: For the bundle, the logs and the state file.
        camera: The name under which the simulator publishes; the server listens to ``CAMERA``.
    """
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        simulation = stack.enter_context(Simulation(SCENARIO, SCENARIO.seed))
        server = Server(folder, listen=endpoint, http=f"127.0.0.1:{free_port()}")
        stack.callback(server.close)
        server.start()
        session = stack.enter_context(open_client([endpoint]))
        simulator = stack.enter_context(LiveSimulator(simulation, session, LiveSettings(ROBOT, camera)))
        stack.enter_context(at_work(simulator))
        arguments = ["run", "--robot", ROBOT, "--connect", endpoint]
        robot = stack.enter_context(Process("revnm-robot", arguments, log=folder / "robot.log"))
        yield Stage(simulation, simulator, server, robot)
