"""A pipeline and a robot that tests can steer, at the ports of the service."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Self

import numpy as np
import zenoh

from revnm_client import keys
from revnm_client.cdr import decode_plan, encode_image
from revnm_client.control_messages import StopReply, decode_stop_request, encode_state, encode_stop_reply
from revnm_client.geometry import FloatArray
from revnm_client.messages import CompressedImage, Plan
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.frame import Frame, RobotSighting
from revnm_server.robots.mission import Goal
from revnm_server.tick.pipeline import RobotPlan, TickResult
from revnm_server.tick.site_report import SiteReport

WAYPOINTS = np.array([[0.3, 0.0], [0.6, 0.0]])


class FakePipeline:
    """Sees each robot where it is told to, and plans straight ahead."""

    def __init__(self) -> None:
        self.pixels: dict[str, tuple[float, float]] = {"rover": (100.0, 100.0)}
        self.broken: str | None = None
        self.going_on = threading.Event()
        self.going_on.set()
        self.goals_seen: list[dict[str, Goal]] = []
        self.site: SiteReport | None = None

    def step(self, frame: Frame, goals: Mapping[str, Goal]) -> TickResult:
        self.going_on.wait()
        if self.broken is not None:
            raise RuntimeError(self.broken)
        self.goals_seen.append(dict(goals))
        sightings = tuple(sighting(robot, uv, frame.stamp_ns) for robot, uv in dict(self.pixels).items())
        plans = tuple(
            RobotPlan(s.robot, WAYPOINTS, frame.stamp_ns, goals[s.robot].id) for s in sightings if s.robot in goals
        )
        timings = {"depth": 1.0, "tag": 1.0, "exo2ego": 1.0, "policy": 1.0, "tick": 4.0}
        return TickResult(plans, sightings, np.zeros((4, 4), np.float32), {}, timings, self.site)


def sighting(robot: str, uv: tuple[float, float], stamp_ns: int, *, side_px: float = 30.0) -> RobotSighting:
    """A tag seen from straight above, the robot driving to the right."""
    half = side_px / 2
    corners: FloatArray = np.array([[half, -half], [half, half], [-half, half], [-half, -half]]) + uv
    return RobotSighting(robot, stamp_ns, np.array(uv), np.array([1.0, 0.0]), corners)


class CameraFeed:
    """Publishes pictures over Zenoh, 20 a second, from a thread."""

    def __init__(self, session: zenoh.Session, camera: str = "camera") -> None:
        self._session, self._key = session, keys.image(camera)
        self._jpeg = encode_jpeg(np.full((240, 320, 3), 90, dtype=np.uint8))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._stop.wait(0.05):
            self._session.put(self._key, encode_image(CompressedImage(time.time_ns(), "jpeg", self._jpeg)))

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


class RobotEnd:
    """The robot's ends of its keys: hears plans, confirms stops, says how it is."""

    def __init__(self, session: zenoh.Session, robot: str = "rover") -> None:
        self.robot = robot
        self.plans: list[Plan] = []
        self.orders: list[str] = []
        self.stopped, self.epoch = False, 0
        self._session = session
        self._subscriber = session.declare_subscriber(keys.waypoints(robot), self._hear)
        self._queryable = session.declare_queryable(keys.stop(robot), self._obey)

    def say(self, **changes: object) -> None:
        state = {"robot": self.robot, "moving": False, "reason": None, "stopped": self.stopped, "epoch": self.epoch}
        self._session.put(keys.state(self.robot), encode_state(state | changes))  # type: ignore[operator]

    def _hear(self, sample: zenoh.Sample) -> None:
        assert sample.attachment is not None
        self.plans.append(decode_plan(sample.payload.to_bytes(), sample.attachment.to_bytes()))

    def _obey(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        request = decode_stop_request(query.payload.to_bytes())
        self.stopped, self.epoch = request.action == "stop", max(self.epoch, request.epoch)
        self.orders.append(request.action)
        query.reply(keys.stop(self.robot), encode_stop_reply(StopReply(self.stopped, self.epoch)))

    def close(self) -> None:
        self._queryable.undeclare()
        self._subscriber.undeclare()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
