"""The options of commands that need the server's settings."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from revnm_client.errors import ConfigError
from revnm_server.settings import Settings, load_settings


def add_setting_options(parser: argparse.ArgumentParser) -> None:
    """Add the settings file, and options for what is set most often."""
    add = parser.add_argument
    add("--config", type=Path, metavar="FILE", help="settings, YAML")
    add(
        "--camera",
        metavar="URL",
        help="rtsp://…, v4l2:///dev/video0, file:///…?loop=1 or zenoh://NAME (zenoh://camera)",
    )
    add("--listen", action="append", metavar="ENDPOINT", help="Zenoh endpoint (tcp/127.0.0.1:7447)")
    add("--insecure-zenoh", action="store_true", help="let anyone who reaches the Zenoh endpoint command the robots")
    add("--http", metavar="HOST:PORT", help="address of page and API (127.0.0.1:8000)")
    add("--insecure-http", action="store_true", help="let anyone who reaches the HTTP address drive the robots")
    add("--robot", action="append", metavar="NAME=TAG", help="a robot and the id of its AprilTag (rover=0)")
    add("--bundle", type=Path, metavar="DIR", help="model bundle (the one that is shipped)")
    add("--planner", choices=("revnm", "bev"), help="the bundle's policy, or a search on the learnt map (revnm)")
    add(
        "--calibration-dir",
        type=Path,
        metavar="DIR",
        help="keeps what was learnt of the camera, and where robots are, over a restart (none)",
    )
    add("--state-file", type=Path, metavar="FILE", help="keeps goals and stops over a restart (none)")


def settings_of(options: argparse.Namespace) -> Settings:
    """Return the settings that the options ask for.

    Raises:
        FileError: The settings file cannot be read.
        ConfigError: A value is wrong; the text says where it stands.
    """
    return load_settings(options.config, overrides=_overrides(options))


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the command line sets, nested as in the settings file."""
    overrides: dict[str, Any] = {}
    if options.camera is not None:
        overrides["camera"] = {"url": options.camera}
    if options.listen:
        overrides["zenoh"] = {"listen": options.listen}
    if options.insecure_zenoh:
        overrides.setdefault("zenoh", {})["insecure"] = True
    if options.http is not None:
        overrides["http"] = _address(options.http)
    if options.insecure_http:
        overrides.setdefault("http", {})["insecure"] = True
    if options.robot:
        overrides["robots"] = dict(_robot(text) for text in options.robot)
    perception = {key: getattr(options, key) for key in ("bundle", "planner", "calibration_dir")}
    if given := {key: value for key, value in perception.items() if value is not None}:
        overrides["perception"] = given
    if options.state_file is not None:
        overrides["state_file"] = options.state_file
    return overrides


def _address(text: str) -> dict[str, Any]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdecimal():
        raise ConfigError(f"--http {text}: expected HOST:PORT, such as 127.0.0.1:8000")
    return {"host": host.removeprefix("[").removesuffix("]"), "port": int(port)}


def _robot(text: str) -> tuple[str, int]:
    name, _, tag = text.partition("=")
    if not tag.isdecimal():
        raise ConfigError(f"--robot {text}: expected NAME=TAG, such as rover=3")
    return name, int(tag)
