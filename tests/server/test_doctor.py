from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from revnm_client.link import open_client
from revnm_server.app import running_server
from revnm_server.cli import main
from revnm_server.doctor import Verdict, examine
from revnm_server.settings import load_settings
from revnm_server.views.view import CameraView, RobotView, ServerView, TimingView

from .free_port import free_port
from .service_parts import CameraFeed, RobotEnd
from .waiting import eventually

CAMERA = CameraView("rtsp://***@cam/live", "running", (1280, 720), 15.0, 0.05, 1e12, None)
ROBOT = RobotView(
    name="rover",
    status="no_goal",
    reason=None,
    goal=None,
    pixel=(1.0, 2.0),
    heading=(1.0, 0.0),
    sighting_age_s=0.1,
    tag_px=40.0,
    path_px=[],
    waypoints_m=[],
    plan_age_s=None,
    picture_to_plan_ms=None,
    scan=None,
    clock_offset_ms=2.0,
    round_trip_ms=1.0,
    robot_state={},
    robot_state_age_s=0.2,
    epoch=1,
    seq=0,
)
VIEW = ServerView(CAMERA, [ROBOT], {"tick": TimingView(30.0, 50.0)}, True, [], [], {"rover/odom": 0}, (0.43, 0.36))


def findings(view: ServerView) -> dict[str, tuple[Verdict, str]]:
    return {f.subject: (f.verdict, f.text) for f in examine(view, tags={"rover": 3}, tick_hz=10.0)}


def test_a_server_to_which_nothing_is_missing() -> None:
    found = findings(VIEW)
    assert {verdict for verdict, _ in found.values()} == {Verdict.GOOD}
    assert found.keys() == {"camera", "tick", "rover: tag", "rover: link", "rover: clock"}
    assert "1280 × 720 at 15.0" in found["camera"][1]
    assert "40 px" in found["rover: tag"][1]


@pytest.mark.parametrize(
    ("camera", "verdict", "said"),
    [
        ({"state": "reconnecting", "reason": "Connection refused"}, Verdict.FAULT, "Connection refused"),
        ({"fps": 2.0}, Verdict.WARNING, "frame rate"),
        ({"frame_age_s": 0.8}, Verdict.WARNING, "too slow"),
    ],
)
def test_a_camera_that_is_not_well(camera: dict[str, Any], verdict: Verdict, said: str) -> None:
    found = findings(replace(VIEW, camera=replace(CAMERA, **camera)))
    assert found["camera"][0] is verdict
    assert said in found["camera"][1]
    assert ("rover: tag" in found) is (verdict is not Verdict.FAULT)  # without a picture no word of tags


@pytest.mark.parametrize(
    ("robot", "subject", "verdict", "said"),
    [
        ({"tag_px": 20.0}, "tag", Verdict.WARNING, "larger tag"),
        ({"tag_px": None, "sighting_age_s": None}, "tag", Verdict.FAULT, "id 3"),
        ({"sighting_age_s": 1.8}, "tag", Verdict.WARNING, "last seen 1.8 s ago"),
        ({"sighting_age_s": 19.0}, "tag", Verdict.FAULT, "id 3"),
        ({"robot_state": None, "robot_state_age_s": None}, "link", Verdict.FAULT, "revnm-robot"),
        ({"robot_state_age_s": 60.0}, "link", Verdict.FAULT, "revnm-robot"),
        ({"clock_offset_ms": None}, "clock", Verdict.FAULT, "will not move"),
        ({"clock_offset_ms": -4000.0}, "clock", Verdict.WARNING, "chrony"),
    ],
)
def test_a_robot_that_is_not_well(robot: dict[str, Any], subject: str, verdict: Verdict, said: str) -> None:
    found = findings(replace(VIEW, robots=[replace(ROBOT, **robot)]))[f"rover: {subject}"]
    assert found[0] is verdict
    assert said in found[1]


def test_slow_ticks_refused_messages_and_warnings_are_told() -> None:
    slow = {"tick": TimingView(90.0, 140.0)}
    found = findings(replace(VIEW, timings_ms=slow, rejected={"rover/odom": 7}, warnings=["the disk is full"]))
    assert found["tick"][0] is Verdict.WARNING
    assert "100 ms" in found["tick"][1]  # ten ticks a second
    assert "7 messages" in found["rover/odom"][1]
    assert found["server"] == (Verdict.WARNING, "the disk is full")
    assert findings(replace(VIEW, timings_ms={}, reasons=["tick failed"]))["tick"] == (Verdict.FAULT, "tick failed")


def test_a_robot_that_the_settings_lack_is_told() -> None:
    findings = {f.subject: f for f in examine(VIEW, tags={"other": 3}, tick_hz=10.0)}
    assert findings["rover: tag"].verdict is Verdict.WARNING


def test_it_looks_at_the_server_that_runs(tiny_bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    options = ["--bundle", str(tiny_bundle), "--listen", endpoint, "--http", f"127.0.0.1:{port}"]
    overrides = {"zenoh": {"listen": [endpoint]}, "http": {"port": port}, "perception": {"bundle": tiny_bundle}}
    with (
        running_server(load_settings(overrides=overrides)) as server,
        open_client([endpoint]) as client,
        CameraFeed(client),
        RobotEnd(client) as robot,
    ):
        eventually(lambda: robot.say(clock_offset_ms=1.0) or server.service.view().ready)
        eventually(lambda: server.service.view().timings_ms)
        assert main(["doctor", *options]) == 1  # there is no tag in this picture
    said = capsys.readouterr().out
    assert "no server runs" not in said
    assert "camera        320 × 240" in said
    assert "FAULT    rover: tag" in said
    assert "good     rover: clock" in said


def test_it_starts_one_of_its_own_where_none_runs(tiny_bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--bundle", str(tiny_bundle), "--listen", f"tcp/127.0.0.1:{free_port()}", "--seconds", "0.2"]
    assert main(["doctor", *options, "--http", f"127.0.0.1:{free_port()}"]) == 1
    said = capsys.readouterr().out
    assert "no server runs" in said
    assert "FAULT    camera" in said
    assert "FAULT    rover: link" in said


def test_it_says_when_something_else_answers(tiny_bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    port = free_port()
    overrides = {
        "zenoh": {"listen": ["tcp/127.0.0.1:0"]},
        "http": {"port": port, "token": "0123456789abcdefXYZ"},
        "perception": {"bundle": tiny_bundle},
    }
    with running_server(load_settings(overrides=overrides)):
        assert main(["doctor", "--bundle", str(tiny_bundle), "--http", f"127.0.0.1:{port}"]) == 2
    said = capsys.readouterr().err
    assert "answers 401" in said
    assert "REVNM_HTTP__TOKEN" in said
