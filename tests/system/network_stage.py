"""A robot whose server is on another machine, behind a link that can be broken.

This machine is the robot and what is around it: the simulator, a router of the robot's own as zenoh-bridge-ros2dds is
one, and the robot's client. The server is in a network namespace. The camera is wired to it (RTSP) by a cable that is
never broken, over which the test asks what the page says.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.server.free_port import free_port

from revnm_client.link import open_client
from revnm_sim.live.rtsp_server import RtspServer
from revnm_sim.live.simulator import LiveSettings, LiveSimulator
from revnm_sim.simulation import Simulation

from .emulated_link import LinkCondition
from .hall import CAMERA, ROBOT, SCENARIO
from .network import give_address, small_disk, take_address
from .process import Process
from .server import Server
from .site import SERVER_HOSTS, Site, site
from .stage import Stage, at_work

_HTTP_PORT = 8000
_FPS = 10.0

_ROBOT_YAML = """\
robot: {robot}
server: [{servers}]
profile: megarover
driver: {{kind: zenoh, connect: {router}}}
"""
_SERVER_YAML = """\
recording: {{folder: {folder}, least_free_gb: 0.0}}
"""
_RECORDS_MB = 4


@dataclass
class NetworkStage(Stage):
    """What is at work.

    Attributes:
        site: The machines.
        folder: For logs.
        router: The robot's own; can be killed.
        router_endpoint: Where it listens.
        records: Folder of the run records, a disk of four megabytes.
    """

    site: Site
    folder: Path
    router: Process
    router_endpoint: str
    records: Path

    def start_router(self) -> None:
        """Start the robot's own router again, after it was killed."""
        self.router = start_router(self.folder, self.router_endpoint, self.site)

    def move_server(self, before: int, after: int) -> None:
        """Give the server's machine another address on the link; the server, which has ended, will listen there."""
        edge, interface, subnet = self.site.edge, self.site.interface, self.site.subnets[0]
        take_address(interface, f"{subnet}.{before}/24", inside=edge)
        give_address(interface, f"{subnet}.{after}/24", inside=edge)
        self.server.listen = self.site.endpoint(after)

    def mend(self) -> None:
        """Let all that a test broke be whole again."""
        self.site.link.become(LinkCondition())
        if self.router.status is not None:
            self.start_router()
        if self.server.process.status is not None:
            self.server.start()


def start_router(folder: Path, endpoint: str, site: Site) -> Process:
    """Start the robot's own router, which looks for the server at all of its addresses."""
    script = str(Path(__file__).with_name("robot_router.py"))
    arguments = [script, endpoint, *map(site.endpoint, SERVER_HOSTS)]
    return Process("python", arguments, log=folder / "router.log")


@contextmanager
def network_stage(folder: Path, *, by_own_router: bool = False) -> Iterator[NetworkStage]:
    """Start everything.

    Args:
        folder: For the bundle, the logs, the settings and the state file.
        by_own_router: Whether the robot's client hears the server through the robot's own router, too.
    """
    records, router_endpoint = folder / "records", f"tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        where = stack.enter_context(site())
        stack.enter_context(small_disk(records, size_mb=_RECORDS_MB))  # before the server, which sees no later mount
        simulation = stack.enter_context(Simulation(SCENARIO, SCENARIO.seed))
        camera = stack.enter_context(RtspServer(address=(f"{where.subnets[1]}.1", 0), fps=_FPS))
        (folder / "server.yaml").write_text(_SERVER_YAML.format(folder=records))
        server = Server(
            folder,
            listen=where.endpoint(SERVER_HOSTS[0]),
            http=f"{where.subnets[1]}.2:{_HTTP_PORT}",
            camera=camera.url,
            options=["--insecure-http", "--insecure-zenoh", "--config", str(folder / "server.yaml")],
            prefix=where.edge.prefix,
        )
        stack.callback(server.close)
        router = stack.enter_context(start_router(folder, router_endpoint, where))
        session = stack.enter_context(open_client([router_endpoint]))
        settings = LiveSettings(ROBOT, CAMERA, fps=_FPS)
        simulator = stack.enter_context(LiveSimulator(simulation, session, settings, show=camera.show))
        stack.enter_context(at_work(simulator))
        server.start()
        servers = [router_endpoint] if by_own_router else [where.endpoint(host) for host in SERVER_HOSTS]
        robot = stack.enter_context(_robot(folder, servers, router_endpoint))
        system = NetworkStage(simulation, simulator, server, robot, where, folder, router, router_endpoint, records)
        stack.callback(lambda: system.router.__exit__())  # a later one
        yield system


def _robot(folder: Path, servers: list[str], router: str) -> Process:
    settings = _ROBOT_YAML.format(robot=ROBOT, servers=", ".join(servers), router=router)
    (folder / "robot.yaml").write_text(settings)
    arguments = ["run", "--config", str(folder / "robot.yaml")]
    return Process("revnm-robot", arguments, log=folder / "robot.log")
