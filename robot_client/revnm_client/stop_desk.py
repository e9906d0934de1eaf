"""Answers stop and resume: the reply is the acknowledgement that the robot holds, or is free again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Self

import zenoh
from zenoh.handlers import Handler, RingChannel

from revnm_client import keys
from revnm_client.control_messages import StopReply, StopRequest, decode_stop_request, encode_stop_reply
from revnm_client.errors import MessageError

_WAITING = 16


class StopDesk:
    """Holds the requests until the control loop asks for them; a context manager.

    Attributes:
        rejected: Number of malformed requests. Those, and sound ones that are refused, are answered with an error.
        last_error: Why the last one was; empty when none was.
    """

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        self.rejected = 0
        self.last_error = ""
        self._key = keys.stop(robot)
        self._queryable: zenoh.Queryable[Handler[zenoh.Query]] = session.declare_queryable(
            self._key, RingChannel(_WAITING)
        )

    def serve(self, obey: Callable[[StopRequest], StopReply]) -> None:
        """Answer the waiting requests; never blocks.

        Args:
            obey: Carries a request out and returns how things stand then; MessageError refuses it.
        """
        for _ in range(_WAITING):
            query = self._queryable.try_recv()
            if query is None:
                return
            with query:
                self._answer(query, obey)

    def _answer(self, query: zenoh.Query, obey: Callable[[StopRequest], StopReply]) -> None:
        payload = b"" if query.payload is None else query.payload.to_bytes()
        try:
            request = decode_stop_request(payload)
        except MessageError as error:
            self.rejected += 1
            self.last_error = f"{self._key}: {error}"
            query.reply_err(str(error))
            return
        try:
            reply = obey(request)
        except MessageError as error:
            query.reply_err(str(error))
        else:
            query.reply(self._key, encode_stop_reply(reply))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
