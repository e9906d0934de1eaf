"""The server's ends of one robot's keys: plans out, state in, the clock on request."""

from __future__ import annotations

import hashlib
import logging
import math
import re
import socket
import time
import uuid
from collections.abc import Sequence
from typing import NamedTuple

import zenoh

from revnm_client import keys
from revnm_client.cdr import encode_attachment, encode_plan
from revnm_client.control_messages import (
    TimeReply,
    decode_state,
    decode_time_request,
    encode_time_reply,
)
from revnm_client.errors import MessageError
from revnm_client.json_payload import Scalar
from revnm_client.link import Inbox, LatestSubscriber, control_publisher
from revnm_client.messages import Plan

logger = logging.getLogger(__name__)

_NEWS_S = 1.0  # a robot says how it is twice a second
_SLOW_MPS, _SLOW_RADPS = 0.05, 0.1
_ON_THE_WAY_S = 0.3  # a state from before an order was confirmed may come in so much later


def server_name(listen: Sequence[str]) -> str:
    """Return the name of the server that listens there: the same after a restart, another's on each machine.

    Args:
        listen: Endpoints of its router, which no other server on this machine has.
    """
    machine = re.sub("[^A-Za-z0-9-]", "-", socket.gethostname())[:32]
    mark = hashlib.sha256(f"{uuid.getnode()} {' '.join(listen)}".encode()).hexdigest()[:4]
    return f"{machine}-{mark}"


class _News(NamedTuple):
    """A robot's state, and between which moments it came in; time.monotonic()."""

    state: dict[str, Scalar]
    after_s: float
    heard_s: float


class RobotLink:
    """Talks with one robot; hears it only when :meth:`listen` is called, by one thread.

    Attributes:
        robot: The robot's name.
        server: This server's name, which the robot compares.
    """

    def __init__(self, session: zenoh.Session, robot: str, *, server: str) -> None:
        self.robot = robot
        self.server = server
        self._news: _News | None = None
        self._listened_s = 0.0
        self._confirmed_s = -math.inf
        self._time_key = keys.time(robot)
        self._time_rejected = 0
        self._subscriber = LatestSubscriber(session, keys.state(robot))
        self._inbox = Inbox(self._subscriber, decode_state)
        self._publisher = control_publisher(session, keys.waypoints(robot))
        self._clock: zenoh.Queryable[None] = session.declare_queryable(self._time_key, self._tell_time)

    def listen(self) -> bool:
        """Take the newest state; return whether there was one."""
        before_s, self._listened_s = self._listened_s, time.monotonic()
        state = self._inbox.take()
        if state is None:
            return False
        self._news = _News(state, after_s=before_s, heard_s=time.monotonic())
        return True

    @property
    def state(self) -> dict[str, Scalar] | None:
        """What the robot last said of itself; None before that."""
        return self._news.state if self._news is not None else None

    @property
    def state_age_s(self) -> float | None:
        """Time since the robot was heard; None before that."""
        return time.monotonic() - self._news.heard_s if self._news is not None else None

    def note_confirmed(self) -> None:
        """Note that the robot has just confirmed an order: what it said of its stop before is out of date."""
        self._confirmed_s = time.monotonic()

    @property
    def stop_latched(self) -> bool | None:
        """Whether the robot says that its stop is latched; None where it has not said since its last order."""
        news = self._news
        if news is None or news.after_s <= self._confirmed_s + _ON_THE_WAY_S:
            return None
        return news.state["stopped"] is True

    @property
    def followed(self) -> str | None:
        """The other server that the robot says it follows; None where it follows this one, or none yet."""
        server = self.state.get("server") if self.state is not None else None
        return str(server) if server not in (None, self.server) else None

    @property
    def drives(self) -> bool:
        """Whether the robot says that it drives, faster than at a crawl where it says how fast."""
        if self.state is None or self.state["moving"] is not True or (self.state_age_s or 0.0) > _NEWS_S:
            return False
        speeds = self.state.get("v_mps"), self.state.get("w_radps")
        pairs = zip(speeds, (_SLOW_MPS, _SLOW_RADPS), strict=True)
        told = [(speed, slow) for speed, slow in pairs if isinstance(speed, int | float)]
        return not told or any(abs(speed) >= slow for speed, slow in told)

    @property
    def rejected(self) -> dict[str, int]:
        """Number of malformed payloads by key."""
        return {keys.state(self.robot): self._inbox.rejected, self._time_key: self._time_rejected}

    def publish(self, plan: Plan) -> None:
        """Send a plan; it is dropped rather than queued."""
        self._publisher.put(encode_plan(plan), attachment=encode_attachment(plan))

    def close(self) -> None:
        """Leave the keys."""
        self._clock.undeclare()  # type: ignore[no-untyped-call]
        self._publisher.undeclare()  # type: ignore[no-untyped-call]
        self._subscriber.close()

    def _tell_time(self, query: zenoh.Query) -> None:
        """Answer a request for the time; runs in Zenoh's thread, which swallows what is raised."""
        arrived_ns = time.time_ns()
        try:
            request = decode_time_request(query.payload.to_bytes() if query.payload is not None else b"")
            reply = TimeReply(request.t1_ns, arrived_ns, max(arrived_ns, time.time_ns()), self.server)
            query.reply(self._time_key, encode_time_reply(reply))
        except MessageError as error:
            self._time_rejected += 1
            query.reply_err(str(error).encode())
        except zenoh.ZError as error:
            logger.warning("%s: %s", self._time_key, error)
