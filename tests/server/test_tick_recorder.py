"""The service shows every tick to the recorder, those that fail, too; the state and the API tell of the record."""

from __future__ import annotations

import json
from pathlib import Path

import zenoh

from revnm_server.camera import open_camera
from revnm_server.robots.mission import Mission
from revnm_server.service import NavigationService

from .recording_parts import read, recorder, records
from .service_parts import CameraFeed, FakePipeline, RobotEnd
from .waiting import eventually


def test_the_recorder_sees_what_the_service_does(router: zenoh.Session, tmp_path: Path) -> None:
    camera, pipeline, mission = open_camera("zenoh://cam", router), FakePipeline(), Mission(["rover"])
    with recorder(router, tmp_path) as made:
        service = NavigationService(
            router, camera=camera, pipeline=pipeline, mission=mission, tick_hz=50, recorder=made
        )
        made.watch(service.view)
        service.start()
        with CameraFeed(router, "cam"), RobotEnd(router) as robot:
            eventually(lambda: service.view().camera.state == "running")
            assert made.start().active
            goal = mission.set_goal("rover", 300, 50, size_px=(320, 240))
            eventually(lambda: len(robot.plans) >= 3)
            shown = service.view().recording
            assert shown is not None
            assert shown.active
            pipeline.broken = "no depth"
            eventually(lambda: any("no depth" in reason for reason in service.view().reasons))
            pipeline.broken = None
            before = len(robot.plans)
            eventually(lambda: len(robot.plans) > before)
            made.stop()
        service.close()
        camera.close()
    messages = read(records(tmp_path)[0])
    ticks = [json.loads(message.data) for message in messages["/revnm/tick"]]
    assert any(tick["failed"] for tick in ticks)
    led = [tick for tick in ticks if tick["published"] == ["rover"]]
    assert {tick["goals"]["rover"]["id"] for tick in led} == {goal.id}
    # The plan of every tick is there as it was sent; while the record ended, some more were sent.
    sent = {json.loads(message.data)["seq"] for message in messages["/rover/waypoints/ticket"]}
    assert 3 <= len(led) <= len(sent)
    assert any("tick failed" in line.msg for line in messages["/rosout"])
    assert any(status.name == "revnm: robot rover" for array in messages["/diagnostics"] for status in array.status)


def test_a_record_that_is_not_written_is_a_warning_on_the_page(router: zenoh.Session, tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file")
    camera = open_camera("zenoh://cam", router)
    with recorder(router, tmp_path / "taken", from_start=True) as made:
        service = NavigationService(
            router, camera=camera, pipeline=FakePipeline(), mission=Mission(["rover"]), recorder=made
        )
        service.start()
        shown = service.view()
        service.close()
        camera.close()
    assert shown.recording is not None
    assert "File exists" in str(shown.recording.reason)
    assert shown.warnings == [shown.recording.reason]
