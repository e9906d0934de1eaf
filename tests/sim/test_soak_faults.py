"""Which faults follow each other; how a real robot's last motion is told."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import STANDSTILL, Velocity
from revnm_sim.camera import Camera
from revnm_sim.physics import TICK_NS
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.soak.faults import Fault, shuffled
from revnm_sim.soak.motion import last_motion_s
from revnm_sim.world import Bounds, World

SCENARIO = Scenario(
    world=World("empty", Bounds(-5.0, -5.0, 5.0, 5.0), (150, 150, 150), ()),
    camera=Camera(320, 240, 1.4, (-2.0, 0.0, 2.5), 0.0, 0.7),
    start=Pose2(0.0, 0.0, 0.0),
    goal_m=(3.0, 1.0),
    seed=0,
)


def fault(kind: str) -> Fault:
    return Fault(kind, lambda: None, lambda: None)


def test_each_fault_comes_once_before_any_comes_again() -> None:
    drawn = shuffled([fault(kind) for kind in "abcde"], np.random.default_rng(0))
    rounds = ["".join(f.kind for f in itertools.islice(drawn, 5)) for _ in range(20)]
    assert {"".join(sorted(kinds)) for kinds in rounds} == {"abcde"}
    assert len(set(rounds)) > 10


class Driver:
    """Runs a simulation by the clock, in a thread, with one command again and again."""

    def __init__(self, simulation: Simulation) -> None:
        self.velocity: Velocity | None = STANDSTILL
        self._simulation = simulation

    def run(self, stop: threading.Event) -> None:
        """Run until it is told to stop."""
        began_s = time.monotonic() - self._simulation.time_ns * 1e-9
        while not stop.wait(TICK_NS * 1e-9):
            if self.velocity is not None:
                self._simulation.command(self.velocity)
            self._simulation.advance(time.monotonic() - began_s - self._simulation.time_ns * 1e-9)


@pytest.fixture
def driven() -> Iterator[tuple[Driver, Simulation]]:
    stop = threading.Event()
    with Simulation(SCENARIO, 0) as simulation:
        driver = Driver(simulation)
        thread = threading.Thread(target=driver.run, args=(stop,))
        thread.start()
        yield driver, simulation
        stop.set()
        thread.join()


def drive(driver: Driver, simulation: Simulation) -> None:
    """Drive until the robot is at full speed."""
    driver.velocity, before_m, deadline_s = Velocity(0.5, 0.0), simulation.path_m, time.monotonic() + 10.0
    while simulation.path_m < before_m + 0.4:
        assert time.monotonic() < deadline_s
        threading.Event().wait(0.01)


def test_a_robot_that_stands_has_no_last_motion_and_one_that_turns_neither(
    driven: tuple[Driver, Simulation],
) -> None:
    driver, simulation = driven
    assert last_motion_s(simulation, until_s=time.monotonic() + 0.2) is None
    driver.velocity = Velocity(0.0, 0.5)
    assert last_motion_s(simulation, until_s=time.monotonic() + 0.5) is None


def test_the_last_motion_is_when_braking_has_ended(driven: tuple[Driver, Simulation]) -> None:
    driver, simulation = driven
    drive(driver, simulation)
    told_s = time.monotonic()
    driver.velocity = STANDSTILL
    moved_s = last_motion_s(simulation, until_s=told_s + 1.5)
    assert moved_s is not None
    assert 0.25 < moved_s - told_s < 0.7  # 50 ms of delay and 0.5 m/s at 2 m/s² are 0.3 s


def test_a_robot_that_drives_on_moves_until_the_end(driven: tuple[Driver, Simulation]) -> None:
    driver, simulation = driven
    drive(driver, simulation)
    until_s = time.monotonic() + 0.5
    moved_s = last_motion_s(simulation, until_s=until_s)
    assert moved_s is not None
    assert until_s - moved_s < 0.1


def test_a_base_without_commands_stands_within_0_7_s(driven: tuple[Driver, Simulation]) -> None:
    driver, simulation = driven
    drive(driver, simulation)
    silent_s = time.monotonic()
    driver.velocity = None
    moved_s = last_motion_s(simulation, until_s=silent_s + 1.5)
    assert moved_s is not None
    assert 0.25 <= moved_s - silent_s < 0.7  # it waits for 0.25 s
