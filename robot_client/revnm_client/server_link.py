"""What the robot's client exchanges with its server: plans, orders, time, state, and its senses where need be."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Self

import zenoh

from revnm_client import cdr, keys
from revnm_client.clock_probe import ClockProbe
from revnm_client.control_messages import encode_state
from revnm_client.json_payload import Scalar
from revnm_client.link import Inbox, LatestSubscriber, control_publisher
from revnm_client.messages import Odometry, Plan, Scan
from revnm_client.stop_desk import StopDesk


class ServerLink:
    """What the client declares in its session to the server; a context manager.

    Attributes:
        plans: The newest plan.
        stop_desk: Orders to stop and to go on.
        probe: Asks for the server's time.
    """

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        with ExitStack() as stack:
            plan = stack.enter_context(LatestSubscriber(session, keys.waypoints(robot)))
            self.plans: Inbox[Plan] = Inbox.with_attachment(plan, cdr.decode_plan)
            self._state = stack.enter_context(control_publisher(session, keys.state(robot)))
            self._scan = stack.enter_context(control_publisher(session, keys.scan(robot)))
            self._odometry = stack.enter_context(control_publisher(session, keys.odom(robot)))
            self.stop_desk = stack.enter_context(StopDesk(session, robot))
            self.probe = stack.enter_context(ClockProbe(session, robot))
            self._stack = stack.pop_all()

    @property
    def last_error(self) -> str:
        """Why a malformed message was dropped last, of one kind or another; empty when none was."""
        errors = (self.plans.last_error, self.stop_desk.last_error, self.probe.reading().last_error)
        return next((error for error in errors if error), "")

    @property
    def rejected(self) -> int:
        """Number of malformed messages of every kind."""
        return self.plans.rejected + self.stop_desk.rejected + self.probe.reading().rejected

    def tell(self, state: dict[str, Scalar]) -> None:
        """Publish the state.

        Raises:
            zenoh.ZError: The session is closed.
        """
        self._state.put(encode_state(state))

    def share_scan(self, scan: Scan) -> None:
        """Let the server hear a scan that reached this client by another way than Zenoh."""
        self._scan.put(cdr.encode_scan(scan))

    def share_odometry(self, odometry: Odometry) -> None:
        """Let the server hear odometry that reached this client by another way than Zenoh."""
        self._odometry.put(cdr.encode_odometry(odometry))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
