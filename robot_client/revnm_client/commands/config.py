"""``revnm-robot config``: look at settings without starting anything."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from revnm_client.errors import FileError
from revnm_client.exit_status import WRONG
from revnm_client.settings import BadSettingsError, load_settings
from revnm_client.settings.layout import ROOT
from revnm_client.settings.profiles import PROFILES


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    check = actions.add_parser("check", help="print what is in effect, or what is wrong: file, line, key, expected")
    check.add_argument("config", type=Path, metavar="FILE", help="settings, YAML")
    check.set_defaults(action=_check)
    schema = actions.add_parser("schema", help="print the JSON Schema of the settings file, for editors")
    schema.set_defaults(action=_schema)


def run(options: argparse.Namespace) -> int:
    """Do what is asked; return 0, or 2 where settings are wrong.

    Raises:
        RevnmError: A file cannot be read; the text says which and why.
    """
    return int(options.action(options))


def _check(options: argparse.Namespace) -> int:
    try:
        settings = load_settings(options.config)
    except BadSettingsError as error:
        print("\n".join(error.problems), file=sys.stderr)
        return WRONG
    from revnm_client.settings.assembly import agent_config  # pulls in the controller: after what could be wrong

    agent_config(settings)
    try:
        settings.security.credentials(settings.robot).zenoh_settings()
    except FileError as error:
        raise FileError(f"{options.config}: {error}") from error
    print(f"# {options.config}: good; in effect:\n{settings.as_yaml()}", end="")
    if settings.profile in PROFILES:
        print(f"# {settings.profile}: {PROFILES[settings.profile].source}")
    return 0


def _schema(_: argparse.Namespace) -> int:
    print(json.dumps(ROOT.schema(), indent=1))
    return 0
