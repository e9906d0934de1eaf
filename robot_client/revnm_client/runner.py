"""The live loop on the robot: messages in, :class:`RobotAgent`, velocity out, 20 times a second.

Everything that touches the network or reads a clock is here; everything that decides is in the agent. All
of it happens in one thread, so nothing is locked, except for the question for the server's time.
"""

from __future__ import annotations

import logging
import re
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Self

import zenoh

from revnm_client import cdr, keys
from revnm_client.agent import RobotAgent
from revnm_client.clock import ClockJump
from revnm_client.clock_probe import ClockProbe
from revnm_client.control_messages import StopReply, StopRequest, encode_state
from revnm_client.errors import MessageError
from revnm_client.json_payload import Scalar
from revnm_client.link import Inbox, LatestSubscriber, control_publisher, open_client
from revnm_client.messages import STANDSTILL, Odometry, Plan, Scan, Velocity
from revnm_client.pacing import Pacer
from revnm_client.stop_desk import StopDesk

_log = logging.getLogger(__name__)

_STALL_S = 0.2


@dataclass(frozen=True, slots=True)
class RunnerSettings:
    """Which robot, and where its server is.

    Attributes:
        robot: Name of the robot in the keys.
        connect: Endpoints of the router, such as ``tcp/192.168.1.5:7447``.
        period_s: Time between ticks.
        state_every: Ticks from one state message to the next.
    """

    robot: str
    connect: tuple[str, ...]
    period_s: float = 0.05
    state_every: int = 10

    def __post_init__(self) -> None:
        keys.check_name(self.robot)


class _Wires:
    """What the robot's client declares in its session; a context manager."""

    def __init__(self, session: zenoh.Session, robot: str) -> None:
        with ExitStack() as stack:
            scan = stack.enter_context(LatestSubscriber(session, keys.scan(robot)))
            odometry = stack.enter_context(LatestSubscriber(session, keys.odom(robot)))
            plan = stack.enter_context(LatestSubscriber(session, keys.waypoints(robot)))
            self.scans: Inbox[Scan] = Inbox(scan, cdr.decode_scan)
            self.odometry: Inbox[Odometry] = Inbox(odometry, cdr.decode_odometry)
            self.plans: Inbox[Plan] = Inbox.with_attachment(plan, cdr.decode_plan)
            self.velocity = stack.enter_context(control_publisher(session, keys.cmd_vel(robot)))
            self.state = stack.enter_context(control_publisher(session, keys.state(robot)))
            self.stop_desk = stack.enter_context(StopDesk(session, robot))
            self.probe = stack.enter_context(ClockProbe(session, robot))
            self._stack = stack.pop_all()

    @property
    def last_error(self) -> str:
        """Why a malformed message was dropped last, of one kind or another; empty when none was."""
        errors = [inbox.last_error for inbox in self.inboxes]
        errors += [self.stop_desk.last_error, self.probe.reading().last_error]
        return next((error for error in errors if error), "")[:200]

    @property
    def inboxes(self) -> tuple[Inbox[Scan], Inbox[Odometry], Inbox[Plan]]:
        return self.scans, self.odometry, self.plans

    @property
    def rejected(self) -> int:
        """Number of malformed messages of every kind."""
        return sum(inbox.rejected for inbox in self.inboxes) + self.stop_desk.rejected + self.probe.reading().rejected

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


class RobotRunner:
    """Runs the agent against a Zenoh router until told to stop.

    Attributes:
        commanded: The velocity that was last sent, or could not be sent, to the base.
        failures: Number of ticks that ended in an unexpected error; each one commanded standstill.
    """

    def __init__(self, settings: RunnerSettings, agent: RobotAgent) -> None:
        self.commanded: Velocity = STANDSTILL
        self.failures = 0
        self._settings = settings
        self._agent = agent
        self._jump = ClockJump()
        self._reason: str | None = "not started yet"
        self._reported_rejected = 0

    def run(self, stop: threading.Event) -> None:
        """Connect, drive until ``stop`` is set, then command standstill and disconnect.

        Raises:
            LinkError: ``stop`` was set before there was a connection.
        """
        with (
            open_client(self._settings.connect, stop=stop) as session,
            _Wires(session, self._settings.robot) as wires,
        ):
            try:
                self._loop(wires, stop)
            finally:
                self._send(wires, STANDSTILL)

    def _loop(self, wires: _Wires, stop: threading.Event) -> None:
        pacer = Pacer(self._settings.period_s, time.monotonic())
        due_s = time.monotonic()
        index = 0
        while not stop.is_set():
            begin_s = time.monotonic()
            if begin_s - due_s > _STALL_S:
                self._drop_unknown_age(wires, begin_s - due_s)
            self._tick(wires)
            if index % self._settings.state_every == 0:
                self._report(wires)
            index += 1
            end_s = time.monotonic()
            due_s = pacer.next_due_s(end_s)
            stop.wait(due_s - end_s)

    def _drop_unknown_age(self, wires: _Wires, late_s: float) -> None:
        """Empty the inboxes: nobody knows how long ago what lies there came in."""
        _log.warning("tick is %.2f s late", late_s)
        for inbox in wires.inboxes:
            inbox.take()

    def _tick(self, wires: _Wires) -> None:
        """Read, decide, send; whatever goes wrong, the base gets a velocity."""
        try:
            velocity, reason = self._decide(wires)
        except Exception as error:  # the outermost loop of this thread: counted, reported, and standstill
            self.failures += 1
            velocity, reason = STANDSTILL, f"tick failed: {error!r:.200}"
            if _condition(reason) != _condition(self._reason):
                _log.exception("tick failed")
        self._send(wires, velocity)
        if _condition(reason) != _condition(self._reason):
            _log.info("driving" if reason is None else f"stopped: {reason}")
        self._reason = reason

    def _decide(self, wires: _Wires) -> tuple[Velocity, str | None]:
        wires.stop_desk.serve(self._obey)
        now_ns = time.time_ns()
        if self._jump.check(now_ns, time.monotonic_ns()):
            _log.warning("the wall clock was set: the server's time is asked for anew")
            wires.probe.forget()
        reading = wires.probe.reading()
        self._agent.set_clock_offset(reading.offset_ns, round_trip_ns=reading.round_trip_ns)
        self._read(wires, now_ns)
        tick = self._agent.tick(now_ns)
        return tick.velocity, tick.reason

    def _read(self, wires: _Wires, now_ns: int) -> None:
        if (odometry := wires.odometry.take()) is not None:
            self._agent.on_odometry(odometry, now_ns)
        if (scan := wires.scans.take()) is not None:
            self._agent.on_scan(scan, now_ns)
        if (plan := wires.plans.take()) is not None:
            self._agent.on_plan(plan, now_ns)

    def _obey(self, request: StopRequest) -> StopReply:
        if request.action == "stop":
            self._agent.stop(request.epoch)
        elif request.epoch < self._agent.epoch:
            raise MessageError(f"resume of epoch {request.epoch}: expected {self._agent.epoch} or newer")
        else:
            self._agent.resume(request.epoch)
        _log.info("%s, epoch %d", request.action, request.epoch)
        return StopReply(stopped=self._agent.stopped, epoch=self._agent.epoch)

    def _send(self, wires: _Wires, velocity: Velocity) -> None:
        self.commanded = velocity
        try:
            wires.velocity.put(cdr.encode_velocity(velocity))
        except zenoh.ZError as error:
            self.failures += 1
            _log.warning("cannot send a velocity: %s", error)

    def _report(self, wires: _Wires) -> None:
        try:
            wires.state.put(encode_state(self._state(wires)))
        except Exception:  # the state is for display: the loop goes on without it
            self.failures += 1
            _log.exception("cannot send the state")

    def _state(self, wires: _Wires) -> dict[str, Scalar]:
        """Return the agent's state, corrected by what only the loop knows."""
        state: dict[str, Scalar] = self._agent.state(time.time_ns())
        malformed = wires.rejected
        if malformed > self._reported_rejected:
            _log.warning("%d malformed messages so far, the last: %s", malformed, wires.last_error)
            self._reported_rejected = malformed
        return {
            **state,
            "reason": self._reason,
            "moving": self.commanded != STANDSTILL,
            "v_mps": self.commanded.v_mps,
            "w_radps": self.commanded.w_radps,
            "malformed": malformed,
            "last_malformed": wires.last_error or None,
            "tick_failures": self.failures,
        }


def _condition(reason: str | None) -> str:
    """Return the reason without its numbers, so that a growing age is one condition and not many."""
    return "driving" if reason is None else re.sub(r"\d+(\.\d+)?", "#", reason)
