"""The service with the map pipeline: pictures and odometry over a real Zenoh session in, plans and the state out."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import ExitStack

import httpx
import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray
from tests.server.free_port import free_port
from tests.server.service_parts import RobotEnd
from tests.server.waiting import eventually

from revnm_client import keys
from revnm_client.cdr import encode_image, encode_odometry, encode_scan
from revnm_client.link import open_client, open_router
from revnm_client.messages import CompressedImage, Scan
from revnm_server.api import create_application
from revnm_server.api.live import live_router
from revnm_server.camera import open_camera
from revnm_server.camera.jpeg import decode_jpeg, encode_jpeg
from revnm_server.robots.mission import Mission
from revnm_server.robots.robot_senses import RobotSenses
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings
from revnm_server.tick.map_pipeline import MapPipeline

from .map_room import GOAL_M, HW, SHAPE, SIZE_PX, Room, pixel_of

STEP_M = 0.05


class Site:
    """A server, and a client that is camera and robot at once: it sends, and takes a step with each new plan."""

    def __init__(self, service: NavigationService, client: zenoh.Session, robot: RobotEnd, room: Room) -> None:
        self.service, self.room, self.robot = service, room, robot
        self._client, self._plans = client, 0
        self.says: dict[str, float] = {}
        self._jpeg = encode_jpeg(np.full((SIZE_PX[1], SIZE_PX[0], 3), 90, np.uint8))
        self._app = create_application(service, HttpSettings())

    def look(self) -> bool:
        """Send odometry, and then the picture of the same moment; drive with what came meanwhile."""
        stamp_ns = time.time_ns()
        self._client.put(keys.odom("rover"), encode_odometry(self.room.odometry(stamp_ns)))
        self._client.put(keys.image("camera"), encode_image(CompressedImage(stamp_ns, "jpeg", self._jpeg)))
        self.robot.say(**self.says)
        eventually(self._ticked(stamp_ns))
        if len(self.robot.plans) > self._plans:
            self._plans = len(self.robot.plans)
            self.room.drive(self.robot.plans[-1].waypoints_m, STEP_M)
        return True

    def scan(self) -> None:
        """Send a scan that hits something 2 m ahead."""
        ranges = np.full(360, np.inf, np.float32)
        ranges[0] = 2.0
        scan = Scan(time.time_ns(), 0.0, np.pi / 180.0, 0.1, 10.0, ranges)
        self._client.put(keys.scan("rover"), encode_scan(scan))

    def _ticked(self, stamp_ns: int):  # type: ignore[no-untyped-def]
        def seen() -> bool:
            report = self.service.site()
            return report is not None and report.stamp_ns >= stamp_ns

        return seen

    def state(self) -> dict:  # type: ignore[type-arg]
        async def get() -> httpx.Response:
            transport = httpx.ASGITransport(self._app)
            async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1:8000") as client:
                return await client.get("/api/v1/state")

        return dict(asyncio.run(get()).json())

    def first_of_stream(self, layer: str) -> NDArray[np.uint8]:
        """The first picture of a stream that does not end."""

        async def first() -> bytes:
            router = live_router(self.service)
            endpoint = next(route.endpoint for route in router.routes if route.path.endswith("stream.mjpg"))  # type: ignore[attr-defined]
            response = await endpoint(layer=layer)
            return bytes(await anext(aiter(response.body_iterator)))

        part = asyncio.run(first())
        return decode_jpeg(part[part.index(b"\r\n\r\n") + 4 : -2])

    def rover(self) -> dict:  # type: ignore[type-arg]
        return dict(self.state()["robots"][0])


@pytest.fixture
def site() -> Iterator[Site]:
    endpoint, room = f"tcp/127.0.0.1:{free_port()}", Room()
    with ExitStack() as stack:
        router = stack.enter_context(open_router([endpoint]))
        client = stack.enter_context(open_client([endpoint]))
        camera = open_camera("zenoh://camera", router)
        stack.callback(camera.close)
        senses = RobotSenses(router, "rover")
        stack.callback(senses.close)
        pipeline = MapPipeline(depth=room, disparity_hw=HW, tags=room, senses={"rover": senses}, shape=SHAPE)
        mission = Mission(["rover"])
        service = NavigationService(
            router, camera=camera, pipeline=pipeline, mission=mission, tick_hz=60, notes=lambda: ["a note"]
        )
        stack.callback(service.close)
        robot = stack.enter_context(RobotEnd(client))
        service.start()
        room.odometry(0)
        eventually(lambda: client.put(keys.odom("rover"), b"?") or (senses.listen() and senses.rejected["rover/odom"]))
        yield Site(service, client, robot, room)


def test_a_goal_is_reached_with_a_camera_that_nobody_calibrated(site: Site) -> None:
    site.look()
    calibration = site.state()["camera"]["calibration"]
    assert calibration["spread_2_m_cm"] is None or calibration["spread_2_m_cm"] > 0.0
    u, v = pixel_of(*GOAL_M)
    site.service.mission.set_goal("rover", u, v, size_px=SIZE_PX)
    eventually(lambda: site.look() and "learning the camera" in str(site.rover()["reason"]), within_s=20.0)
    driving = eventually(
        lambda: site.look() and site.state()["camera"]["calibration"]["status"] == "good" and site.rover(),
        within_s=30.0,
    )
    assert driving["status"] == "driving"
    assert len(driving["path_px"]) >= 2
    state = site.state()
    assert state["camera"]["calibration"]["progress"] == 1.0
    assert 0.0 < state["camera"]["calibration"]["spread_1_m_cm"] <= state["camera"]["calibration"]["spread_2_m_cm"]
    assert state["camera"]["calibration"]["event"] is None
    assert abs(state["camera"]["calibration"]["camera"]["height_m"] - 2.6) < 0.3
    assert site.first_of_stream("depth").shape == (480, 640, 3)
    assert state["robot_size_m"] == [0.43, 0.36]
    assert state["rejected"]["rover/odom"] >= 1
    assert state["warnings"] == ["a note"]
    assert set(state["timings_ms"]) == {"depth", "tag", "map", "tick", "learn"}
    picture = site.first_of_stream("map")
    assert picture.shape[2] == 3
    assert picture.shape != (480, 640, 3)
    eventually(lambda: site.look() and site.rover()["status"] == "arrived", within_s=60.0)
    assert site.room.distance_m() < 0.4


def test_a_robot_without_odometry_waits_and_the_state_says_why(site: Site) -> None:
    site.look()
    assert site.rover()["scan"] is None
    site.scan()
    assert eventually(lambda: site.look() and site.rover()["scan"])["points_m"] == [[2.0, 0.0]]
    u, v = pixel_of(*GOAL_M)
    site.service.mission.set_goal("rover", u, v, size_px=SIZE_PX)
    eventually(lambda: site.look() and site.robot.plans)
    # From now on its odometry is stamped an hour ahead.
    site.says["clock_offset_ms"] = 3_600_000.0
    count = len(site.robot.plans)
    eventually(lambda: site.look() and site.rover()["status"] == "waiting", within_s=20.0)
    assert site.rover()["reason"] == "the server hears no odometry of the robot"
    assert site.state()["rejected"]["rover/odom"] > 1
    assert len(site.robot.plans) <= count + 40
