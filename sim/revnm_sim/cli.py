"""The command ``revnm-sim``."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack

from revnm_client.errors import LinkError, RevnmError

_DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
_INTERRUPTED = 130


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit status: 2 for what the person who called can mend, 130 after Ctrl-C."""
    words = list(sys.argv[1:] if argv is None else argv)
    arguments = _parser(words).parse_args(words)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    try:
        return int(arguments.run(arguments))
    except RevnmError as error:
        print(f"revnm-sim: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("revnm-sim: stopped; a benchmark goes on with the same command", file=sys.stderr)
        return _INTERRUPTED


def _parser(words: Sequence[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="revnm-sim", description="The ReVNM simulator.")
    commands = parser.add_subparsers(dest="command", required=True)
    _add_run(commands.add_parser("run", help="simulate robot and camera in real time until Ctrl-C"))
    _add_demo(commands.add_parser("demo", help="simulator, server and robot on this machine"))
    bench = commands.add_parser("bench", help="methods against each other in closed loop")
    if words[:1] == ["bench"]:  # its imports take seconds that the other commands need not wait
        from revnm_sim.bench import command

        command.add_arguments(bench)
        bench.set_defaults(run=command.run)
    world = commands.add_parser("world", help="draw a world, or check it against measurements")
    if words[:1] == ["world"]:
        from revnm_sim import world_command

        world_command.add_arguments(world)
    lift = commands.add_parser("lift", help="measure the map that the server makes of the camera's depth")
    if words[:1] == ["lift"]:
        from revnm_sim import lift_command

        lift_command.add_arguments(lift)
        lift.set_defaults(run=lift_command.run)
    raycast = commands.add_parser("raycast", help="measure how fast exact depth images are made")
    if words[:1] == ["raycast"]:
        from revnm_sim import raycast_command

        raycast_command.add_arguments(raycast)
        raycast.set_defaults(run=raycast_command.run)
    tags = commands.add_parser("tags", help="measure how small a tag is found, how exactly, and what is taken for one")
    if words[:1] == ["tags"]:
        from revnm_sim import tag_command

        tag_command.add_arguments(tags)
        tags.set_defaults(run=tag_command.run)
    calibration = commands.add_parser("calibration", help="measure how well a camera calibrates itself")
    if words[:1] == ["calibration"]:
        from revnm_sim import calibration_command

        calibration_command.add_arguments(calibration)
        calibration.set_defaults(run=calibration_command.run)
    viewers = commands.add_parser("viewers", help="measure what many who look at the page cost the server")
    if words[:1] == ["viewers"]:
        from revnm_sim import viewers_command

        viewers_command.add_arguments(viewers)
        viewers.set_defaults(run=viewers_command.run)
    camera = commands.add_parser("camera", help="measure how the server's camera reader bears faults")
    if words[:1] == ["camera"]:
        from revnm_sim import camera_command

        camera_command.add_arguments(camera)
        camera.set_defaults(run=camera_command.run)
    return parser


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--seed", type=_seed, default=0, help="which world (default: 0)")
    parser.add_argument("--robot", default="rover", metavar="NAME", help="name of the robot (default: rover)")
    parser.add_argument("--camera", default="cam0", metavar="NAME", help="name of the camera (default: cam0)")
    parser.add_argument(
        "--connect",
        action="append",
        metavar="ENDPOINT",
        help=f"where the server is, tcp/HOST:PORT; may be repeated (default: {_DEFAULT_ENDPOINT})",
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
    from revnm_sim.live import LiveSettings, LiveSimulator
    from revnm_sim.rtsp_server import RtspServer
    from revnm_sim.scenario import demo_scenario
    from revnm_sim.simulation import Simulation

    settings = LiveSettings(arguments.robot, arguments.camera, arguments.fps)
    stop = _stop_on_signals()
    try:
        with ExitStack() as stack:
            server = None
            if arguments.rtsp is not None:
                server = stack.enter_context(RtspServer(address=arguments.rtsp, fps=settings.fps))
            session = stack.enter_context(open_client(arguments.connect or [_DEFAULT_ENDPOINT], stop=stop))
            simulation = stack.enter_context(Simulation(demo_scenario(arguments.seed), arguments.seed))
            show = server.show if server is not None else None
            stack.enter_context(LiveSimulator(simulation, session, settings, show=show)).run(stop)
    except LinkError:
        if not stop.is_set():
            raise
    return 0


def _demo(arguments: argparse.Namespace) -> int:
    from revnm_sim.demo import DemoSettings, run_demo

    settings = DemoSettings(arguments.seed, arguments.headless, arguments.timeout, arguments.http, arguments.planner)
    return run_demo(settings, _stop_on_signals(), lambda line: print(line, flush=True))


def _stop_on_signals() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop


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
