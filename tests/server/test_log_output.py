from __future__ import annotations

import json
import logging
import sys
from datetime import datetime

from revnm_server.log_output import log_formatter
from revnm_server.settings import LogSettings


def record(message: str, *values: object) -> logging.LogRecord:
    try:
        raise ValueError("grün")
    except ValueError:
        return logging.LogRecord("revnm.camera", logging.WARNING, "x.py", 1, message, values, sys.exc_info())


def test_lines_for_people() -> None:
    text = log_formatter(LogSettings()).format(record("lost %s", "it"))
    assert "WARNING revnm.camera: lost it\n" in text


def test_an_object_a_line_for_programs() -> None:
    text = log_formatter(LogSettings(format="json")).format(record('two\nlines, "%s"', "ü"))
    assert "\n" not in text
    document = json.loads(text)
    assert document["level"] == "WARNING"
    assert document["logger"] == "revnm.camera"
    assert document["message"] == 'two\nlines, "ü"'
    assert "ValueError: grün" in document["exc_info"]
    assert datetime.strptime(document["time"], "%Y-%m-%dT%H:%M:%S%z")
