"""``revnm-server health``: whether the server with these settings works; what a container's health check runs."""

from __future__ import annotations

import argparse
import sys

from revnm_client.errors import LinkError
from revnm_server.api_client import ServerAddress, call
from revnm_server.commands.setting_options import add_setting_options, settings_of

SICK = 1
_WITHIN_S = 5.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_setting_options(parser)


def run(options: argparse.Namespace) -> int:
    """Ask ``/healthz`` as the settings say, by HTTPS or not; return 0, or 1 where the server should be started again.

    Raises:
        ConfigError: The settings are wrong.
    """
    settings = settings_of(options)
    try:
        call(ServerAddress.of(settings.http), "GET", "/healthz", within_s=_WITHIN_S)
    except LinkError as error:
        print(f"revnm-server: {error}", file=sys.stderr)
        return SICK
    return 0
