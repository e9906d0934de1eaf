"""Sets up the log of a server's process; nothing but a command's ``run`` may call it."""

from __future__ import annotations

import logging

import zenoh
from pythonjsonlogger.json import JsonFormatter

from revnm_server.settings.logs import LogSettings

_TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_FIELDS = {"asctime": "time", "levelname": "level", "name": "logger"}


def start_log(settings: LogSettings) -> None:
    """Write what this process logs to standard error; of Zenoh only warnings, unless RUST_LOG says otherwise."""
    handler = logging.StreamHandler()
    handler.setFormatter(log_formatter(settings))
    logging.basicConfig(level=settings.level.upper(), handlers=[handler])
    zenoh.init_log_from_env_or("warn")


def log_formatter(settings: LogSettings) -> logging.Formatter:
    """Return what writes a record: as a line, or as a JSON object with ``time``, ``level``, ``logger``, ``message``."""
    if settings.format == "text":
        return logging.Formatter(_TEXT)
    return JsonFormatter(_TEXT, rename_fields=_FIELDS, datefmt="%Y-%m-%dT%H:%M:%S%z", json_ensure_ascii=False)
