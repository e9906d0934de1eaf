"""``revnm-robot``: the command line. Each command is a module of :mod:`revnm_client.commands`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from revnm_client.exit_status import exit_status
from revnm_client.version_option import VersionAction

_HELP = {
    "bench": "measure the controller and the loop on this machine",
    "run": "follow the server's plans until Ctrl-C",
    "watch": "show a drive in this terminal, beside a client that runs",
    "doctor": "look at server, clock, LiDAR and odometry, and say what to mend",
    "config": "check a settings file, or print its schema",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its :func:`revnm_client.exit_status.exit_status`."""
    words = list(sys.argv[1:] if argv is None else argv)
    options = build_parser(words).parse_args(words)
    return exit_status("revnm-robot", lambda: int(options.run(options)))


def build_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser for a command line; only the options of the command that it names are there."""
    parser = argparse.ArgumentParser(prog="revnm-robot", description="ReVNM on the robot.")
    parser.add_argument("--version", action=VersionAction, const="revnm-client")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, text in _HELP.items():
        command = commands.add_parser(name, help=text, description=text)
        if words[:1] == [name]:
            module = import_module(f"revnm_client.commands.{name}")
            module.add_arguments(command)
            command.set_defaults(run=module.run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
