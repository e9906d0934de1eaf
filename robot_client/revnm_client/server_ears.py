"""What the server and the robot's client say, for whoever only looks."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Self

import zenoh

from revnm_client import cdr, keys
from revnm_client.control_messages import decode_state
from revnm_client.json_payload import Scalar
from revnm_client.link import Inbox, LatestSubscriber
from revnm_client.messages import Plan


class ServerEars:
    """Hears plans and states; a context manager.

    Attributes:
        plans: The server's.
        states: Those of the client that runs on the robot.
    """

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        with ExitStack() as stack:
            plan = stack.enter_context(LatestSubscriber(session, keys.waypoints(robot)))
            state = stack.enter_context(LatestSubscriber(session, keys.state(robot)))
            self.plans: Inbox[Plan] = Inbox.with_attachment(plan, cdr.decode_plan)
            self.states: Inbox[dict[str, Scalar]] = Inbox(state, decode_state)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
