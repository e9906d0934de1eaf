"""Zenoh as this project uses it: explicit endpoints, the newest message wins, nothing blocks.

The server's process is the router, robots and cameras are clients. An open session reconnects by itself and
brings its subscribers and publishers back; what is sent meanwhile is lost, on purpose. No message, however
malformed, gets past :class:`Inbox` undecoded, and liveliness is never used for safety.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, Self, TypeVar

import zenoh
from zenoh.handlers import Handler, RingChannel

from revnm_client.credentials import Credentials
from revnm_client.errors import ConfigError, LinkError, MessageError

_log = logging.getLogger(__name__)

LEASE_MS = 3000
OPEN_MS = 4000
MAX_MESSAGE_BYTES = 8 * 1024 * 1024
_WAITING = 16
_RETRY_FIRST_S = 0.2
_RETRY_LONGEST_S = 0.5

MessageT = TypeVar("MessageT")


def _config(mode: str, *, listen: Sequence[str], connect: Sequence[str], security: Mapping[str, Any]) -> zenoh.Config:
    """Return the settings of both ends; each side notices a dead link by the other's lease.

    An endpoint that does not answer is given up after ``OPEN_MS``, not Zenoh's ten seconds: the next may answer.
    """
    retry = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}
    settings = {
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/retry": retry,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "transport/shared_memory/enabled": False,
        "transport/unicast/open_timeout": OPEN_MS,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES,
        "adminspace/enabled": False,
        **security,
    }
    config = zenoh.Config()
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        endpoints = ", ".join([*listen, *connect])
        raise ConfigError(f"endpoints are {endpoints}: expected tcp/HOST:PORT or the like") from error
    return config


def _reason(error: zenoh.ZError) -> str:
    """Return what the error says without the places in Zenoh's own source."""
    return str(error).split(" at /", maxsplit=1)[0]


def open_router(listen: Sequence[str], *, security: Mapping[str, Any] | None = None) -> zenoh.Session:
    """Open the session to which the others connect.

    Args:
        listen: Endpoints such as ``tcp/127.0.0.1:7447``.
        security: Settings of Zenoh that say who may connect, and what they may do there; None: anybody, anything.

    Raises:
        ConfigError: An endpoint is malformed.
        LinkError: An endpoint is taken.
    """
    try:
        return zenoh.open(_config("router", listen=listen, connect=[], security=security or {}))
    except zenoh.ZError as error:
        raise LinkError(f"cannot listen on {', '.join(listen)}: {_reason(error)}") from error


def open_client(
    connect: Sequence[str], *, credentials: Credentials | None = None, stop: threading.Event | None = None
) -> zenoh.Session:
    """Open a session to a router; wait until there is one.

    Args:
        connect: Endpoints such as ``tcp/192.168.1.5:7447``; the first that answers is taken.
        credentials: What the router asks for; None where it lets in everybody.
        stop: Set it from another thread or a signal handler to give up.

    Raises:
        ConfigError: An endpoint is malformed.
        FileError: A file of the credentials cannot be read.
        LinkError: ``stop`` was set before a router answered.
    """
    stop = stop or threading.Event()
    security = credentials.zenoh_settings() if credentials is not None else {}
    config = _config("client", listen=[], connect=connect, security=security)
    endpoints = ", ".join(connect)
    delay_s = _RETRY_FIRST_S
    attempt = 0
    while not stop.is_set():
        try:
            session = zenoh.open(config)
        except zenoh.ZError as error:
            attempt += 1
            level = logging.WARNING if attempt == 1 else logging.DEBUG
            _log.log(level, "waiting for %s: %s (revnm-robot doctor may say more)", endpoints, _reason(error))
            stop.wait(delay_s)
            delay_s = min(2.0 * delay_s, _RETRY_LONGEST_S)
        else:
            _log.info("connected to %s", endpoints)
            return session
    raise LinkError(f"gave up connecting to {endpoints} after {attempt} attempts: stopped")


class LatestSubscriber:
    """Holds the few newest samples of a key; a slow consumer sees no old ones."""

    def __init__(self, session: zenoh.Session, key: str, *, waiting: int = _WAITING) -> None:
        self.key = key
        self._waiting = waiting
        self._subscriber: zenoh.Subscriber[Handler[zenoh.Sample]] = session.declare_subscriber(
            key, RingChannel(waiting)
        )

    def take(self) -> zenoh.Sample | None:
        """Return the newest sample that was not taken yet, or None; never blocks."""
        samples = self.drain()
        return samples[-1] if samples else None

    def drain(self) -> list[zenoh.Sample]:
        """Return the newest samples that were not taken yet, ``waiting`` at most, oldest first; never blocks."""
        samples: list[zenoh.Sample] = []
        while len(samples) < self._waiting and (sample := self._subscriber.try_recv()) is not None:
            samples.append(sample)
        return samples

    def close(self) -> None:
        """Stop receiving."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Inbox(Generic[MessageT]):
    """The newest sound message of a key; what cannot be decoded is counted and dropped, and displaces nothing.

    Attributes:
        rejected: Number of samples that were dropped.
        last_error: Why the last one was dropped; empty when none was.
    """

    def __init__(self, subscriber: LatestSubscriber, decode: Callable[[bytes], MessageT]) -> None:
        """Poll ``subscriber`` and decode with ``decode(payload)``, which raises nothing but MessageError."""
        self._subscriber = subscriber
        self._decode: Callable[[zenoh.Sample], MessageT] = lambda sample: decode(sample.payload.to_bytes())
        self.rejected = 0
        self.last_error = ""

    @classmethod
    def with_attachment(
        cls, subscriber: LatestSubscriber, decode: Callable[[bytes, bytes], MessageT]
    ) -> Inbox[MessageT]:
        """Return an inbox that decodes with ``decode(payload, attachment)``; a missing one is empty."""
        inbox = cls(subscriber, lambda payload: decode(payload, b""))
        inbox._decode = lambda sample: decode(
            sample.payload.to_bytes(), b"" if sample.attachment is None else sample.attachment.to_bytes()
        )
        return inbox

    def take(self) -> MessageT | None:
        """Return the newest sound message that was not taken yet, or None; never blocks, never raises."""
        messages = self.take_all()
        return messages[-1] if messages else None

    def take_all(self) -> list[MessageT]:
        """Return the sound messages that wait and were not taken yet, oldest first; never blocks, never raises."""
        messages = []
        for sample in self._subscriber.drain():
            try:
                messages.append(self._decode(sample))
            except MessageError as error:
                self.rejected += 1
                self.last_error = f"{self._subscriber.key}: {error}"
        return messages


def control_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Declare a publisher for small, urgent messages: sent at once, dropped rather than queued."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.INTERACTIVE_HIGH,
        express=True,
    )


def image_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Declare a publisher for pictures: they give way to everything else."""
    return session.declare_publisher(
        key, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.BACKGROUND
    )
