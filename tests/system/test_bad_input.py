"""Hostile and missing input across processes: it is refused, counted and told, and changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest
import zenoh
from tests.server.free_port import free_port
from tests.server.tiny_bundle import write_tiny_bundle
from tests.server.waiting import eventually

from revnm_client import cdr, keys
from revnm_client.link import LatestSubscriber, open_client
from revnm_client.messages import CompressedImage, Velocity
from revnm_server.robots.mission import Mission

from .hall import CAMERA, ROBOT
from .process import Process
from .speed_gauge import SpeedGauge
from .stage import Stage, stage

GARBAGE = (
    b"",
    b"\x00\x01\x00\x00",
    b"\xff" * 100,
    b'{"action":"stop"}',
    b"[" * 3000,
    b"\x00" * 100_000,
    cdr.encode_velocity(Velocity(math.nan, 0.0)),
    cdr.encode_image(CompressedImage(0, "jpeg", b"\xff\xd8\xff\xe0 no picture")),
)
GOAL = f"/api/v1/robots/{ROBOT}/goal"
JSON = {"content-type": "application/json"}
BAD_GOALS = (
    (GOAL, b'{"u":640,"v":5}', 422),
    (GOAL, b'{"u":5,"v":-0.01}', 422),
    (GOAL, b'{"u":NaN,"v":5}', 422),
    (GOAL, b'{"u":1e999,"v":5}', 422),
    (GOAL, b'{"u":"5","v":5}', 422),
    (GOAL, b'{"v":5}', 422),
    (GOAL, b'{"u":' + b" " * 5_000_000 + b"5}", 413),
    ("/api/v1/robots/nobody/goal", b'{"u":5,"v":5}', 404),
    ("/api/v1/robots/%00%2e%2e/goal", b'{"u":5,"v":5}', 404),
)


def refuses_bad_goals(system: Stage) -> None:
    """Set goals that are none; each is a problem document, and goal and epoch stay."""
    before = system.server.rover()
    for path, body, status in BAD_GOALS:
        answer = system.server.call("PUT", path, content=body, headers=JSON)
        assert answer.status_code == status, (body[:40], answer.text)
        assert answer.headers["content-type"] == "application/problem+json"
        assert answer.json()["status"] == status
    after = system.server.rover()
    assert (after["goal"], after["epoch"]) == (before["goal"], before["epoch"])


class Heckler:
    """Puts garbage on keys, and asks garbage of queryables, until it has been counted."""

    def __init__(self, system: Stage, session: zenoh.Session) -> None:
        self._system = system
        self._session = session

    def shout(self, key: str, counted: Callable[[], int]) -> None:
        """Put every kind of garbage until it has been counted."""
        kinds, before = cycle(GARBAGE), counted()
        eventually(lambda: self._session.put(key, next(kinds)) or counted() >= before + len(GARBAGE))

    def shout_everywhere(self) -> None:
        """Put one of each kind on every key."""
        named = (keys.scan, keys.odom, keys.waypoints, keys.cmd_vel, keys.state)
        for key in (*(name(ROBOT) for name in named), keys.image(CAMERA)):
            for payload in GARBAGE:
                self._session.put(key, payload)

    def ask(self, key: str) -> None:
        """Ask every kind of garbage; each question is answered with an error."""
        for payload in GARBAGE:
            replies = list(self._session.get(key, payload=payload, timeout=2.0))
            assert replies
            assert all(reply.ok is None for reply in replies), payload[:20]

    def told(self, key: str) -> Callable[[], int]:
        """Return what reads the server's count for a key."""
        return lambda: int(self._system.server.state()["rejected"][key])

    def robot_told(self) -> int:
        """What the robot says it dropped."""
        return int(self._system.server.rover()["robot_state"]["malformed"])


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    return write_tiny_bundle(tmp_path / "bundle")


def refusal(bundle: Path) -> str:
    """Start a server on a bundle that it must refuse; return what it says."""
    arguments = ["serve", "--bundle", str(bundle), "--http", f"127.0.0.1:{free_port()}"]
    arguments += ["--listen", f"tcp/127.0.0.1:{free_port()}"]
    with Process("revnm-server", arguments, log=bundle / "server.log") as server:
        eventually(lambda: server.status is not None, within_s=10.0)
        assert server.status == 2
        assert "Traceback" not in server.output
        return server.output


def test_a_missing_depth_model_keeps_the_server_from_starting(bundle: Path) -> None:
    (bundle / "depth.onnx").unlink()
    said = refusal(bundle)
    assert f"{bundle / 'depth.onnx'}: missing" in said


def test_an_altered_model_keeps_the_server_from_starting(bundle: Path) -> None:
    with (bundle / "policy.onnx").open("ab") as model:
        model.write(b"!")
    said = refusal(bundle)
    assert str(bundle / "policy.onnx") in said
    assert "sha256" in said


def lacks_only_a_plan(system: Stage) -> dict[str, Any] | None:
    """Return what the server knows of the robot once the robot says that it has everything but a plan."""
    rover = system.server.rover()
    return rover if rover["robot_state"] and rover["robot_state"]["reason"] == "no plan yet" else None


def test_without_a_camera_the_robot_gets_no_plan_and_everybody_is_told_why(tmp_path: Path) -> None:
    mission = Mission([ROBOT], state_file=tmp_path / "state.json")
    mission.set_goal(ROBOT, 600, 100, size_px=(640, 480))  # of a server that ran before
    with stage(tmp_path, camera="elsewhere") as system, open_client([system.server.listen]) as session:
        with LatestSubscriber(session, keys.waypoints(ROBOT)) as plans:
            rover = eventually(lambda: lacks_only_a_plan(system), within_s=20.0)
            assert not rover["robot_state"]["moving"]
            assert rover["goal"] is not None
            assert (rover["status"], rover["reason"]) == ("waiting", "camera init: no picture yet")
            readiness = system.server.call("GET", "/readyz")
            assert readiness.status_code == 503
            assert readiness.json()["reasons"] == ["camera init: no picture yet"]
            assert system.server.set_goal().status_code == 409
            assert system.server.rover()["goal"] == rover["goal"]
            assert (rover["seq"], plans.take()) == (0, None)
        assert system.simulation.path_m < 0.01


def test_a_drive_among_garbage_ends_at_its_goal(tmp_path: Path) -> None:
    with stage(tmp_path) as system, open_client([system.server.listen]) as session:
        gauge = SpeedGauge(system.simulation)
        eventually(system.server.ready, within_s=20.0)
        assert system.server.set_goal().status_code == 200
        gauge.wait_faster(0.2, within_s=10.0)

        refuses_bad_goals(system)
        heckler = Heckler(system, session)
        heckler.shout(keys.image(CAMERA), heckler.told(keys.image(CAMERA)))
        heckler.shout(keys.state(ROBOT), heckler.told(keys.state(ROBOT)))
        heckler.ask(keys.time(ROBOT))
        eventually(lambda: heckler.told(keys.time(ROBOT))() == len(GARBAGE))  # the state is up to 0.1 s old
        heckler.shout(keys.cmd_vel(ROBOT), lambda: system.simulator.rejected)
        for key in (keys.scan(ROBOT), keys.odom(ROBOT), keys.waypoints(ROBOT)):
            heckler.shout(key, heckler.robot_told)
        before = heckler.robot_told()
        heckler.ask(keys.stop(ROBOT))
        eventually(lambda: heckler.robot_told() >= before + len(GARBAGE))

        assert not system.server.rover()["robot_state"]["stopped"]
        eventually(lambda: heckler.shout_everywhere() or system.arrived(), within_s=30.0)
        gauge.wait_standing(within_s=5.0)
        assert system.to_goal_m() < 0.5
        assert not system.simulation.had_contact
