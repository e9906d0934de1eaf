"""Waits for measurements in a thread of its own, and keeps the newest."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import grpc

from revnm_client.errors import MessageError

_log = logging.getLogger(__name__)

_DEADLINE_S = 0.5
_PAUSE_FIRST_S = 0.05
_PAUSE_LONGEST_S = 1.0

MeasurementT = TypeVar("MeasurementT")


class LongPoll(Generic[MeasurementT]):
    """Asks for what is newer than the last, again and again; the robot answers when there is something.

    Attributes:
        rejected: How many measurements were dropped because they were malformed.
        last_error: Why the last one was; empty when none was.
    """

    def __init__(self, name: str, ask: Callable[[int, float], Any], read: Callable[[Any, int], MeasurementT]) -> None:
        """Start.

        Args:
            name: Of what is measured, for errors.
            ask: Called with a cursor and a deadline in seconds; returns a response or raises grpc.RpcError.
            read: Called with a response and when it came, this machine's clock, ns; raises MessageError.
        """
        self.rejected = 0
        self.last_error = ""
        self._name = name
        self._ask = ask
        self._read = read
        self._lock = threading.Lock()
        self._newest: MeasurementT | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"kachaka {name}")
        self._thread.start()

    def take(self) -> MeasurementT | None:
        """Return the newest sound measurement that was not taken yet, or None; never waits."""
        with self._lock:
            newest, self._newest = self._newest, None
            return newest

    def close(self) -> None:
        """Stop; takes no longer than the deadline of a call."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        cursor = last = 0
        pause_s = _PAUSE_FIRST_S
        while not self._stop.is_set():
            try:
                response = self._ask(cursor, _DEADLINE_S)
            except grpc.RpcError as error:
                cursor = 0  # a robot that was restarted counts anew
                late = error.code() is grpc.StatusCode.DEADLINE_EXCEEDED
                pause_s = _PAUSE_FIRST_S if late else min(2.0 * pause_s, _PAUSE_LONGEST_S)
                self._stop.wait(pause_s)
                continue
            pause_s = _PAUSE_FIRST_S
            cursor = response.metadata.cursor
            if cursor == last:
                self._stop.wait(pause_s)
                continue
            last = cursor
            self._keep(response, time.time_ns())

    def _keep(self, response: Any, received_ns: int) -> None:
        try:
            measurement = self._read(response, received_ns)
        except Exception as error:  # malformed (MessageError), or worse: the thread goes on
            if not isinstance(error, MessageError):
                _log.exception("cannot read a measurement")
            self.rejected += 1
            self.last_error = f"{self._name}: {error}"
            return
        with self._lock:
            self._newest = measurement
