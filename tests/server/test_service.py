from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import zenoh

from revnm_client import keys
from revnm_client.control_messages import TimeRequest, decode_time_reply, encode_time_request
from revnm_client.link import open_client
from revnm_server.camera import CameraSource, open_camera
from revnm_server.frame import RobotSighting
from revnm_server.mapping.tag_plane import path_in_picture
from revnm_server.robots.mission import Mission, StoppedError
from revnm_server.service import NavigationService
from revnm_server.views.view import RobotView

from .service_parts import WAYPOINTS, CameraFeed, FakePipeline, RobotEnd
from .waiting import eventually

SIZE = (320, 240)
StartService = Callable[..., NavigationService]


@pytest.fixture
def client(router: zenoh.Session, endpoint: str) -> Iterator[zenoh.Session]:
    with open_client([endpoint]) as session:
        yield session


@pytest.fixture
def pipeline() -> FakePipeline:
    return FakePipeline()


@pytest.fixture
def camera(router: zenoh.Session) -> Iterator[CameraSource]:
    source = open_camera("zenoh://camera", router)
    yield source
    source.close()


@pytest.fixture
def mission(tmp_path: Path) -> Mission:
    return Mission(["rover"], state_file=tmp_path / "state.json")


@pytest.fixture
def service(
    router: zenoh.Session, camera: CameraSource, pipeline: FakePipeline, mission: Mission
) -> Iterator[NavigationService]:
    running = NavigationService(router, camera=camera, pipeline=pipeline, mission=mission, tick_hz=50)
    running.start()
    yield running
    if not running.closing:
        running.close()


def rover(service: NavigationService) -> RobotView:
    return service.view().robots[0]


def test_a_goal_becomes_plans(service: NavigationService, client: zenoh.Session) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: service.view().camera.state == "running")
        assert rover(service).status == "no_goal"
        goal = service.mission.set_goal("rover", 300, 50, size_px=SIZE)
        eventually(lambda: len(robot.plans) >= 3)
        assert (rover(service).status, rover(service).reason) == ("waiting", "the robot has not been heard yet")
        eventually(lambda: robot.say() or rover(service).status == "driving")
        eventually(lambda: robot.say(round_trip_ms=1.5, clock_offset_ms=True) or rover(service).round_trip_ms)
        shown = rover(service)
        ticked = service.last_tick()
    plans = robot.plans
    assert {plan.goal_id for plan in plans} == {goal.id}
    assert {plan.epoch for plan in plans} == {service.mission.of("rover").epoch}
    assert [plan.seq for plan in plans] == list(range(plans[0].seq, plans[0].seq + len(plans)))
    assert np.allclose(plans[0].waypoints_m, WAYPOINTS)
    assert abs(plans[-1].stamp_ns - time.time_ns()) < 5_000_000_000
    # A tag of 0.30 m is 30 px wide, the robot looks right: 0.3 m ahead is 30 px to the right.
    assert shown.path_px == [(130.0, 100.0), (160.0, 100.0)]
    assert (shown.pixel, shown.heading, shown.goal and shown.goal.u) == ((100.0, 100.0), (1.0, 0.0), 300.0)
    assert service.view().timings_ms["tick"].p50 == 4.0
    assert (shown.round_trip_ms, shown.clock_offset_ms, shown.scan) == (1.5, None, None)
    assert shown.picture_to_plan_ms is not None
    assert shown.plan_age_s is not None
    assert 0.0 <= shown.picture_to_plan_ms.p50 <= shown.picture_to_plan_ms.p95 < 5000.0
    assert 0.0 <= shown.plan_age_s < 5.0
    assert ticked is not None
    assert (ticked.size_px, ticked.result.disparity.shape) == (SIZE, (4, 4))


def test_a_robot_that_falls_silent_is_not_said_to_drive(service: NavigationService, client: zenoh.Session) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: service.camera.latest())
        service.mission.set_goal("rover", 300, 50, size_px=SIZE)
        eventually(lambda: robot.say(moving=True) or rover(service).status == "driving")
        eventually(lambda: rover(service).status == "waiting", within_s=5.0)
        shown, count = rover(service), len(robot.plans)
        assert shown.reason is not None
        assert shown.reason.startswith("the robot was heard 2.")
        assert shown.path_px == []
        eventually(lambda: len(robot.plans) > count)  # it may well hear what is sent to it
        eventually(lambda: robot.say(moving=True) or rover(service).status == "driving")


def test_a_stale_camera_gives_no_plan(service: NavigationService, client: zenoh.Session) -> None:
    with RobotEnd(client) as robot:
        with CameraFeed(client):
            eventually(lambda: service.camera.latest())
            service.mission.set_goal("rover", 300, 50, size_px=SIZE)
            eventually(lambda: robot.say() or rover(service).status == "driving")
        eventually(lambda: rover(service).status == "waiting")
        count = len(robot.plans)
        eventually(lambda: service.view().camera.state == "stale")
        assert "camera stale: no new picture" in str(rover(service).reason)
        assert any("camera stale" in reason for reason in service.view().reasons)
        assert len(robot.plans) == count


def test_a_failed_model_gives_no_plan_and_is_told(
    service: NavigationService, pipeline: FakePipeline, client: zenoh.Session
) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: service.camera.latest())
        service.mission.set_goal("rover", 300, 50, size_px=SIZE)
        eventually(lambda: robot.say() or rover(service).status == "driving")
        pipeline.broken = "the network gave NaN"
        eventually(lambda: any("the network gave NaN" in reason for reason in service.view().reasons))
        eventually(lambda: rover(service).status == "waiting")
        assert "the network gave NaN" in str(rover(service).reason)
        count = len(robot.plans)
        pipeline.broken = None
        eventually(lambda: len(robot.plans) > count)
        assert not any("NaN" in reason for reason in service.view().reasons)


def test_a_lost_tag_gives_no_plan_and_is_told(
    service: NavigationService, pipeline: FakePipeline, client: zenoh.Session
) -> None:
    pipeline.pixels.clear()
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: service.camera.latest())
        service.mission.set_goal("rover", 300, 50, size_px=SIZE)
        eventually(lambda: pipeline.goals_seen and pipeline.goals_seen[-1])
        assert rover(service).status == "waiting"
        assert rover(service).reason == "the robot's tag has not been seen yet"
        assert robot.plans == []


def test_stop_is_acknowledged_and_resume_too(service: NavigationService, client: zenoh.Session) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: service.camera.latest())
        goal = service.mission.set_goal("rover", 300, 50, size_px=SIZE)
        eventually(lambda: robot.plans)
        assert service.stop("rover") is True
        assert robot.stopped
        assert robot.epoch == service.mission.of("rover").epoch > robot.plans[-1].epoch
        assert (rover(service).status, rover(service).goal) == ("stopped", None)
        count = len(robot.plans)
        assert service.resume("rover") is True
        assert not robot.stopped
        assert rover(service).status == "no_goal"
        service.mission.set_goal("rover", 300, 50, size_px=SIZE)
        eventually(lambda: len(robot.plans) > count)
        assert robot.plans[-1].goal_id != goal.id
        assert robot.plans[-1].epoch == robot.epoch


def test_a_stop_nobody_confirms_is_repeated_until_somebody_does(
    service: NavigationService, client: zenoh.Session
) -> None:
    assert service.stop("rover") is False
    assert rover(service).reason == "the robot has not confirmed the stop"
    with RobotEnd(client) as robot:
        eventually(lambda: robot.stopped)
        eventually(lambda: rover(service).reason is None)
        # The robot starts anew and knows nothing of a stop: it is told again.
        robot.stopped = False
        eventually(lambda: robot.stopped or robot.say(epoch=0))


def test_a_liar_confirms_nothing(service: NavigationService, router: zenoh.Session, client: zenoh.Session) -> None:
    for reply in (b'{"stopped":false,"epoch":99}', b"\xff garbage", b'{"stopped":true,"epoch":0}'):
        queryable = client.declare_queryable(
            keys.stop("rover"), lambda query, reply=reply: query.reply(keys.stop("rover"), reply)
        )
        eventually(lambda: [r for r in router.get(keys.stop("rover"), timeout=1.0) if r.ok])  # the router knows it
        assert service.stop("rover") is False
        queryable.undeclare()
    assert service.view().rejected[keys.stop("rover")] >= 1


def test_arrival_ends_the_plans(service: NavigationService, pipeline: FakePipeline, client: zenoh.Session) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: service.camera.latest())
        service.mission.set_goal("rover", 200, 100, size_px=SIZE)
        eventually(lambda: robot.plans)
        pipeline.pixels["rover"] = (191.0, 100.0)  # 9 px, of 10 px in a picture 320 wide
        eventually(lambda: rover(service).status == "arrived")
        ticks, count = len(pipeline.goals_seen), len(robot.plans)
        eventually(lambda: len(pipeline.goals_seen) > ticks + 3)
        assert len(robot.plans) == count
        assert pipeline.goals_seen[-1] == {}


def test_garbage_is_counted_and_changes_nothing(service: NavigationService, client: zenoh.Session) -> None:
    with RobotEnd(client) as robot:
        robot.say(v_mps=0.4)
        eventually(lambda: rover(service).robot_state)
        before = rover(service).robot_state
        hostile = [
            b"",
            b"\x00" * 100,
            b"{",
            b'{"robot":1}',
            b"[" * 4000,
            json.dumps({"x": 1e400}).encode(),
            b"1" * 9999,
        ]
        for count, payload in enumerate(hostile, start=1):
            client.put(keys.state("rover"), payload)
            eventually(lambda count=count: service.view().rejected[keys.state("rover")] == count)
        assert rover(service).robot_state == before
        assert before is not None
        assert before["v_mps"] == 0.4


def test_the_time_is_told(service: NavigationService, client: zenoh.Session) -> None:
    before_ns = time.time_ns()
    payload = encode_time_request(TimeRequest(123))
    replies = eventually(lambda: [r for r in client.get(keys.time("rover"), payload=payload, timeout=1.0) if r.ok])
    reply = decode_time_reply(replies[0].ok.payload.to_bytes())  # type: ignore[union-attr]
    assert reply.t1_ns == 123
    assert before_ns <= reply.t2_ns <= reply.t3_ns <= time.time_ns()
    errors = [reply.err for reply in client.get(keys.time("rover"), payload=b"what time is it", timeout=1.0)]
    assert errors[0] is not None
    assert service.view().rejected[keys.time("rover")] == 1


def test_on_close_the_robot_is_told_to_stand_and_after_the_restart_to_go_on(
    service: NavigationService,
    router: zenoh.Session,
    camera: CameraSource,
    pipeline: FakePipeline,
    client: zenoh.Session,
    tmp_path: Path,
) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: service.camera.latest())
        goal = service.mission.set_goal("rover", 300, 50, size_px=SIZE)
        eventually(lambda: robot.plans)
        service.close()
        assert robot.stopped
        assert robot.epoch > robot.plans[-1].epoch
        count = len(robot.plans)
        mission = Mission(["rover"], state_file=tmp_path / "state.json")
        again = NavigationService(router, camera=camera, pipeline=pipeline, mission=mission)
        try:
            again.start()
            eventually(lambda: not robot.stopped)
            eventually(lambda: len(robot.plans) > count)
            assert robot.plans[-1].goal_id == goal.id
            assert robot.plans[-1].epoch >= robot.epoch
        finally:
            again.close()


def test_robots_are_told_to_stand_though_the_tick_hangs(
    router: zenoh.Session, camera: CameraSource, pipeline: FakePipeline, client: zenoh.Session
) -> None:
    mission = Mission(["rover"])
    service = NavigationService(router, camera=camera, pipeline=pipeline, mission=mission, tick_hz=50)
    service.start()
    with CameraFeed(client), RobotEnd(client) as robot:
        eventually(lambda: service.view().camera.state == "running")
        mission.set_goal("rover", 200, 200, size_px=SIZE)
        eventually(lambda: robot.plans)
        pipeline.going_on.clear()
        closing = threading.Thread(target=service.close)
        closing.start()
        try:
            eventually(lambda: robot.orders == ["stop"])
        finally:
            pipeline.going_on.set()
            closing.join()


def test_a_server_without_its_state_file_catches_up_with_the_robot(
    service: NavigationService, client: zenoh.Session
) -> None:
    with RobotEnd(client) as robot:
        eventually(lambda: robot.say(epoch=50) or service.mission.of("rover").epoch == 51)


def claim(service: NavigationService, robot: RobotEnd) -> None:
    """Send plans to a robot that says that it follows another server, yard."""
    eventually(lambda: robot.say(server="yard") or rover(service).robot_state is not None)
    service.mission.set_goal("rover", 10.0, 10.0, size_px=(320, 240))
    eventually(lambda: robot.plans)


def test_a_robot_that_follows_another_server_is_waited_for_and_not_outbid(
    service: NavigationService, client: zenoh.Session
) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        claim(service, robot)
        eventually(lambda: robot.say(server="yard", epoch=50) or rover(service).status == "waiting")
        assert rover(service).reason == (
            "the robot follows another server, yard: take it out of the settings of one of the two"
        )
        assert service.mission.of("rover").epoch < 50
        eventually(lambda: robot.say(server=robot.plans[-1].server, epoch=50) or rover(service).status == "driving")
        eventually(lambda: service.mission.of("rover").epoch == 51)


def test_a_server_that_ends_leaves_a_robot_alone_that_follows_another(
    service: NavigationService, client: zenoh.Session
) -> None:
    with RobotEnd(client) as robot, CameraFeed(client):
        claim(service, robot)
        service.close()
        assert robot.orders == []


def test_a_robot_that_holds_a_stop_of_another_server_can_be_resumed(
    service: NavigationService, client: zenoh.Session
) -> None:
    with RobotEnd(client) as robot:
        robot.stopped, robot.epoch = True, 7
        eventually(lambda: robot.say() or rover(service).status == "stopped")
        assert rover(service).reason == "the robot holds a stop that did not come from this server: resume it"
        with pytest.raises(StoppedError, match="resume it"):
            service.set_goal("rover", 200, 100, size_px=SIZE)
        assert service.mission.of("rover").goal is None
        assert service.resume("rover") is True
        assert not robot.stopped
        assert rover(service).status == "no_goal"  # what it said last is from before
        assert service.set_goal("rover", 200, 100, size_px=SIZE) == service.mission.of("rover").goal
        robot.stopped = True
        eventually(lambda: robot.say() or rover(service).status == "stopped")
        service.resume("rover")
        assert service.mission.of("rover").goal is None  # from before the other's stop: it must not set off for that


def test_what_a_robot_says_of_a_resume_that_it_refuses_is_told(
    service: NavigationService, client: zenoh.Session
) -> None:
    def refuse(query: zenoh.Query) -> None:
        query.reply_err(b"resume of epoch 3: expected 8 or newer\n\x1b[31m" + 300 * b"x")

    queryable = client.declare_queryable(keys.stop("rover"), refuse)
    eventually(lambda: service.resume("rover") or "expected 8" in (rover(service).reason or ""))
    reason = rover(service).reason or ""
    assert reason.startswith("the robot has not confirmed to go on, and says: resume of epoch 3: expected 8 or newer??")
    assert len(reason) < 300
    queryable.undeclare()
    with RobotEnd(client):
        eventually(lambda: rover(service).reason is None)


def test_who_waits_for_a_silent_robot_waits_a_second_however_many_do(
    service: NavigationService, client: zenoh.Session
) -> None:
    asked: list[zenoh.Query] = []  # kept, so that nobody is answered
    queryable = client.declare_queryable(keys.stop("rover"), asked.append)
    eventually(lambda: service.stop("rover") is False and asked)
    with ThreadPoolExecutor(8) as pool:
        began_s = time.monotonic()
        assert list(pool.map(service.stop, ["rover"] * 8)) == [False] * 8
        assert time.monotonic() - began_s < 2.5  # one after the other they would take 4 s
    assert rover(service).reason == "the robot has not confirmed the stop"
    asked.clear()
    queryable.undeclare()


def test_ready_needs_camera_and_robot(service: NavigationService, client: zenoh.Session) -> None:
    reasons = service.view().reasons
    assert reasons == ["camera init: no picture yet", "no robot reports its state: rover"]
    with RobotEnd(client) as robot, CameraFeed(client):
        eventually(lambda: robot.say() or service.view().ready)


def test_a_path_ends_where_it_would_pass_the_camera() -> None:
    # The far edge is a third of the near one: depth is 1 + x / 0.3 m of that at the tag, 0 at x = -0.3 m.
    corners = np.array([[95.0, 90.0], [105.0, 90.0], [115.0, 110.0], [85.0, 110.0]])
    tilted = RobotSighting("rover", 0, np.array([100.0, 95.0]), np.array([0.0, -1.0]), corners)
    behind = np.array([[-0.1, 0.0], [-0.25, 0.0], [-0.5, 0.0], [-0.1, 0.0]])
    path = path_in_picture(behind, tilted, tag_size_m=0.3)
    assert len(path) == 2
    assert np.allclose(path[:, 0], 100.0, atol=1e-3)
    assert path[1, 1] > path[0, 1] > 95.0
