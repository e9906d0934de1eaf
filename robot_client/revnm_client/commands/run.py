"""``revnm-robot run``: follow the server's plans."""

from __future__ import annotations

import argparse
import logging
import signal
import threading

from revnm_client.agent import AgentConfig, RobotAgent
from revnm_client.errors import LinkError
from revnm_client.runner import RobotRunner, RunnerSettings

_DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--robot", required=True, metavar="NAME", help="name of the robot, as the server knows it")
    parser.add_argument(
        "--connect",
        action="append",
        metavar="ENDPOINT",
        help=f"where the server is, tcp/HOST:PORT; may be repeated (default: {_DEFAULT_ENDPOINT})",
    )


def run(options: argparse.Namespace) -> int:
    """Drive until SIGINT or SIGTERM; return 0.

    Raises:
        RevnmError: The settings are wrong; the text says what to mend.
    """
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    settings = RunnerSettings(robot=options.robot, connect=tuple(options.connect or [_DEFAULT_ENDPOINT]))
    runner = RobotRunner(settings, RobotAgent(AgentConfig(robot=options.robot)))
    stop = _stop_on_signals()
    try:
        runner.run(stop)
    except LinkError:
        if not stop.is_set():
            raise
    return 0


def _stop_on_signals() -> threading.Event:
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    return stop
