"""``revnm-server serve``: watch a camera and drive the robots in its picture."""

from __future__ import annotations

import argparse
import logging
import signal
import threading
from pathlib import Path
from typing import Any

import zenoh

from revnm_client.errors import ConfigError
from revnm_server.settings import load_settings


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add = parser.add_argument
    add("--config", type=Path, metavar="FILE", help="settings, YAML")
    add(
        "--camera",
        metavar="URL",
        help="rtsp://…, v4l2:///dev/video0, file:///…?loop=1 or zenoh://NAME (zenoh://camera)",
    )
    add("--listen", action="append", metavar="ENDPOINT", help="Zenoh endpoint (tcp/127.0.0.1:7447)")
    add("--http", metavar="HOST:PORT", help="address of page and API (127.0.0.1:8000)")
    add("--insecure-http", action="store_true", help="let anyone who reaches the HTTP address drive the robots")
    add("--robot", action="append", metavar="NAME=TAG", help="a robot and the id of its AprilTag (rover=0)")
    add("--bundle", type=Path, metavar="DIR", help="model bundle (the one that is shipped)")
    add("--planner", choices=("revnm", "bev"), help="the bundle's policy, or a search on the learnt map (revnm)")
    add("--calibration-dir", type=Path, metavar="DIR", help="keeps what bev learnt of the camera over a restart (none)")
    add("--state-file", type=Path, metavar="FILE", help="keeps goals and stops over a restart (none)")


def run(options: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; return 0.

    Raises:
        RevnmError: The server cannot start; the text says what to mend.
    """
    logging.basicConfig(format="%(asctime)s %(levelname)s %(name)s: %(message)s", level=logging.INFO)
    zenoh.init_log_from_env_or("warn")
    settings = load_settings(options.config, overrides=_overrides(options))
    from revnm_server.app import running_server  # may compile for seconds: after what could be wrong with the settings

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with running_server(settings) as server:
        print(f"revnm-server: page at {server.url}", flush=True)
        stop.wait()
    return 0


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the command line sets, nested as in the settings file."""
    overrides: dict[str, Any] = {}
    if options.camera is not None:
        overrides["camera"] = {"url": options.camera}
    if options.listen:
        overrides["zenoh"] = {"listen": options.listen}
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
