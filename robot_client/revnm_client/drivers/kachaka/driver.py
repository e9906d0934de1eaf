"""The driver for Kachaka: what the control loop sees of it."""

from __future__ import annotations

import re
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any

from revnm_client import cdr
from revnm_client.drivers.kachaka.api import PORT, KachakaApi
from revnm_client.drivers.kachaka.health import Health
from revnm_client.drivers.kachaka.long_poll import LongPoll
from revnm_client.drivers.kachaka.stamp_clock import StampClock
from revnm_client.drivers.kachaka.wheels import Wheels
from revnm_client.drivers.opening import DriverContext
from revnm_client.errors import ConfigError, MessageError
from revnm_client.messages import Odometry, Scan, Velocity

_ADDRESS = re.compile(r"[A-Za-z0-9._-]+(:\d{1,5})?")
_LATEST_NS = 2**62


class KachakaDriver:
    """A Kachaka in the local network, or the one on which this program runs.

    All of the waiting is done by threads, each call with a deadline of half a second or less; they connect again by
    themselves. Stamps are brought into the clock of this machine.

    Attributes:
        shared: The server does not hear a Kachaka: the client sends scans and odometry on.
    """

    def __init__(self, context: DriverContext, *, address: str) -> None:  # noqa: ARG002 the port's signature
        """Connect in the background.

        Args:
            context: Not used: neither its name nor the session to the server matters to a Kachaka.
            address: ``host`` or ``host:port``; on the robot itself 100.94.1.1.

        Raises:
            ConfigError: The address is malformed.
        """
        if not (isinstance(address, str) and _ADDRESS.fullmatch(address)):
            raise ConfigError(f"driver kachaka: address is {address!r}: expected host or host:port")
        self.shared = False
        self._clock = StampClock()
        with ExitStack() as stack:
            api = stack.enter_context(closing(KachakaApi(address if ":" in address else f"{address}:{PORT}")))
            self._health = stack.enter_context(closing(Health(api)))
            self._scans = stack.enter_context(closing(_poll(api, "GetRosLaserScan", self._read_scan)))
            self._odometry = stack.enter_context(closing(_poll(api, "GetRosOdometry", self._read_odometry)))
            self._wheels = stack.enter_context(closing(Wheels(api)))
            self._stack = stack.pop_all()

    @property
    def rejected(self) -> int:
        """Number of malformed scans and odometries."""
        return self._scans.rejected + self._odometry.rejected

    @property
    def last_error(self) -> str:
        """Why one of them was dropped last; empty when none was."""
        return self._scans.last_error or self._odometry.last_error

    def take_scan(self) -> Scan | None:
        """Return the newest sound scan that was not taken yet, or None."""
        return self._scans.take()

    def take_odometry(self) -> Odometry | None:
        """Return the newest sound odometry that was not taken yet, or None."""
        return self._odometry.take()

    def drive(self, velocity: Velocity) -> None:
        """Have a velocity sent, at most 0.3 m/s and 1.57 rad/s."""
        self._wheels.drive(velocity)

    def trouble(self) -> str | None:
        """Return why the robot would not obey: taken over by a person, its errors, no answer; None: all is well."""
        return self._wheels.trouble() or self._health.trouble()

    def close(self) -> None:
        """Command standstill, give manual control back, disconnect; takes some seconds where the robot hangs."""
        self._stack.close()

    def _read_scan(self, response: Any, received_ns: int) -> Scan:
        scan = cdr.scan_from(response.scan, stamp_ns=0)
        return replace(scan, stamp_ns=self._stamp_ns(response.scan, received_ns))

    def _read_odometry(self, response: Any, received_ns: int) -> Odometry:
        odometry = cdr.odometry_from(response.odometry, stamp_ns=0)
        return replace(odometry, stamp_ns=self._stamp_ns(response.odometry, received_ns))

    def _stamp_ns(self, message: Any, received_ns: int) -> int:
        """Return the stamp here; asked last, so that a malformed message does not spoil the clock."""
        stamp_ns = message.header.stamp_nsec
        if not 0 <= stamp_ns <= _LATEST_NS:
            raise MessageError(f"stamp is {stamp_ns} ns: expected 0 to {_LATEST_NS}")
        return self._clock.here_ns(stamp_ns, received_ns)


def _poll(api: KachakaApi, name: str, read: Any) -> LongPoll[Any]:
    return LongPoll(name, lambda cursor, timeout_s: api.get(name, cursor, timeout_s=timeout_s), read)
