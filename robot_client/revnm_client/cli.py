"""The command ``revnm-robot``."""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import threading
from collections.abc import Sequence

from revnm_client.agent import AgentConfig, RobotAgent
from revnm_client.errors import LinkError, RevnmError
from revnm_client.runner import RobotRunner, RunnerSettings

_DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="revnm-robot", description="ReVNM on the robot.")
    commands = parser.add_subparsers(dest="command", required=True)
    run = commands.add_parser("run", help="follow the server's plans until Ctrl-C")
    run.add_argument("--robot", required=True, metavar="NAME", help="name of the robot, as the server knows it")
    run.add_argument(
        "--connect",
        action="append",
        metavar="ENDPOINT",
        help=f"where the server is, tcp/HOST:PORT; may be repeated (default: {_DEFAULT_ENDPOINT})",
    )
    return parser


def _stop_on_signals() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop


def _run(arguments: argparse.Namespace) -> None:
    settings = RunnerSettings(robot=arguments.robot, connect=tuple(arguments.connect or [_DEFAULT_ENDPOINT]))
    runner = RobotRunner(settings, RobotAgent(AgentConfig(robot=arguments.robot)))
    stop = _stop_on_signals()
    try:
        runner.run(stop)
    except LinkError:
        if not stop.is_set():
            raise


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; return the exit status."""
    arguments = _parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    try:
        _run(arguments)
    except RevnmError as error:
        print(f"revnm-robot: {error}", file=sys.stderr)
        return 2
    return 0
