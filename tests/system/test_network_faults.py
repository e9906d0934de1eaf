"""What is between robot and server breaks: the robot stands, nobody is told otherwise, and it goes on by itself.

The robot's state and log, the server's state and the true speed must agree.
"""

from __future__ import annotations

import math
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.server.recording_parts import read
from tests.server.waiting import eventually

from revnm_client import keys
from revnm_client.link import LatestSubscriber, open_client

from .emulated_link import LinkCondition
from .hall import ROBOT, SCENARIO
from .network import require_namespaces
from .network_stage import NetworkStage, network_stage
from .site import SERVER_HOSTS
from .speed_gauge import SpeedGauge

pytestmark = pytest.mark.slow

STANDS_WITHIN_S = 0.7
DRIVES_MPS = 0.2
OLDEST_PLAN_MS = 500.0
ASK_EVERY_S = 0.1  # who asks more often takes the machine's time from those whose times are measured
A_TICK_MS = 50.0  # from the decision to the state that tells of it
ENDS_M = (SCENARIO.start.x_m, SCENARIO.start.y_m), SCENARIO.goal_m
WHOLE, PARTED = LinkCondition(), LinkCondition(parted=True)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[NetworkStage]:
    require_namespaces()
    with network_stage(tmp_path_factory.mktemp("network")) as system:
        yield system


class Drive:
    """A drive from one end of the hall to the other, under way."""

    def __init__(self, system: NetworkStage) -> None:
        self.system, self.server, self.link = system, system.server, system.site.link
        self.gauge = SpeedGauge(system.simulation)
        pose = system.simulation.true_pose
        self._goal_m = max(ENDS_M, key=lambda end_m: math.dist(end_m, (pose.x_m, pose.y_m)))
        self._log = system.folder / "robot.log"
        eventually(self.server.ready, within_s=30.0, every_s=ASK_EVERY_S)
        self.server_hears_the_scans()
        assert self.server.set_goal(self._goal_m).status_code == 200
        self.gauge.wait_faster(DRIVES_MPS, within_s=15.0)
        self._said_before = len(self._log.read_text())

    def server_hears_the_scans(self) -> None:
        """Wait until the robot's own router has found the server's."""
        with open_client([self.server.listen]) as session, LatestSubscriber(session, keys.scan(ROBOT)) as scans:
            eventually(scans.take)

    def stands_soon_after(self, fault_s: float) -> None:
        """Wait until the robot stands; it must not have taken long since the fault, monotonic clock."""
        assert self.gauge.wait_standing(within_s=5.0) - fault_s < STANDS_WITHIN_S

    def page_says(self, status: str, reason: str) -> None:
        """Wait until the server says so; ``reason`` is a regular expression."""

        def told() -> bool:
            rover = self.server.rover()
            return rover["status"] == status and re.fullmatch(reason, rover["reason"] or "") is not None

        eventually(told, within_s=10.0, every_s=ASK_EVERY_S)

    def robot_says(self, reason: str) -> None:
        """Wait until the robot has logged that it stopped for a reason, a regular expression, since it set out."""
        eventually(lambda: re.search(f"stopped: {reason};", self._log.read_text()[self._said_before :]))

    def goes_on_and_arrives(self) -> None:
        """Wait until it drives again, and is where it was sent, as the server says and in truth."""
        self.gauge.wait_faster(DRIVES_MPS, within_s=20.0)
        self.arrives()

    def arrives(self) -> None:
        """Wait until it is where it was sent, as the server says and in truth."""
        eventually(self.system.arrived, within_s=30.0, every_s=ASK_EVERY_S)
        self.gauge.wait_standing(within_s=5.0)
        pose = self.system.simulation.true_pose
        assert math.dist((pose.x_m, pose.y_m), self._goal_m) < 0.5
        assert not self.system.simulation.had_contact


@pytest.fixture
def drive(running: NetworkStage) -> Iterator[Drive]:
    yield Drive(running)
    running.mend()


class StateWatch(threading.Thread):
    """Gathers every state that the robot tells of itself, as the server hears it."""

    def __init__(self, drive: Drive) -> None:
        super().__init__(daemon=True)
        self.states: list[dict[str, Any]] = []
        self._drive, self._over = drive, threading.Event()

    def run(self) -> None:
        while not self._over.wait(ASK_EVERY_S):
            state = self._drive.server.rover()["robot_state"]
            if not self.states or state != self.states[-1]:
                self.states.append(state)

    def end(self) -> None:
        self._over.set()
        self.join()


@contextmanager
def watched(drive: Drive) -> Iterator[list[dict[str, Any]]]:
    """Gather the robot's states."""
    watch = StateWatch(drive)
    watch.start()
    try:
        yield watch.states
    finally:
        watch.end()


def assert_no_old_plan_was_driven_by(states: list[dict[str, Any]]) -> None:
    """In each state either the robot stands and says that the plan is too old, or the plan is not."""
    assert len(states) >= 8
    for state in states:
        if state["moving"]:
            assert state["plan_age_ms"] <= OLDEST_PLAN_MS + A_TICK_MS, state
        elif state["plan_age_ms"] > OLDEST_PLAN_MS + A_TICK_MS:
            assert re.fullmatch(r"plan is \d\.\d s old", state["reason"]), state


def test_a_parted_network_stops_the_robot_until_it_is_whole(drive: Drive) -> None:
    drive.stands_soon_after(drive.link.become(PARTED))
    stood_m = drive.system.simulation.path_m
    drive.robot_says(r"plan is 0\.[5-9] s old")
    drive.page_says("waiting", r"the robot was heard [2-9]\.\d s ago")
    drive.page_says("waiting", r"the robot was heard [5-9]\.\d s ago")  # both ends have given their sessions up by now
    assert drive.system.simulation.path_m - stood_m < 0.01

    drive.link.become(WHOLE)
    drive.goes_on_and_arrives()


def test_through_a_lossy_network_the_robot_drives_by_fresh_plans_only(drive: Drive) -> None:
    drive.link.become(LinkCondition(loss=0.2))
    with watched(drive) as states:
        eventually(lambda: len(states) >= 10, within_s=15.0)
    assert_no_old_plan_was_driven_by(states)

    drive.link.become(WHOLE)
    drive.arrives()


def test_through_a_slow_network_the_robot_drives_by_fresh_plans_only(drive: Drive) -> None:
    drive.link.become(LinkCondition(delay_s=0.3, jitter_s=0.1))
    with watched(drive) as states:
        drive.page_says("driving", r"robot: plan is 0\.\d s old")
        eventually(lambda: len(states) >= 10, within_s=15.0)
    assert_no_old_plan_was_driven_by(states)
    assert any(not state["moving"] for state in states)  # by then no plan comes in time

    drive.link.become(WHOLE)
    drive.arrives()


def test_when_the_server_dies_and_comes_back_the_robot_goes_on(drive: Drive) -> None:
    died_s = time.monotonic()
    drive.server.process.signal(signal.SIGKILL)
    drive.stands_soon_after(died_s)
    drive.robot_says(r"plan is 0\.[5-9] s old")

    drive.server.start()
    drive.goes_on_and_arrives()


def test_when_the_robots_own_router_dies_and_comes_back_the_robot_goes_on(drive: Drive) -> None:
    died_s = time.monotonic()
    drive.system.router.signal(signal.SIGKILL)
    drive.stands_soon_after(died_s)
    drive.page_says("driving", r"robot: (odometry|scan) is \d\.\d s old")

    drive.system.start_router()
    drive.goes_on_and_arrives()
    drive.server_hears_the_scans()


def test_a_full_disk_ends_the_record_and_not_the_drive(drive: Drive, tmp_path: Path) -> None:
    server, disk = drive.server, drive.system.records
    assert server.call("POST", "/api/v1/recording/start").status_code == 200
    eventually(lambda: server.state()["recording"]["messages"] >= 300, every_s=ASK_EVERY_S)
    fill(disk / "of others")
    state = eventually(lambda: not (now := server.state())["recording"]["active"] and now)
    reason = state["recording"]["reason"]
    assert re.fullmatch(r"the recording stopped: revnm-.*\.mcap: No space left on device", reason)
    assert reason in state["warnings"]
    assert state["robots"][0]["status"] == "driving"
    drive.arrives()

    (part,) = disk.glob("*.mcap.part")
    shutil.copy(part, tmp_path)
    recover = [str(Path(sys.executable).with_name("revnm-server")), "record", "recover", str(tmp_path / part.name)]
    subprocess.run(recover, check=True, capture_output=True)
    (recovered,) = tmp_path.glob("*.recovered.mcap")
    assert len(read(recovered)[f"/{ROBOT}/odom"]) >= 20

    (disk / "of others").unlink()
    again = server.call("POST", "/api/v1/recording/start").json()
    assert (again["active"], again["reason"]) == (True, None)
    server.call("POST", "/api/v1/recording/stop")


def fill(path: Path) -> None:
    """Write a file until the disk is full."""
    with path.open("wb", buffering=0) as file:
        try:
            while file.write(bytes(4096)):
                pass
        except OSError:
            return


def test_a_server_that_moves_to_another_address_is_found(drive: Drive) -> None:
    died_s = time.monotonic()
    drive.server.process.signal(signal.SIGKILL)
    drive.stands_soon_after(died_s)

    drive.system.move_server(*SERVER_HOSTS)  # packets to the former address are lost: nothing refuses them
    drive.server.start()
    drive.goes_on_and_arrives()
