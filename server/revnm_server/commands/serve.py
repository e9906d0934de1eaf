"""``revnm-server serve``: watch a camera and drive the robots in its picture."""

from __future__ import annotations

import argparse
import logging
import signal
import threading

from revnm_server.commands.setting_options import add_setting_options, settings_of
from revnm_server.log_output import start_log

logger = logging.getLogger(__name__)

FAILED = 1
_LOOK_S = 0.5


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_setting_options(parser)


def run(options: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; return 0, or 1 where the page's server has ended by itself.

    Raises:
        RevnmError: The server cannot start; the text says what to mend.
    """
    settings = settings_of(options)
    start_log(settings.log)
    from revnm_server.app import running_server  # may compile for seconds: after what could be wrong with the settings

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with running_server(settings) as server:
        print(f"revnm-server: page at {server.url}", flush=True)
        while server.answers() and not stop.wait(_LOOK_S):
            pass
    if stop.is_set():
        return 0
    logger.error("the page is not served any more: ending, so that whoever watches starts the server again")
    return FAILED
