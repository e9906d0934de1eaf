from __future__ import annotations

import itertools
import json
import logging
import math
import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zenoh

from revnm_client import cdr, keys
from revnm_client.agent import AgentConfig, RobotAgent
from revnm_client.control_messages import (
    StopReply,
    StopRequest,
    TimeReply,
    decode_state,
    decode_stop_reply,
    decode_time_request,
    encode_stop_request,
    encode_time_reply,
)
from revnm_client.errors import ConfigError
from revnm_client.geometry import Pose2
from revnm_client.link import Inbox, LatestSubscriber, control_publisher, open_router
from revnm_client.messages import STANDSTILL, Odometry, Plan, Scan, Velocity
from revnm_client.runner import RobotRunner, RunnerSettings

ROBOT = "rover"
GARBAGE = [b"", b"\0\1\0\0", b"\xff" * 100, b"{", cdr.encode_velocity(Velocity(math.nan, 0.0))]


class FakeServerAndBase:
    """The other side of every key: a server that plans straight ahead, and a base that stands in the open.

    The base never moves, whatever it is told; the plan stays 2 m ahead of it.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.velocities: list[Velocity] = []
        self.plans_on = threading.Event()
        self.plans_on.set()
        self.seq = 0
        self._stop = threading.Event()
        self._inbox = Inbox(LatestSubscriber(session, keys.cmd_vel(ROBOT)), cdr.decode_velocity)
        self._states = Inbox(LatestSubscriber(session, keys.state(ROBOT)), decode_state)
        self.state: dict = {}
        self._clock = session.declare_queryable(keys.time(ROBOT), _tell_time)
        self._scan = control_publisher(session, keys.scan(ROBOT))
        self._odom = control_publisher(session, keys.odom(ROBOT))
        self._plan = control_publisher(session, keys.waypoints(ROBOT))
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(0.02):
            self._publish(time.time_ns())
            if (velocity := self._inbox.take()) is not None:
                self.velocities.append(velocity)
            self.state = self._states.take() or self.state

    def _publish(self, now_ns: int) -> None:
        ranges = np.full(360, 6.0, dtype=np.float32)
        self._odom.put(cdr.encode_odometry(Odometry(now_ns, Pose2(1.0, 2.0, 0.3), STANDSTILL)))
        self._scan.put(cdr.encode_scan(Scan(now_ns, -math.pi, math.tau / 360, 0.1, 10.0, ranges)))
        if self.plans_on.is_set():
            self.seq += 1
            waypoints = np.stack([np.linspace(0.4, 2.0, 5), np.zeros(5)], axis=1)
            plan = Plan(now_ns, waypoints, epoch=1, seq=self.seq, goal_id="g")
            self._plan.put(cdr.encode_plan(plan), attachment=cdr.encode_attachment(plan))

    @property
    def last(self) -> Velocity | None:
        return self.velocities[-1] if self.velocities else None

    def ask(self, payload: bytes) -> list[zenoh.Reply]:
        return list(self.session.get(keys.stop(ROBOT), payload=payload, timeout=5.0))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()


def _tell_time(query: zenoh.Query) -> None:
    t2_ns = time.time_ns()
    with query:
        t1_ns = decode_time_request(query.payload.to_bytes()).t1_ns
        query.reply(keys.time(ROBOT), encode_time_reply(TimeReply(t1_ns, t2_ns, time.time_ns(), "")))


@pytest.fixture
def other_side(router):
    with closing(FakeServerAndBase(router)) as side:
        yield side


def start(runner: RobotRunner, stop: threading.Event) -> threading.Thread:
    thread = threading.Thread(target=runner.run, args=(stop,))
    thread.start()
    return thread


@pytest.fixture
def runner(endpoint):
    agent = RobotAgent(AgentConfig(robot=ROBOT))
    runner = RobotRunner(RunnerSettings(robot=ROBOT, connect=(endpoint,)), agent)
    stop = threading.Event()
    thread = start(runner, stop)
    yield runner
    stop.set()
    thread.join(timeout=10.0)
    assert not thread.is_alive()


def drives(side: FakeServerAndBase) -> bool:
    return side.last is not None and side.last.v_mps > 0.05


def stands(side: FakeServerAndBase) -> bool:
    return side.last == STANDSTILL


def test_it_drives_along_the_plan_and_says_so(runner, other_side, eventually, caplog):
    caplog.set_level(logging.INFO)
    eventually(lambda: drives(other_side))
    eventually(lambda: other_side.state.get("moving"))
    state = other_side.state
    assert (state["robot"], state["reason"], state["epoch"], state["goal_id"]) == (ROBOT, None, 1, "g")
    assert 0 <= state["plan_age_ms"] < 500
    assert abs(state["clock_offset_ms"]) < 50
    assert runner.failures == 0
    lines = [record.getMessage() for record in caplog.records]
    assert sum(line.startswith("driving; commanded 0.") for line in lines) == 1  # transitions are logged, ticks are not


def test_it_stands_when_plans_stop_coming_and_goes_on(runner, other_side, eventually, caplog):
    caplog.set_level(logging.INFO)
    eventually(lambda: drives(other_side))
    other_side.plans_on.clear()
    begin_s = time.monotonic()
    eventually(lambda: stands(other_side))
    assert time.monotonic() - begin_s < 1.5  # 0.5 s by the rule, the rest for a busy machine
    eventually(lambda: any("stopped: plan is 0." in record.getMessage() for record in caplog.records))
    other_side.plans_on.set()
    eventually(lambda: drives(other_side))


def test_stop_is_acknowledged_and_latched(runner, other_side, eventually):
    eventually(lambda: drives(other_side))
    (reply,) = other_side.ask(encode_stop_request(StopRequest("stop", 5)))
    assert decode_stop_reply(reply.ok.payload.to_bytes()) == StopReply(stopped=True, epoch=5)
    eventually(lambda: stands(other_side))
    eventually(lambda: other_side.state.get("stopped"))
    sent = other_side.seq
    eventually(lambda: other_side.seq > sent + 10)  # plans of epoch 1 go on coming
    assert stands(other_side)

    (late,) = other_side.ask(encode_stop_request(StopRequest("resume", 4)))
    assert b"epoch 4" in late.err.payload.to_bytes()
    (reply,) = other_side.ask(encode_stop_request(StopRequest("resume", 6)))
    assert decode_stop_reply(reply.ok.payload.to_bytes()) == StopReply(stopped=False, epoch=6)
    eventually(lambda: other_side.state.get("stopped") is False)
    assert other_side.state["malformed"] == 0  # what was refused was sound
    sent = other_side.seq
    eventually(lambda: other_side.seq > sent + 10)
    assert stands(other_side)  # these plans are from before the stop


def test_garbage_on_every_key_is_counted_and_ignored(runner, other_side, router, eventually):
    eventually(lambda: drives(other_side))
    for key in (keys.scan(ROBOT), keys.odom(ROBOT), keys.waypoints(ROBOT)):
        before = other_side.state.get("malformed", 0)
        kinds = itertools.cycle(GARBAGE)
        # The robot takes the newest only: enough is sent for some of it to be the newest.
        eventually(
            lambda: router.put(key, next(kinds)) or other_side.state.get("malformed", 0) > before + 2  # noqa: B023
        )
    for garbage in GARBAGE:
        (reply,) = other_side.ask(garbage)
        assert reply.ok is None
    eventually(lambda: drives(other_side))
    assert other_side.state["last_malformed"]
    assert runner.failures == 0


def test_a_plan_without_attachment_is_not_driven(runner, other_side, router, eventually):
    eventually(lambda: drives(other_side))
    other_side.plans_on.clear()
    eventually(lambda: stands(other_side))
    plan = Plan(0, np.array([[1.0, 0.0]]), epoch=1, seq=10**6, goal_id="g")
    before = other_side.state.get("malformed", 0)
    eventually(
        lambda: (
            router.put(keys.waypoints(ROBOT), cdr.encode_plan(replace(plan, stamp_ns=time.time_ns())))
            or other_side.state.get("malformed", 0) > before
        )
    )
    assert stands(other_side)


def test_without_a_router_it_stands_and_with_a_new_one_it_goes_on(endpoint, eventually, caplog):
    caplog.set_level(logging.INFO)
    runner = RobotRunner(RunnerSettings(ROBOT, (endpoint,)), RobotAgent(AgentConfig(robot=ROBOT)))
    stop = threading.Event()
    thread = start(runner, stop)
    try:
        with open_router([endpoint]) as router, closing(FakeServerAndBase(router)) as side:
            eventually(lambda: drives(side))
        eventually(lambda: runner.commanded == STANDSTILL, within_s=1.5)
        with open_router([endpoint]) as router, closing(FakeServerAndBase(router)) as side:
            side.seq = 10**6
            eventually(lambda: drives(side))
            stop.set()
            thread.join(timeout=10.0)
            eventually(lambda: stands(side))  # the last word is zero
    finally:
        stop.set()
        thread.join(timeout=10.0)
    assert runner.failures == 0


class BrokenAgent(RobotAgent):
    """An agent with a bug in it, that goes away when told to."""

    def __init__(self) -> None:
        super().__init__(AgentConfig(robot=ROBOT))
        self.broken = threading.Event()

    def tick(self, now_ns):
        if self.broken.is_set():
            raise ZeroDivisionError("a bug")
        return super().tick(now_ns)


def test_a_bug_in_the_brain_means_zero_and_not_silence(endpoint, other_side, eventually, caplog):
    agent = BrokenAgent()
    runner = RobotRunner(RunnerSettings(ROBOT, (endpoint,)), agent)
    stop = threading.Event()
    thread = start(runner, stop)
    try:
        eventually(lambda: drives(other_side))
        agent.broken.set()
        eventually(lambda: stands(other_side))
        heard = len(other_side.velocities)
        eventually(lambda: len(other_side.velocities) > heard + 5)
        assert stands(other_side)
        eventually(lambda: "a bug" in (other_side.state.get("reason") or ""))
        assert not other_side.state["moving"]
        assert runner.failures > 5
        assert sum(record.exc_info is not None for record in caplog.records) == 1  # one trace, not 20 a second
        (reply,) = other_side.ask(encode_stop_request(StopRequest("stop", 2)))
        assert decode_stop_reply(reply.ok.payload.to_bytes()).stopped
    finally:
        stop.set()
        thread.join(timeout=10.0)


def test_a_name_that_is_no_name_is_refused():
    with pytest.raises(ConfigError, match="a/b"):
        RunnerSettings("a/b", ("tcp/127.0.0.1:7447",))


def command(*arguments: str) -> subprocess.Popen[str]:
    program = Path(sys.executable).with_name("revnm-robot")
    return subprocess.Popen([program, *arguments], stderr=subprocess.PIPE, text=True)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_command_stops_the_base_when_it_ends(endpoint, other_side, eventually, number):
    process = command("run", "--robot", ROBOT, "--connect", endpoint)
    try:
        eventually(lambda: drives(other_side), within_s=20.0)
        os.kill(process.pid, number)
        _, log = process.communicate(timeout=10.0)
    finally:
        process.kill()
    assert process.returncode == 0
    assert "driving" in log
    eventually(lambda: stands(other_side))


def test_the_command_can_be_ended_while_it_waits_for_a_router(endpoint):
    process = command("run", "--robot", ROBOT, "--connect", endpoint)
    try:
        assert "waiting for" in process.stderr.readline()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=10.0)
    finally:
        process.kill()
    assert process.returncode == 0


def test_the_command_says_what_is_wrong():
    for arguments, word in ((("--robot", "a b"), "a b"), (("--robot", "a", "--connect", "junk"), "junk")):
        process = command("run", *arguments)
        _, log = process.communicate(timeout=20.0)
        assert process.returncode == 2
        assert word in log
        assert "Traceback" not in log


def test_state_is_flat_json(runner, other_side, eventually):
    eventually(lambda: other_side.state)
    assert json.loads(json.dumps(other_side.state)) == other_side.state
