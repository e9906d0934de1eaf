from __future__ import annotations

import math
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import zenoh
from numpy.typing import NDArray

from revnm_client import cdr, keys
from revnm_client.geometry import Pose2
from revnm_client.link import Inbox, LatestSubscriber, open_client, open_router
from revnm_client.messages import Odometry, Velocity
from revnm_sim.camera import Camera
from revnm_sim.live.simulator import LiveSettings, LiveSimulator
from revnm_sim.live.truth import decode_truth, truth_key
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.world import Bounds, Primitive, Shape, World

WALL = Primitive(Shape.BOX, (4.0, 0.0, 0.5), (0.4, 6.0, 1.0), 0.0, (200, 60, 60))
SCENARIO = Scenario(
    world=World("test", Bounds(-5.0, -5.0, 5.0, 5.0), (150, 150, 150), (WALL,)),
    camera=Camera(320, 240, 1.4, (-2.0, 0.0, 2.5), 0.0, 0.7),
    start=Pose2(0.0, 0.0, 0.0),
    goal_m=(3.0, 1.0),
    seed=0,
)


@dataclass
class Bench:
    """The router's end of a simulator that runs live."""

    session: zenoh.Session
    simulator: LiveSimulator
    odometry: Inbox[Odometry]
    shown: list[NDArray[np.uint8]]

    def wait(self, condition: Callable[[], bool], within_s: float) -> float:
        """Wait for a condition; return how long that took."""
        pause = threading.Event()
        began = time.monotonic()
        while not condition():
            assert time.monotonic() - began < within_s, f"not within {within_s} s"
            pause.wait(0.005)
        return time.monotonic() - began

    def speed_mps(self) -> float | None:
        """Return the measured speed if there is news."""
        message = self.odometry.take()
        return None if message is None else message.velocity.v_mps

    def reaches(self, condition: Callable[[float], bool]) -> Callable[[], bool]:
        """Return a check whether the newest measured speed fulfils a condition."""

        def check() -> bool:
            speed = self.speed_mps()
            return speed is not None and condition(speed)

        return check

    def command(self, payload: bytes) -> None:
        """Put something on the robot's velocity key."""
        self.session.put(keys.cmd_vel("rover"), payload)

    def drive_until(self, velocity: Velocity, condition: Callable[[float], bool], within_s: float) -> None:
        """Repeat a command until the measured speed fulfils a condition."""
        reached = self.reaches(condition)

        def commanded() -> bool:
            self.command(cdr.encode_velocity(velocity))
            return reached()

        self.wait(commanded, within_s)


@pytest.fixture
def bench() -> Iterator[Bench]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    stop, shown = threading.Event(), []
    with (
        open_router([endpoint]) as router,
        open_client([endpoint]) as client,
        Simulation(SCENARIO, 1) as simulation,
        LatestSubscriber(router, keys.odom("rover")) as odometry,
        LiveSimulator(simulation, client, LiveSettings("rover", "cam0", fps=10.0), show=shown.append) as simulator,
    ):
        thread = threading.Thread(target=simulator.run, args=(stop,))
        thread.start()
        yield Bench(router, simulator, Inbox(odometry, cdr.decode_odometry), shown)
        stop.set()
        thread.join(timeout=5.0)
        assert not thread.is_alive()


def test_every_sensor_publishes_with_fresh_wall_clock_stamps(bench: Bench) -> None:
    with (
        LatestSubscriber(bench.session, keys.scan("rover")) as scans,
        LatestSubscriber(bench.session, keys.image("cam0")) as pictures,
        LatestSubscriber(bench.session, truth_key("rover")) as truths,
    ):
        for subscriber, decode in ((scans, cdr.decode_scan), (pictures, cdr.decode_image)):
            samples: list[zenoh.Sample] = []
            bench.wait(lambda s=subscriber, out=samples: bool(out.append(s.take()) or out[-1]), 5.0)
            message = decode(samples[-1].payload.to_bytes())
            assert abs(time.time_ns() - message.stamp_ns) < 1_000_000_000
        texts: list[zenoh.Sample] = []
        bench.wait(lambda: bool(texts.append(truths.take()) or texts[-1]), 5.0)
        truth = decode_truth(texts[-1].payload.to_bytes())
        assert truth.contact is False
        assert truth.closest_m == pytest.approx(1.0)


def test_a_silent_sensor_publishes_nothing_and_the_others_go_on(bench: Bench) -> None:
    bench.wait(lambda: bench.odometry.take() is not None, 5.0)
    bench.simulator.silent = frozenset({"odometry"})
    with (
        LatestSubscriber(bench.session, keys.scan("rover")) as scans,
        LatestSubscriber(bench.session, truth_key("rover")) as truths,
    ):
        bench.wait(lambda: scans.take() is not None, 5.0)
        bench.odometry.take()
        bench.wait(lambda: truths.take() is not None, 5.0)
        bench.wait(lambda: scans.take() is not None, 5.0)
        assert bench.odometry.take() is None
        bench.simulator.silent = frozenset({"scan"})
        bench.wait(lambda: bench.odometry.take() is not None, 5.0)
        scans.take()
        bench.wait(lambda: truths.take() is not None, 5.0)
        assert scans.take() is None


def test_whoever_else_films_gets_every_picture(bench: Bench) -> None:
    bench.wait(lambda: len(bench.shown) >= 3, 5.0)
    assert bench.shown[-1].shape == (240, 320, 3)


def test_simulated_time_keeps_up_with_the_clock(bench: Bench) -> None:
    with LatestSubscriber(bench.session, truth_key("rover")) as truths:
        times: list[tuple[float, float]] = []

        def listened() -> bool:
            sample = truths.take()
            if sample is not None:
                times.append((time.monotonic(), decode_truth(sample.payload.to_bytes()).time_s))
            return len(times) >= 8

        bench.wait(listened, 10.0)
    wall_s, simulated_s = times[-1][0] - times[0][0], times[-1][1] - times[0][1]
    assert simulated_s == pytest.approx(wall_s, abs=0.3)


def test_command_moves_the_robot_and_silence_stops_it_within_0_7_s(bench: Bench) -> None:
    bench.drive_until(Velocity(0.5, 0.0), lambda speed: speed > 0.45, 5.0)
    # 0.25 s watchdog and 0.25 s of braking; odometry comes every 25 ms.
    assert bench.wait(bench.reaches(lambda speed: speed < 0.01), 2.0) < 0.7


def test_zero_velocity_stops_the_robot(bench: Bench) -> None:
    bench.drive_until(Velocity(0.0, 0.0), lambda speed: abs(speed) < 0.01, 5.0)
    bench.drive_until(Velocity(0.3, 0.0), lambda speed: speed > 0.25, 5.0)
    bench.drive_until(Velocity(0.0, 0.0), lambda speed: abs(speed) < 0.01, 2.0)


def test_garbage_on_the_velocity_key_is_counted_and_dropped(bench: Bench) -> None:
    good = cdr.encode_velocity(Velocity(0.5, 0.0))
    not_a_number = good[:4] + b"\xff" * 8 + good[12:]
    for garbage in (b"", b"\x00", b"stop please", good[:-8], not_a_number):
        before = bench.simulator.rejected

        def counted(garbage: bytes = garbage, before: int = before) -> bool:
            bench.command(garbage)
            return bench.simulator.rejected > before

        bench.wait(counted, 5.0)
    speeds = []
    bench.wait(lambda: (speed := bench.speed_mps()) is not None and not speeds.append(speed), 2.0)
    assert math.isclose(speeds[0], 0.0, abs_tol=1e-3)
    bench.drive_until(Velocity(0.3, 0.0), lambda speed: speed > 0.25, 5.0)
