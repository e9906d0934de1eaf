"""``revnm-server``: the command line. Each command is a module of :mod:`revnm_server.commands`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

from revnm_client.exit_status import exit_status
from revnm_client.version_option import VersionAction

_HELP = {
    "serve": "watch a camera and drive the robots in its picture",
    "doctor": "look at camera, tags, models, tick and robots, and say what to mend",
    "health": "say by its exit status whether the server that runs with these settings works",
    "config": "check a settings file, or print its schema",
    "models": "list depth networks of others, and fetch one",
    "record": "switch a running server's record on and off, and mend records that were cut",
    "replay": "make the plans of a record again, and compare them",
    "bench": "measure what each stage of a tick takes",
    "pki": "make certificates, so that robots and server know each other",
    "tag": "make a PDF of tags to print and cut out",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; return its :func:`revnm_client.exit_status.exit_status`."""
    words = list(sys.argv[1:] if argv is None else argv)
    options = build_parser(words).parse_args(words)
    return exit_status("revnm-server", lambda: int(options.run(options)))


def build_parser(words: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser for a command line; only the options of the command that it names are there."""
    parser = argparse.ArgumentParser(
        prog="revnm-server", description="A camera on the wall guides robots without cameras."
    )
    parser.add_argument("--version", action=VersionAction, const="revnm-server")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, text in _HELP.items():
        command = commands.add_parser(name, help=text, description=text)
        if words[:1] == [name]:  # the imports of the others may take seconds
            module = import_module(f"revnm_server.commands.{name}")
            module.add_arguments(command)
            command.set_defaults(run=module.run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
