"""The command ``revnm-sim``."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from revnm_client.errors import ConfigError, LinkError
from revnm_client.exit_status import exit_status
from revnm_client.version_option import VersionAction

if TYPE_CHECKING:
    from revnm_client.credentials import Credentials

_DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_DEFAULT_ROBOT, _DEFAULT_CAMERA = "rover", "cam0"
_MEASURES = {
    "bench": ("methods against each other in closed loop", "bench.command"),
    "world": ("draw a world, or check it against measurements", "measures.world_command"),
    "lift": ("measure the map that the server makes of the camera's depth", "measures.lift_command"),
    "raycast": ("measure how fast exact depth images are made", "measures.raycast_command"),
    "tags": ("measure how small a tag is found, how exactly, and what is taken for one", "measures.tag_command"),
    "calibration": ("measure how well a camera calibrates itself", "measures.calibration_command"),
    "viewers": ("measure what many who look at the page cost the server", "measures.viewers_command"),
    "soak": ("measure what half an hour of random goals and faults does to the system", "soak.command"),
    "camera": ("measure how the server's camera reader bears faults", "measures.camera_command"),
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return its :func:`revnm_client.exit_status.exit_status`.

    SIGTERM and the end of the terminal are like Ctrl-C: what a command has started ends with it.
    """
    for number in _endings():
        signal.signal(number, signal.default_int_handler)
    words = list(sys.argv[1:] if argv is None else argv)
    arguments = build_parser(words).parse_args(words)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    said = "stopped; a benchmark goes on with the same command"
    return exit_status("revnm-sim", lambda: int(arguments.run(arguments)), stopped=said)


def build_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser for a command line; only the options of the command that it names are there."""
    parser = argparse.ArgumentParser(prog="revnm-sim", description="The ReVNM simulator.")
    parser.add_argument("--version", action=VersionAction, const="revnm-sim")
    commands = parser.add_subparsers(dest="command", required=True)
    _add_run(commands.add_parser("run", help="simulate robot and camera in real time until Ctrl-C"))
    _add_demo(commands.add_parser("demo", help="simulator, server and robot on this machine"))
    for name, (text, module) in _MEASURES.items():
        command = commands.add_parser(name, help=text)
        if words[:1] == [name]:  # the imports of one take seconds that the others need not wait
            imported = import_module(f"revnm_sim.{module}")
            imported.add_arguments(command)
            command.set_defaults(run=imported.run)
    return parser


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=_seed, default=0, help="which world (default: 0)")
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="be the robot of these settings, with its certificate or password; the camera is one by --rtsp then",
    )
    parser.add_argument("--robot", metavar="NAME", help="name of the robot (default: rover)")
    parser.add_argument("--camera", metavar="NAME", help="name of the camera (default: cam0)")
    parser.add_argument(
        "--connect",
        action="append",
        metavar="ENDPOINT",
        help="where the server is, tcp/HOST:PORT; may be repeated (without --config: tcp/127.0.0.1:7447)",
    )
    parser.add_argument("--fps", type=_rate, default=5.0, help="pictures per second (default: 5)")
    parser.add_argument(
        "--rtsp", type=_address, metavar="HOST:PORT", help="also be an IP camera there, rtsp://HOST:PORT/stream"
    )
    parser.set_defaults(run=_run)


def _add_demo(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=_seed, default=0, help="which world, start and goal (default: 0)")
    parser.add_argument("--headless", action="store_true", help="set the goal, wait for arrival, print a summary")
    parser.add_argument(
        "--timeout", type=_rate, default=90.0, metavar="S", help="headless: seconds for the drive (default: 90)"
    )
    parser.add_argument(
        "--http", metavar="HOST:PORT", help="where the page is (default: 127.0.0.1:8000; headless: a free port)"
    )
    parser.add_argument("--planner", choices=("revnm", "bev"), help="the server's (default: as it is configured)")
    parser.set_defaults(run=_demo)


def _run(arguments: argparse.Namespace) -> int:
    from revnm_client.link import open_client
    from revnm_sim.live.rtsp_server import RtspServer
    from revnm_sim.live.simulator import LiveSettings, LiveSimulator
    from revnm_sim.scenario import demo_scenario
    from revnm_sim.simulation import Simulation

    end = _robot_end(arguments)
    settings = LiveSettings(end.robot, _camera(arguments, end.credentials), arguments.fps)
    stop = _stop_on_signals()
    try:
        with ExitStack() as stack:
            server = None
            if arguments.rtsp is not None:
                server = stack.enter_context(RtspServer(address=arguments.rtsp, fps=settings.fps))
            session = stack.enter_context(open_client(end.server, credentials=end.credentials, stop=stop))
            simulation = stack.enter_context(Simulation(demo_scenario(arguments.seed), arguments.seed))
            show = server.show if server is not None else None
            stack.enter_context(LiveSimulator(simulation, session, settings, show=show)).run(stop)
    except LinkError:
        if not stop.is_set():
            raise
    return 0


class _RobotEnd(NamedTuple):
    """The robot that is simulated, and how it reaches its server; None where it shows nothing to be let in."""

    robot: str
    server: Sequence[str]
    credentials: Credentials | None


def _robot_end(arguments: argparse.Namespace) -> _RobotEnd:
    """Return what the options say; with a settings file, what the robot's client would make of it and of them."""
    if arguments.config is None:
        return _RobotEnd(arguments.robot or _DEFAULT_ROBOT, arguments.connect or [_DEFAULT_ENDPOINT], None)
    from revnm_client.settings import SecuritySettings, load_settings

    given = {"robot": arguments.robot, "server": arguments.connect}
    settings = load_settings(
        arguments.config, options={key: value for key, value in given.items() if value is not None}
    )
    if settings.security == SecuritySettings():
        return _RobotEnd(settings.robot, settings.server, None)
    return _RobotEnd(settings.robot, settings.server, settings.security.credentials(settings.robot))


def _camera(arguments: argparse.Namespace, credentials: Credentials | None) -> str | None:
    """Return the name of the camera that publishes pictures, if one does."""
    if credentials is None:
        return arguments.camera or _DEFAULT_CAMERA
    if arguments.rtsp is None or arguments.camera is not None:
        raise ConfigError("--config: what lets the robot in lets no camera in: expected --rtsp, and no --camera")
    return None


def _demo(arguments: argparse.Namespace) -> int:
    from revnm_sim.live.demo import DemoSettings, run_demo

    settings = DemoSettings(arguments.seed, arguments.headless, arguments.timeout, arguments.http, arguments.planner)
    return run_demo(settings, _stop_on_signals(), lambda line: print(line, flush=True))


def _stop_on_signals() -> threading.Event:
    stop = threading.Event()
    for number in _endings():
        signal.signal(number, lambda *_: stop.set())
    return stop


def _endings() -> list[signal.Signals]:
    """Return the signals that ask to end; the terminal's end is none under nohup."""
    asking = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]
    return [number for number in asking if signal.getsignal(number) is not signal.SIG_IGN]


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{value}: expected 0 or more")
    return value


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 1 << 16:
        raise argparse.ArgumentTypeError(f"{text}: expected HOST:PORT, such as 127.0.0.1:8554")
    return host.strip("[]"), int(port)


def _rate(text: str) -> float:
    value = float(text)
    if not 0.0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text}: expected a positive number")
    return value
