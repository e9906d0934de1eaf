"""Asks the server for its time once a second, in a thread of its own: the control loop never waits.

Where several servers answer, by mistake, the first is the robot's: it is followed until it answers no more while
another does. A robot that took plans of both would go to and fro between two goals, by two clocks.
"""

from __future__ import annotations

import logging
import threading
import time
from typing import NamedTuple, Self

import zenoh

from revnm_client import keys
from revnm_client.clock import ClockOffset
from revnm_client.control_messages import TimeReply, TimeRequest, decode_time_reply, encode_time_request
from revnm_client.errors import MessageError

_log = logging.getLogger(__name__)

_PERIOD_S = 1.0
_FIRST_PERIOD_S = 0.1
_TIMEOUT_S = 0.5
_GIVE_UP_S = 5.0


class ProbeReading(NamedTuple):
    """What the probe knows.

    Attributes:
        offset_ns: Server's clock minus robot's clock; None while unknown.
        round_trip_ns: Of the exchange it comes from; None while unknown.
        server: The one that is followed; None while unknown.
        rejected: Number of malformed replies so far; a missing one is not malformed.
        last_error: Why the last one was; empty when none was.
        failures: Number of exchanges that ended in an unexpected error so far.
    """

    offset_ns: int | None
    round_trip_ns: int | None
    server: str | None
    rejected: int
    last_error: str
    failures: int


class _Exchange(NamedTuple):
    """A reply, and when it came, robot's wall clock."""

    reply: TimeReply
    t4_ns: int


class ClockProbe:
    """A thread that keeps a :class:`ClockOffset` up to date; a context manager."""

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        self._session = session
        self._key = keys.time(robot)
        self._lock = threading.Lock()
        self._offset = ClockOffset()
        self._server: str | None = None
        self._answered_s = 0.0
        self._missed = False
        self._rejected = 0
        self._last_error = ""
        self._failures = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="clock-probe", daemon=True)

    def reading(self) -> ProbeReading:
        """Return what is known now; never waits for the network."""
        with self._lock:
            offset = self._offset
            return ProbeReading(
                offset.offset_ns,
                offset.round_trip_ns,
                self._server,
                self._rejected,
                self._last_error,
                self._failures,
            )

    def forget(self) -> None:
        """Forget the offset: the robot's clock was set."""
        with self._lock:
            self._offset.forget()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=2.0 * _TIMEOUT_S)

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._ask()
            except Exception:  # the outermost loop of this thread: counted, and the next round tries again
                with self._lock:
                    self._failures += 1
                _log.exception("asking for the server's time failed")
            settled = self.reading().offset_ns is not None and not self._missed
            self._stop.wait(_PERIOD_S if settled else _FIRST_PERIOD_S)

    def _ask(self) -> None:
        t1_ns = time.time_ns()
        request = encode_time_request(TimeRequest(t1_ns))
        exchanges = []
        for reply in self._session.get(
            self._key,
            payload=request,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=_TIMEOUT_S,
        ):
            t4_ns = time.time_ns()
            try:
                if reply.ok is not None:  # else nobody answered in time
                    exchanges.append(_Exchange(_reply_to(t1_ns, reply.ok), t4_ns))
            except MessageError as error:
                with self._lock:
                    self._rejected += 1
                    self._last_error = f"{self._key}: {error}"
        with self._lock:
            self._take(exchanges)

    def _take(self, exchanges: list[_Exchange]) -> None:
        """Take the followed server's answer; where only others answer, for some seconds, follow the first of them."""
        if not exchanges:
            return
        now_s = time.monotonic()
        own = next((each for each in exchanges if each.reply.server == self._server), None)
        if own is None and (self._server is None or now_s - self._answered_s > _GIVE_UP_S):
            own = exchanges[0]
            if self._server is not None:
                _log.warning("server %s answers no more: following %s", self._server, own.reply.server)
            self._server = own.reply.server
            self._offset.forget()
        self._missed = own is None
        if own is not None:
            self._answered_s, times = now_s, own.reply
            self._offset.add(times.t1_ns, times.t2_ns, times.t3_ns, own.t4_ns)


def _reply_to(t1_ns: int, sample: zenoh.Sample) -> TimeReply:
    """Return the checked reply to the request that was sent at ``t1_ns``.

    Raises:
        MessageError: It is malformed, or to another request.
    """
    reply = decode_time_reply(sample.payload.to_bytes())
    if reply.t1_ns != t1_ns:
        raise MessageError(f"time reply is for {reply.t1_ns}: expected {t1_ns}")
    return reply
