"""The options of commands that need the robot's settings."""

from __future__ import annotations

import argparse
from pathlib import Path

from revnm_client.settings import RobotSettings, load_settings


def add_setting_options(parser: argparse.ArgumentParser) -> None:
    """Add the settings file, and options for what is set most often."""
    add = parser.add_argument
    add("--config", type=Path, metavar="FILE", help="settings, YAML")
    add("--robot", metavar="NAME", help="name of the robot, as the server knows it")
    add(
        "--connect",
        action="append",
        metavar="ENDPOINT",
        help="where the server is, tcp/HOST:PORT; may be repeated (without --config: tcp/127.0.0.1:7447)",
    )


def settings_of(options: argparse.Namespace) -> RobotSettings:
    """Return the settings that the options ask for.

    Raises:
        FileError: The settings file cannot be read.
        ConfigError: A value is wrong; the text says where it stands.
    """
    given = {"robot": options.robot, "server": options.connect}
    return load_settings(options.config, options={key: value for key, value in given.items() if value is not None})


def as_arguments(options: argparse.Namespace) -> list[str]:
    """Return the options as the words of a command line, for another command that shall have the same settings."""
    words = [] if options.config is None else ["--config", str(options.config)]
    words += [] if options.robot is None else ["--robot", options.robot]
    return words + [word for endpoint in options.connect or () for word in ("--connect", endpoint)]
