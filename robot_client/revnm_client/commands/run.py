"""``revnm-robot run``: follow the server's plans."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager

from revnm_client.agent import RobotAgent
from revnm_client.commands.setting_options import add_setting_options, as_arguments, settings_of
from revnm_client.commands.signals import stop_on_signals
from revnm_client.errors import ConfigError, LinkError
from revnm_client.log_output import HeldLog, start_log
from revnm_client.runner import RobotRunner
from revnm_client.service_notice import ServiceNotice
from revnm_client.settings import RobotSettings
from revnm_client.settings.assembly import agent_config, runner_settings

_END_S = 3.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    add_setting_options(parser)
    parser.add_argument(
        "--watch", action="store_true", help="show the drive in this terminal meanwhile, as revnm-robot watch does"
    )


def run(options: argparse.Namespace) -> int:
    """Drive until SIGINT or SIGTERM; return 0.

    Raises:
        RevnmError: The settings are wrong; the text says what to mend.
    """
    settings = settings_of(options)
    if options.watch and not sys.stdout.isatty():
        raise ConfigError("--watch: standard output is no terminal")
    stop = stop_on_signals()
    if not options.watch:
        start_log(settings.log)
        _drive(settings, stop)
        return 0
    with closing(HeldLog()) as held:
        start_log(settings.log, held if sys.stderr.isatty() else None)
        with _watched(as_arguments(options)):
            _drive(settings, stop)
    return 0


def _drive(settings: RobotSettings, stop: threading.Event) -> None:
    notice = ServiceNotice(os.environ.get("NOTIFY_SOCKET"))
    runner = RobotRunner(runner_settings(settings), RobotAgent(agent_config(settings)), on_tick=notice.ticked)
    notice.ready(f"waiting for {', '.join(settings.server)}")
    try:
        runner.run(stop)
    except LinkError:
        if not stop.is_set():
            raise
    finally:
        notice.stopping()


@contextmanager
def _watched(arguments: Sequence[str]) -> Iterator[None]:
    """Show the drive by a process of its own, which can neither delay nor end this one."""
    viewer = subprocess.Popen([sys.executable, "-m", "revnm_client.cli", "watch", *arguments])  # noqa: S603
    try:
        yield
    finally:
        viewer.terminate()
        try:
            viewer.wait(_END_S)
        except subprocess.TimeoutExpired:
            viewer.kill()
            viewer.wait()
