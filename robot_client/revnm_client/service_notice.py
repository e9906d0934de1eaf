"""Tells systemd how the client is (``sd_notify``): ready, alive, what it does, about to end.

Source: the man page sd_notify(3): datagrams of ``NAME=value`` lines to the socket that ``NOTIFY_SOCKET`` names.
"""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from contextlib import suppress

_WATCHDOG_S = 5.0
_EVERY_S = 1.0


class ServiceNotice:
    """Sends the notices; without a socket it does nothing. No call blocks or raises."""

    def __init__(self, address: str | None, clock_s: Callable[[], float] = time.monotonic) -> None:
        """Take the value of ``NOTIFY_SOCKET``; None where nobody listens."""
        self._address = None if not address else "\0" + address[1:] if address.startswith("@") else address
        self._clock_s = clock_s
        self._due_s: float | None = None

    def ready(self, status: str) -> None:
        """Say that the process works, and what it does now."""
        self._send("READY=1", f"STATUS={status}")

    def ticked(self, reason: str | None) -> None:
        """Say once a second that the control loop goes round; from the first time on, systemd ends one that hangs."""
        now_s = self._clock_s()
        if self._due_s is None:
            self._send(f"WATCHDOG_USEC={_WATCHDOG_S * 1e6:.0f}")
        elif now_s < self._due_s:
            return
        self._due_s = now_s + _EVERY_S
        self._send("WATCHDOG=1", f"STATUS={reason or 'driving'}")

    def stopping(self) -> None:
        """Say that the process is about to end."""
        self._send("STOPPING=1")

    def _send(self, *lines: str) -> None:
        if self._address is None:
            return
        text = "\n".join(line.replace("\n", " ") for line in lines)
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as outlet:
            outlet.sendto(text.encode(), self._address)
