"""``revnm-robot watch``: show a drive in this terminal. It only listens: any number may, on any machine."""

from __future__ import annotations

import argparse
import sys
import threading
from contextlib import ExitStack, closing

import zenoh

from revnm_client.commands.setting_options import add_setting_options, settings_of
from revnm_client.commands.signals import stop_on_signals
from revnm_client.errors import ConfigError, LinkError
from revnm_client.link import open_client
from revnm_client.log_output import start_log
from revnm_client.senses import KeySenses
from revnm_client.server_ears import ServerEars
from revnm_client.settings import LogSettings, RobotSettings
from revnm_client.watch import Screen, ViewKeeper, draw

_LISTEN_S = 0.05
_LISTENS_A_PICTURE = 4


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    add_setting_options(parser)


def run(options: argparse.Namespace) -> int:
    """Show until SIGINT or SIGTERM; return 0.

    Raises:
        RevnmError: The settings are wrong, or standard output is no terminal.
    """
    settings = settings_of(options)
    if not sys.stdout.isatty():
        raise ConfigError("watch: standard output is no terminal")
    start_log(LogSettings(level="warning"))
    stop = stop_on_signals()
    try:
        _show(settings, stop)
    except LinkError:
        if not stop.is_set():
            raise
    return 0


def _show(settings: RobotSettings, stop: threading.Event) -> None:
    own_router = settings.driver.options.get("connect") if settings.driver.kind == "zenoh" else None
    with ExitStack() as stack:
        credentials = settings.security.credentials(settings.robot)

        def opened(endpoints: tuple[str, ...]) -> zenoh.Session:
            return stack.enter_context(open_client(endpoints, credentials=credentials, stop=stop))

        server = opened(settings.server)
        nearest = server if own_router is None else opened(own_router)
        senses = stack.enter_context(closing(KeySenses.of(nearest, settings.robot)))
        ears = stack.enter_context(ServerEars(server, settings.robot))
        screen = stack.enter_context(Screen(sys.stdout))
        keeper = ViewKeeper(settings.robot)
        while not stop.is_set():
            for _ in range(_LISTENS_A_PICTURE):
                keeper.listen(senses, ears)
                stop.wait(_LISTEN_S)
            size = screen.size
            screen.show(draw(keeper.view(), size), size)
