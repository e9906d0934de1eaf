"""The live loop on the robot: messages in, :class:`RobotAgent`, velocity out, 20 times a second.

Everything that touches the network, the robot or a clock is here; everything that decides is in the agent. All
of it happens in one thread, so nothing is locked, except for the question for the server's time.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from revnm_client import keys
from revnm_client.agent import RobotAgent
from revnm_client.clock import ClockJump
from revnm_client.control_messages import StopReply, StopRequest
from revnm_client.credentials import Credentials
from revnm_client.drivers import DriverContext, RobotDriver, open_driver
from revnm_client.errors import MessageError
from revnm_client.json_payload import Scalar
from revnm_client.link import open_client
from revnm_client.messages import STANDSTILL, Velocity
from revnm_client.pacing import Pacer
from revnm_client.reason_log import ReasonLog
from revnm_client.server_link import ServerLink

_log = logging.getLogger(__name__)

_STALL_S = 0.2


@dataclass(frozen=True, slots=True)
class RunnerSettings:
    """Which robot, what carries it, and where its server is.

    Attributes:
        robot: Name of the robot in the keys.
        connect: Endpoints of the router, such as ``tcp/192.168.1.5:7447``.
        credentials: What that router asks for.
        driver: What :func:`revnm_client.drivers.open_driver` opens.
        driver_options: Of the driver.
        period_s: Time between ticks.
        state_every: Ticks from one state message to the next.
    """

    robot: str
    connect: tuple[str, ...]
    credentials: Credentials = field(default_factory=Credentials)
    driver: str = "zenoh"
    driver_options: Mapping[str, Any] = field(default_factory=dict)
    period_s: float = 0.05
    state_every: int = 10

    def __post_init__(self) -> None:
        keys.check_name(self.robot)


class _Ends(NamedTuple):
    """What the loop stands between."""

    driver: RobotDriver
    server: ServerLink


class RobotRunner:
    """Runs the agent between a robot and its server until told to stop.

    Attributes:
        commanded: The velocity that was last sent, or could not be sent, to the base.
        failures: Number of ticks that ended in an unexpected error; each one commanded standstill.
    """

    def __init__(
        self,
        settings: RunnerSettings,
        agent: RobotAgent,
        *,
        on_tick: Callable[[str | None], None] = lambda reason: None,  # noqa: ARG005
    ) -> None:
        """Create a runner.

        Args:
            settings: Which robot, what carries it, and where its server is.
            agent: Its brain.
            on_tick: Is told after every tick why the robot follows no plan, None while it does; must not block.
        """
        self.commanded: Velocity = STANDSTILL
        self.failures = 0
        self._settings = settings
        self._agent = agent
        self._on_tick = on_tick
        self._jump = ClockJump()
        self._reason: str | None = "not started yet"
        self._reasons = ReasonLog(self._reason)
        self._reported_rejected = 0

    def run(self, stop: threading.Event) -> None:
        """Connect, drive until ``stop`` is set, then command standstill and disconnect.

        Raises:
            ConfigError: There is no such driver, or it takes other options.
            FileError: A file of the credentials cannot be read.
            LinkError: ``stop`` was set before there was a connection, or the robot cannot be reached.
        """
        settings = self._settings
        with open_client(settings.connect, credentials=settings.credentials, stop=stop) as session:
            context = DriverContext(settings.robot, session, stop, settings.credentials)
            with (
                ServerLink(session, settings.robot) as server,
                closing(open_driver(settings.driver, settings.driver_options, context)) as driver,
            ):
                self._loop(_Ends(driver, server), stop)

    def _loop(self, ends: _Ends, stop: threading.Event) -> None:
        pacer = Pacer(self._settings.period_s, time.monotonic())
        due_s = time.monotonic()
        index = 0
        while not stop.is_set():
            begin_s = time.monotonic()
            self._tick(ends, late_s=begin_s - due_s)
            if index % self._settings.state_every == 0:
                self._report(ends)
            index += 1
            end_s = time.monotonic()
            due_s = pacer.next_due_s(end_s)
            stop.wait(due_s - end_s)

    def _drop_unknown_age(self, ends: _Ends, late_s: float) -> None:
        """Leave out what waits: nobody knows how long ago it came in."""
        _log.warning("tick is %.2f s late", late_s)
        ends.driver.take_scan()
        ends.driver.take_odometry()
        ends.server.plans.take()

    def _tick(self, ends: _Ends, late_s: float) -> None:
        """Read, decide, send; whatever goes wrong, the base gets a velocity."""
        failure: Exception | None = None
        try:
            if late_s > _STALL_S:
                self._drop_unknown_age(ends, late_s)
            velocity, reason = self._decide(ends)
        except Exception as error:  # the outermost loop of this thread: counted, reported, and standstill
            self.failures += 1
            velocity, reason, failure = STANDSTILL, f"tick failed: {error!r:.200}", error
        self._send(ends, velocity)
        self._reason = reason
        if self._reasons.due(reason):
            if failure is not None:
                _log.error("tick failed", exc_info=failure)
            self._tell_change(ends)
        self._reasons.keep(velocity)
        self._on_tick(reason)

    def _tell_change(self, ends: _Ends) -> None:
        try:
            self._reasons.write(self._reason, self.commanded, self._state(ends))
        except Exception:  # as for the state: the loop goes on without it
            self.failures += 1
            _log.exception("cannot tell why the robot stands")

    def _decide(self, ends: _Ends) -> tuple[Velocity, str | None]:
        ends.server.stop_desk.serve(self._obey)
        now_ns = time.time_ns()
        if self._jump.check(now_ns, time.monotonic_ns()):
            _log.warning("the wall clock was set: the server's time is asked for anew")
            ends.server.probe.forget()
        reading = ends.server.probe.reading()
        trouble = ends.driver.trouble()
        self._agent.set_trouble(None if trouble is None else str(trouble))
        self._agent.set_clock_offset(reading.offset_ns, round_trip_ns=reading.round_trip_ns, server=reading.server)
        self._read(ends, now_ns)
        tick = self._agent.tick(now_ns)
        return tick.velocity, tick.reason

    def _read(self, ends: _Ends, now_ns: int) -> None:
        driver, server = ends
        if (odometry := driver.take_odometry()) is not None:
            self._agent.on_odometry(odometry, now_ns)
            if not driver.shared:
                server.share_odometry(odometry)
        if (scan := driver.take_scan()) is not None:
            self._agent.on_scan(scan, now_ns)
            if not driver.shared:
                server.share_scan(scan)
        if (plan := server.plans.take()) is not None:
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

    def _send(self, ends: _Ends, velocity: Velocity) -> None:
        self.commanded = velocity
        try:
            ends.driver.drive(velocity)
        except Exception as error:  # of a driver from anywhere: the next tick tries again
            self.failures += 1
            _log.warning("cannot send a velocity: %s", error)

    def _report(self, ends: _Ends) -> None:
        try:
            ends.server.tell(self._state(ends))
        except Exception:  # the state is for display: the loop goes on without it
            self.failures += 1
            _log.exception("cannot send the state")

    def _state(self, ends: _Ends) -> dict[str, Scalar]:
        """Return the agent's state, corrected by what only the loop knows."""
        state: dict[str, Scalar] = self._agent.state(time.time_ns())
        malformed = ends.driver.rejected + ends.server.rejected
        last_error = (ends.driver.last_error or ends.server.last_error)[:200]
        if malformed >= max(1, 2 * self._reported_rejected):  # ever rarer: a broken sensor must not fill the log
            _log.warning("%d malformed messages so far, the last: %s", malformed, last_error)
            self._reported_rejected = malformed
        return {
            **state,
            "reason": self._reason,
            "moving": self.commanded != STANDSTILL,
            "v_mps": self.commanded.v_mps,
            "w_radps": self.commanded.w_radps,
            "malformed": malformed,
            "last_malformed": last_error or None,
            "tick_failures": self.failures,
        }
