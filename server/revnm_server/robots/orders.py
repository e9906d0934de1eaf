"""Stops and resumes on their way to the robots: each is repeated until the robot has confirmed it.

A query is used because its reply is the acknowledgement. It blocks up to half a second, so nothing here may run
in the tick's thread or in an event loop.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import zenoh

from revnm_client import keys
from revnm_client.control_messages import StopReply, StopRequest, decode_stop_reply, encode_stop_request
from revnm_client.errors import MessageError
from revnm_server.robots.mission import Mission

logger = logging.getLogger(__name__)

ACKNOWLEDGE_S = 0.5
_TURN_S = 0.6
_REPEAT_S = 1.0
_MOST_SAID = 200
_NOBODY = b"Timeout"  # what Zenoh itself replies for who does not


class OrderCourier:
    """Delivers what the mission orders; :meth:`start` repeats what is unconfirmed once a second.

    Args:
        session: An open session.
        mission: Says what each robot is to be told, and is told what has been confirmed.
        on_confirmed: Is told which robot has just confirmed an order, from any thread.
    """

    def __init__(
        self,
        session: zenoh.Session,
        mission: Mission,
        on_confirmed: Callable[[str], None] = lambda robot: None,  # noqa: ARG005
    ) -> None:
        self._session = session
        self._mission = mission
        self._on_confirmed = on_confirmed
        self._one_at_a_time = {robot: threading.Lock() for robot in mission.names}
        self._rejected = dict.fromkeys(mission.names, 0)
        self._refusals = dict.fromkeys(mission.names, "")
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._repeat, name="orders", daemon=True)

    def start(self) -> None:
        """Begin to repeat unconfirmed orders."""
        self._thread.start()

    def close(self) -> None:
        """Stop repeating."""
        self._closing.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def rejected(self) -> dict[str, int]:
        """Number of malformed replies by key."""
        return {keys.stop(robot): count for robot, count in self._rejected.items()}

    def refusal(self, robot: str) -> str:
        """Return why the robot refuses what it was told last, in its words; empty where it does not."""
        return self._refusals[robot]

    def deliver(self, robot: str) -> bool:
        """Tell ``robot`` what is ordered now; return whether nothing is left unconfirmed.

        Blocks up to about a second, however many ask: each is a thread of the HTTP server, and those that wait
        for a silent robot must not use up the ones that stop another.
        """
        turn = self._one_at_a_time[robot]  # a late resume must not overtake a stop
        if not turn.acquire(timeout=_TURN_S):
            return False
        try:
            wanted = self._mission.of(robot)
            if wanted.order is None:
                return True
            if not self._ask(robot, wanted.order, wanted.epoch):
                return False
            self._on_confirmed(robot)
            self._mission.confirm(robot, wanted)
            return True
        finally:
            turn.release()

    def halt(self, robots: Iterable[str]) -> None:
        """Tell robots to stand because the server shuts down; returns after about a second at the latest."""
        halted = list(robots)
        if not halted:
            return
        with ThreadPoolExecutor(max_workers=len(halted), thread_name_prefix="halt") as pool:
            for robot, confirmed in zip(halted, pool.map(self._halt_one, halted), strict=True):
                logger.info("%s %s", robot, "stands" if confirmed else "has not confirmed that it stands")

    def _halt_one(self, robot: str) -> bool:
        epoch = self._mission.halt(robot).epoch
        with self._one_at_a_time[robot]:
            return self._ask(robot, "stop", epoch)

    def _repeat(self) -> None:
        while not self._closing.wait(_REPEAT_S):
            for robot in self._mission.names:
                if self._closing.is_set():
                    return
                try:
                    self.deliver(robot)
                except Exception:  # the order stays unconfirmed, the view says so, and it is tried again
                    logger.exception("%s could not be told what is ordered", robot)

    def _ask(self, robot: str, action: Literal["stop", "resume"], epoch: int) -> bool:
        """Return whether everyone who answers for ``robot`` has confirmed, and someone has."""
        key = keys.stop(robot)
        replies: list[StopReply | str | None] = []
        try:
            for reply in self._session.get(
                key,
                payload=encode_stop_request(StopRequest(action, epoch)),
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
                timeout=ACKNOWLEDGE_S,
            ):
                replies.append(self._decode(robot, reply))  # noqa: PERF401 - what came before an error counts
        except zenoh.ZError as error:
            logger.warning("%s: %s", key, error)
        self._refusals[robot] = next((reply for reply in replies if isinstance(reply, str)), "")
        return bool(replies) and all(
            isinstance(reply, StopReply) and reply.stopped is (action == "stop") and reply.epoch >= epoch
            for reply in replies
        )

    def _decode(self, robot: str, reply: zenoh.Reply) -> StopReply | str | None:
        """Return a reply; why it refuses, if it does; None where it is malformed or nobody is there."""
        if reply.err is not None and reply.err.payload.to_bytes() != _NOBODY:
            text = reply.err.payload.to_bytes()[:_MOST_SAID].decode(errors="replace")
            return "".join(each if each.isprintable() else "?" for each in text)
        if reply.ok is None:
            return None
        try:
            return decode_stop_reply(reply.ok.payload.to_bytes())
        except MessageError as error:
            self._rejected[robot] += 1
            logger.warning("reply on %s: %s", keys.stop(robot), error)
            return None
