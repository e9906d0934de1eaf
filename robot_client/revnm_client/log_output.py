"""Sets up the log of a client's process; nothing but a command's ``run`` may call it."""

from __future__ import annotations

import json
import logging
import sys
from collections import deque
from datetime import datetime

from revnm_client.settings import LogSettings

_TEXT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_HELD = 200
_ORDINARY = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class JsonFormatter(logging.Formatter):
    """A JSON object a record: ``time``, ``level``, ``logger``, ``message``, ``exc_info``, and what it has besides."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the record as one line."""
        fields = {
            "time": datetime.fromtimestamp(record.created).astimezone().isoformat(timespec="milliseconds"),
            "level": record.levelname,
            "logger": record.name,
            "message": record.getMessage(),
            **{key: value for key, value in vars(record).items() if key not in _ORDINARY},
        }
        if record.exc_info:
            fields["exc_info"] = self.formatException(record.exc_info)
        return json.dumps(fields, ensure_ascii=False, default=str)


class HeldLog(logging.Handler):
    """Keeps the last 200 lines while a picture covers the terminal, and writes them when closed."""

    def __init__(self) -> None:
        super().__init__()
        self._lines: deque[str] = deque(maxlen=_HELD)

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a line."""
        self._lines.append(self.format(record))

    def close(self) -> None:
        """Write what was kept, to standard error."""
        while self._lines:
            print(self._lines.popleft(), file=sys.stderr)
        super().close()


def start_log(settings: LogSettings, handler: logging.Handler | None = None) -> None:
    """Write what this process logs to standard error, or give it to a handler."""
    handler = handler or logging.StreamHandler()
    handler.setFormatter(logging.Formatter(_TEXT) if settings.format == "text" else JsonFormatter())
    logging.basicConfig(level=settings.level.upper(), handlers=[handler])
