"""Finds the driver that the settings name, and opens it."""

from __future__ import annotations

import inspect
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, cast

import zenoh

from revnm_client.credentials import Credentials
from revnm_client.drivers.port import RobotDriver
from revnm_client.errors import ConfigError

BUILT_IN = {
    "zenoh": "revnm_client.drivers.zenoh_driver:ZenohDriver",
    "rmw_zenoh": "revnm_client.drivers.rmw_zenoh_driver:RmwZenohDriver",
    "kachaka": "revnm_client.drivers.kachaka.driver:KachakaDriver",
}


@dataclass(frozen=True, slots=True)
class DriverContext:
    """What every driver is given.

    Attributes:
        robot: Name of the robot in the keys.
        session: The session to the server.
        stop: Set when the client is told to stop: a driver that waits for its robot gives up.
        credentials: What a router on the robot may ask for; that of a bridge that logs in itself does.
    """

    robot: str
    session: zenoh.Session
    stop: threading.Event = field(default_factory=threading.Event)
    credentials: Credentials = field(default_factory=Credentials)


def open_driver(kind: str, options: Mapping[str, Any], context: DriverContext) -> RobotDriver:
    """Return the driver, open.

    Args:
        kind: One of ``BUILT_IN``, or ``package.module:Class``, which is called as ``Class(context, **options)``.
        options: Of the driver.
        context: What every driver is given.

    Raises:
        ConfigError: There is no such driver, or it takes other options.
        LinkError: The robot cannot be reached.
    """
    factory = _factory(kind)
    try:
        inspect.signature(factory).bind(context, **options)
    except TypeError as error:
        takes = [name for name in list(inspect.signature(factory).parameters)[1:] if name != "kwargs"]
        raise ConfigError(f"driver {kind}: {error}: expected options of {', '.join(takes) or 'nothing'}") from error
    return cast(RobotDriver, factory(context, **options))


def _factory(kind: str) -> Any:
    place = BUILT_IN.get(kind, kind)
    module, colon, name = place.partition(":")
    if not colon:
        raise ConfigError(f"driver {kind}: expected {', '.join(BUILT_IN)}, or package.module:Class of your own")
    try:
        return getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"driver {kind}: cannot be loaded: {error}") from error
