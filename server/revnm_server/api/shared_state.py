"""The state as JSON, made once for all who ask within a tenth of a second."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from pydantic import TypeAdapter

from revnm_server.service import NavigationService
from revnm_server.views.view import ServerView

PERIOD_S = 0.1


class SharedState:
    """What ``/state`` and ``/events`` tell. Thread-safe."""

    def __init__(self, service: NavigationService, *, now_s: Callable[[], float] = time.monotonic) -> None:
        """Tell the state of a service."""
        self._service, self._now_s = service, now_s
        self._adapter = TypeAdapter(ServerView)
        self._lock = threading.Lock()
        self._version = -1
        self._made_s = -PERIOD_S
        self._document = b""

    def document(self) -> bytes:
        """Return the state as JSON: at most 0.1 s old, and newer than the last goal, stop or order that was set."""
        with self._lock:
            version, now_s = self._service.mission.version, self._now_s()
            if version != self._version or now_s - self._made_s >= PERIOD_S:
                self._document = self._adapter.dump_json(self._service.view())
                self._version, self._made_s = version, now_s
            return self._document
