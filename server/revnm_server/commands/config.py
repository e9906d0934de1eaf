"""``revnm-server config``: look at settings without starting anything."""

from __future__ import annotations

import argparse
import json
import sys
from datetime import UTC, datetime
from pathlib import Path

from revnm_client.credentials import readable
from revnm_client.errors import FileError
from revnm_client.exit_status import WRONG
from revnm_server.camera.url import redact
from revnm_server.networks.bundle import default_bundle_path
from revnm_server.networks.manifest import read_manifest
from revnm_server.robots.access import security_of
from revnm_server.settings import BadSettingsError, Settings, load_settings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    check = actions.add_parser(
        "check", help="say what is wrong with a settings file: file, line, key, what was expected"
    )
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
    read_manifest(settings.perception.bundle or default_bundle_path())
    try:
        _check_files(settings)
    except FileError as error:
        raise FileError(f"{options.config}: {error}") from error
    robots = ", ".join(f"{name} (tag {tag})" for name, tag in settings.robots.items())
    camera = settings.camera
    print(f"{options.config}: good: camera {camera.name} ({redact(camera.url)}) guides {robots}")
    return 0


def _check_files(settings: Settings) -> None:
    """Look whether the server can use its certificates and passwords.

    Raises:
        FileError: One cannot be read, or has ended.
    """
    security_of(settings)
    http = {"certificate": settings.http.certificate, "key": settings.http.key}
    for key, path in http.items():
        if path is not None:
            readable(path, key=f"http.{key}", maker="revnm-server pki")
    if settings.own_certificates:
        from revnm_server.pki import endings  # takes a tenth of a second

        for each in endings(settings.own_certificates, datetime.now(UTC)):
            if each.over:
                raise FileError(each.text)
            print(f"warning: {each.text}", file=sys.stderr)


def _schema(_: argparse.Namespace) -> int:
    print(json.dumps(Settings.model_json_schema(), indent=1))
    return 0
