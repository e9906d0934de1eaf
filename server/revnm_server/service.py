"""The server at work: newest frame → pipeline → plans, and what is known of every robot.

One thread ticks. It publishes nothing rather than something old: no running camera, a robot that was lost, a failed
model or a latched stop all mean no plan, and the view says which. On close it tells the robots it drives to
stand; the goals stay in the mission, so a restarted server tells them to go on.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import zenoh

from revnm_client.messages import Plan
from revnm_server.camera import CameraSource, CameraState
from revnm_server.frame import Frame, RobotSighting
from revnm_server.robots.mission import Goal, Mission, StoppedError
from revnm_server.robots.orders import OrderCourier
from revnm_server.robots.robot_link import RobotLink
from revnm_server.tick.pipeline import RobotPlan, TickResult
from revnm_server.tick.site_report import SiteReport
from revnm_server.tick.tick_memory import SeenTick, SentPlan, Tally, TickMemory
from revnm_server.tick.tick_recorder import ObservedTick, TickRecorder
from revnm_server.views.overview import Overview
from revnm_server.views.robot_overview import FOREIGN_STOP, holds_foreign_stop
from revnm_server.views.view import ServerView

logger = logging.getLogger(__name__)

MAX_PLAN_AGE_NS = 1_000_000_000
_WAIT_S = 0.1
_LAST_TICK_S = 5.0
_SEEN_LATELY_S = 1.0


class TickSource(Protocol):
    """Turns pictures into plans: ``Pipeline``, :class:`revnm_server.tick.map_pipeline.MapPipeline`, or a fake."""

    def step(self, frame: Frame, goals: Mapping[str, Goal]) -> TickResult:
        """Process one picture."""
        ...


class NavigationService:
    """Drives the mission's robots by one camera.

    Args:
        session: The router's session.
        camera: Where pictures come from; closed by the owner.
        pipeline: Turns pictures into plans.
        mission: What is wanted.
        tick_hz: Most ticks a second.
        tag_size_m: Side of the robots' tags, for drawing.
        robot_size_m: Length and width of a robot, for drawing.
        notes: Tells whoever looks what is odd about how it was put together; must not wait.
        recorder: Is shown every tick; closed by the owner.
        name: Of this server, for robots that hear several.
    """

    def __init__(
        self,
        session: zenoh.Session,
        *,
        camera: CameraSource,
        pipeline: TickSource,
        mission: Mission,
        tick_hz: float = 10.0,
        tag_size_m: float = 0.30,
        robot_size_m: tuple[float, float] = (0.43, 0.36),
        notes: Callable[[], Sequence[str]] = tuple,
        recorder: TickRecorder | None = None,
        name: str = "server",
    ) -> None:
        self.camera = camera
        self.mission = mission
        self.recorder = recorder
        self._pipeline = pipeline
        self._period_s = 1.0 / tick_hz
        self._name = name
        self._links = {robot: RobotLink(session, robot, server=self._name) for robot in mission.names}
        self._courier = OrderCourier(session, mission, lambda robot: self._links[robot].note_confirmed())
        self._ticks = TickMemory()
        self._overview = Overview(
            camera,
            mission,
            self._links,
            self._courier,
            self._ticks,
            tag_size_m=tag_size_m,
            robot_size_m=robot_size_m,
            notes=notes,
            recording=recorder.view if recorder is not None else None,
        )
        self._seen_s: dict[str, float] = {}
        self._publishing = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tick", daemon=True)

    def start(self) -> None:
        """Begin to tick."""
        self._courier.start()
        self._thread.start()

    @property
    def closing(self) -> bool:
        """Whether the service is shutting down."""
        return self._closing.is_set()

    def close(self) -> None:
        """Publish no more plans, tell every robot that has a goal and follows this server to stand, and leave the keys.

        A tick that hangs is left behind after some seconds: robots have been told by then.
        """
        with self._publishing:
            self._closing.set()
        self._courier.close()
        self._courier.halt(robot for robot in self.mission.driving_goals() if self._links[robot].followed is None)
        if self._thread.is_alive():
            self._thread.join(_LAST_TICK_S)
        for link in self._links.values():
            link.close()

    def set_goal(self, robot: str, u: float, v: float, *, size_px: tuple[int, int]) -> Goal:
        """Send ``robot`` to the pixel (u, v) of a picture of ``size_px`` = (width, height).

        Raises:
            UnknownRobotError: It is not configured.
            GoalError: The pixel is not finite or outside the picture.
            StoppedError: Its stop is latched, by this server or another.
        """
        if holds_foreign_stop(self.mission.of(robot), self._links[robot]):
            raise StoppedError(f"{robot}: {FOREIGN_STOP}")
        return self.mission.set_goal(robot, u, v, size_px=size_px)

    def stop(self, robot: str) -> bool:
        """Stop ``robot`` and drop its goal; return whether it has confirmed. Blocks up to about a second.

        Raises:
            UnknownRobotError: It is not configured.
        """
        self.mission.stop(robot)
        return self._courier.deliver(robot)

    def resume(self, robot: str) -> bool:
        """Release the stop of ``robot``; return whether it has confirmed. Blocks up to about a second.

        A goal from before somebody else's stop is dropped: it must not set off for that.

        Raises:
            UnknownRobotError: It is not configured.
        """
        if holds_foreign_stop(self.mission.of(robot), self._links[robot]):
            self.mission.drop_goal(robot)
        self.mission.resume(robot)
        return self._courier.deliver(robot)

    def view(self) -> ServerView:
        """Return what there is to show now; never waits for the tick, the network or the disk."""
        return self._overview.view()

    def ticking(self) -> bool:
        """Return whether a tick is at a picture."""
        return self._ticks.ticking()

    def hangs_s(self) -> float | None:
        """Return for how long the tick has been at one picture, where that is far too long, seconds."""
        return self._ticks.hangs_s()

    def tally(self) -> Tally:
        """Return what was counted since the start."""
        return self._ticks.tally()

    def site(self) -> SiteReport | None:
        """Return what the last tick left of the camera and its map; None before that, and where no map is made."""
        tick = self._ticks.tick()
        return tick.result.site if tick is not None else None

    def last_tick(self) -> SeenTick | None:
        """Return the last tick that worked, to be drawn; None before that."""
        return self._ticks.tick()

    def _run(self) -> None:
        seq = -1
        while not self._closing.is_set():
            frame = self.camera.wait_newer(seq, timeout_s=_WAIT_S)
            began_s = time.monotonic()
            self._ticks.note_begin()
            try:
                self._listen()
                if frame is not None:
                    seq = frame.seq
                    self._tick(frame)
            except Exception as error:  # no plan is sent and the view says why
                if self._ticks.note_fault(error):
                    logger.exception("tick failed: no plans are sent")
            finally:
                self._ticks.note_end()
            if frame is not None:
                self._closing.wait(began_s + self._period_s - time.monotonic())

    def _listen(self) -> None:
        """Hear the robots; tell a robot again that moves on though it was stopped."""
        for robot, link in self._links.items():
            if not link.listen() or link.state is None:
                continue
            if link.followed is None:
                self.mission.catch_up(robot, int(link.state["epoch"] or 0))
            else:  # who would overtake this one's epochs in turn
                self.mission.leave_to_another(robot)
            if self.mission.of(robot).stopped and link.stop_latched is False:
                self.mission.repeat_order(robot)
        self.camera.note_motion(self._driving_in_view())

    def _driving_in_view(self) -> str | None:
        """Return a robot that the camera saw lately and that says it drives."""
        lately_s = time.monotonic() - _SEEN_LATELY_S
        drivers = (robot for robot, seen_s in self._seen_s.items() if seen_s >= lately_s and self._links[robot].drives)
        return next(drivers, None)

    def _tick(self, frame: Frame) -> None:
        if self.camera.status().state is not CameraState.RUNNING:
            return
        goals = self.mission.driving_goals()
        result = self._step(frame, goals)
        if result.site is not None and result.site.standing is not None:
            self.camera.note_standing(result.site.standing)
        now_seen = {s.robot: s for s in result.sightings if s.robot in self._links}
        for robot, sighting in now_seen.items():
            if sighting.stamp_ns == frame.stamp_ns:
                self._seen_s[robot] = time.monotonic()
                u, v = (float(x) for x in sighting.pixel)
                self.mission.note_position(robot, (u, v), size_px=frame.size_px)
        routes = result.site.routes if result.site is not None else {}
        for robot, route in routes.items():
            if route.arrived:
                self.mission.note_arrival(robot, goals[robot].id)
        published: dict[str, SentPlan] = {}
        try:
            for plan in result.plans:
                sent = self._publish(plan, now_seen.get(plan.robot))
                if sent is not None:
                    published[plan.robot] = sent
        finally:
            if self.recorder is not None:
                self.recorder.observe(ObservedTick(frame, goals, result, frozenset(published)))
        self._ticks.note_tick(SeenTick(frame.stamp_ns, frame.size_px, result), published)

    def _step(self, frame: Frame, goals: Mapping[str, Goal]) -> TickResult:
        """Let the pipeline see a picture; a record has those, too, at which it failed."""
        try:
            return self._pipeline.step(frame, goals)
        except Exception:
            if self.recorder is not None:
                self.recorder.observe(ObservedTick(frame, goals, None, frozenset()))
            raise

    def _publish(self, plan: RobotPlan, sighting: RobotSighting | None) -> SentPlan | None:
        """Send a plan if it is still fresh and still wanted."""
        old = time.time_ns() - plan.stamp_ns > MAX_PLAN_AGE_NS
        if old or self.camera.status().state is not CameraState.RUNNING:
            return None
        with self._publishing:
            number = self.mission.number_plan(plan.robot, plan.goal_id)
            if number is None or self._closing.is_set():
                return None
            message = Plan(plan.stamp_ns, plan.waypoints_m, number.epoch, number.seq, plan.goal_id, self._name)
            self._links[plan.robot].publish(message)
        return SentPlan(time.monotonic(), plan.stamp_ns, plan.waypoints_m, sighting)
