"""Getting unstuck: when, whereto, and never over floor that nobody has seen."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_client.braking import BrakingConfig
from revnm_client.escape import BACKING_OFF, NO_WAY_OUT, TURNING, Escape, Surroundings
from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Scan, Velocity
from revnm_client.mppi import MppiConfig
from revnm_client.seen_floor import SeenFloor

NOTHING = np.empty((0, 2))
HERE = Pose2(3.0, -1.0, 0.5)
SECOND_NS = 1_000_000_000
ALLEY = np.stack([np.tile(np.arange(-0.2, 1.0, 0.02), 2), np.repeat([-0.24, 0.24], 60)], axis=1)  # no room to turn


def escape() -> Escape:
    return Escape(MppiConfig(), BrakingConfig())


def around(pose: Pose2 = HERE, points: FloatArray = NOTHING, *, blind: bool = False) -> Surroundings:
    return Surroundings(pose, points, lambda places: np.full(len(places), not blind))


def box(x: float, y: float) -> FloatArray:
    """Points every 2 cm on the rectangle from (-x, -y) to (x, y)."""
    xs, ys = np.arange(-x, x, 0.02), np.arange(-y, y, 0.02)
    sides = [np.stack([xs, np.full_like(xs, side)], axis=1) for side in (-y, y)]
    return np.concatenate([*sides, *(np.stack([np.full_like(ys, side), ys], axis=1) for side in (-x, x))])


def stuck(machine: Escape, surroundings: Surroundings) -> int:
    """Stand until something is done; return when, ns."""
    now_ns = 0
    while machine.step(now_ns, surroundings) is None:
        now_ns += SECOND_NS // 20
        assert now_ns < 100 * SECOND_NS
    return now_ns


def test_backs_off_after_five_seconds_for_thirty_centimetres() -> None:
    machine = escape()
    now_ns = stuck(machine, around(points=ALLEY))
    assert now_ns == 5 * SECOND_NS
    ways = [machine.step(now_ns, around(HERE @ Pose2(-0.01 * i, 0.0, 0.0))) for i in range(29)]
    assert {(way.velocity, way.reason) for way in ways if way} == {(Velocity(-0.15, 0.0), BACKING_OFF)}
    assert None not in ways
    assert machine.step(now_ns, around(HERE @ Pose2(-0.301, 0.0, 0.0))) is None


def test_a_robot_that_could_turn_is_given_more_time() -> None:
    assert stuck(escape(), around()) == 15 * SECOND_NS


@pytest.mark.parametrize("step", [Pose2(0.0015, 0.0, 0.0), Pose2(0.0, 0.0, 0.01)])
def test_a_robot_that_gets_on_is_left_alone(step: Pose2) -> None:
    # 0.03 m/s, or 0.2 rad/s: 0.15 m or 1 rad in five seconds, where 0.1 m or 0.5 rad are enough.
    machine, pose = escape(), HERE
    for index in range(400):
        assert machine.step(index * SECOND_NS // 20, around(pose)) is None
        pose @= step


def test_wobbling_on_the_spot_is_being_stuck() -> None:
    machine = escape()
    ways = [machine.step(i * SECOND_NS // 20, around(HERE @ Pose2(0.0, 0.0, 0.2 * math.sin(i)))) for i in range(310)]
    assert any(ways)


def test_standing_on_purpose_is_not() -> None:
    machine = escape()
    for index in range(400):
        assert machine.step(index * SECOND_NS // 20, around(points=ALLEY)) is None
        if index % 80 == 0:
            machine.reset()  # the end of the plan, a stop, a stale plan


def test_does_not_back_onto_an_obstacle_or_unseen_floor() -> None:
    # The rear lies at -0.215; 0.1 m behind it and the margin of 0.03 m must be free.
    machine, near, far = escape(), np.array([[-0.34, 0.1]]), np.array([[-0.36, 0.1]])
    stuck(machine, around(points=far))
    backs = machine.step(16 * SECOND_NS, around(points=far))
    assert backs is not None
    assert backs.reason == BACKING_OFF
    assert machine.step(16 * SECOND_NS, around(points=near)) is None  # stops there
    for surroundings in (around(points=near), around(points=far, blind=True)):
        machine = escape()
        stuck(machine, surroundings)
        way = machine.step(16 * SECOND_NS, surroundings)
        assert way is None or way.reason != BACKING_OFF


def test_what_takes_longer_to_stop_looks_farther_behind() -> None:
    # At 0.15 m/s after 1 s of delay and with 0.1 m/s² it comes to rest after 0.26 m.
    slow = Escape(MppiConfig(), BrakingConfig(delay_s=1.0, braking_mps2=0.1))
    asked: list[FloatArray] = []

    def seen(places: FloatArray) -> np.ndarray:
        asked.append(places)
        return places[:, 0] > -0.215 - 0.2

    now_ns = 0
    while (way := slow.step(now_ns, Surroundings(HERE, NOTHING, seen))) is None:
        now_ns += SECOND_NS
    assert way.reason != BACKING_OFF
    assert min(places[:, 0].min() for places in asked) < -0.215 - 0.26
    wall = np.array([[-0.45, 0.0]])
    assert not slow._may_back(around(points=wall))
    assert Escape(MppiConfig(), BrakingConfig())._may_back(around(points=wall))


def test_an_obstacle_ahead_that_is_too_near_does_not_hinder_backing_off() -> None:
    machine = escape()
    touching = around(points=np.array([[0.22, 0.0]]))
    way = machine.step(stuck(machine, touching), touching)
    assert way is not None
    assert way.reason == BACKING_OFF


def test_turns_the_short_way_to_room_where_it_may_not_back_off() -> None:
    # Walls ahead and on the left, one metre or more on the right and behind.
    walls = box(0.6, 0.6)
    walls = walls[(walls[:, 0] > 0.59) | (walls[:, 1] > 0.57)]
    machine = escape()
    now_ns = stuck(machine, around(points=walls, blind=True))
    way = machine.step(now_ns, around(points=walls, blind=True))
    assert way is not None
    assert way.reason == TURNING
    assert way.velocity is not None
    assert way.velocity.v_mps == 0.0
    assert way.velocity.w_radps == -0.5
    # The nearest heading whose lane of 0.42 m passes the wall ahead, which ends at y = -0.6.
    turned = 0.0
    while machine.step(now_ns, around(HERE @ Pose2(0.0, 0.0, -turned), walls, blind=True)) is not None:
        turned += 0.01
    assert math.pi / 4 < turned <= math.pi / 2


def test_stays_and_says_so_where_there_is_no_way_out() -> None:
    machine, cage = escape(), around(points=box(0.27, 0.23))
    way = machine.step(stuck(machine, cage), cage)
    assert way is not None
    assert (way.velocity, way.reason) == (None, NO_WAY_OUT)
    # What blocked it goes: it backs off at once.
    freed = machine.step(60 * SECOND_NS, around())
    assert freed is not None
    assert freed.reason == BACKING_OFF


def test_a_base_that_does_not_obey_ends_it_and_the_next_one_is_waited_for_longer() -> None:
    machine = escape()
    began: list[float] = []
    before = None
    for index in range(20 * 105):
        way = machine.step(index * SECOND_NS // 20, around(points=ALLEY))
        if way is not None and before is None:
            began.append(index / 20)
        before = way
    # 5 s of patience, 4 s of trying, then 10 s and 8 s, 20 s and 12 s, 40 s.
    assert began == pytest.approx([5.0, 19.0, 47.0, 99.0], abs=0.21)


def test_patience_is_short_again_elsewhere() -> None:
    machine = escape()
    now_ns = stuck(machine, around(points=ALLEY)) + 5 * SECOND_NS
    elsewhere = around(HERE @ Pose2(1.1, 0.0, 0.0), ALLEY)
    assert machine.step(now_ns, elsewhere) is None
    assert machine.step(now_ns + 5 * SECOND_NS, elsewhere) is not None


def scan(ranges: float, *, stamp_ns: int = 0, masked_rad: float = math.tau) -> Scan:
    angles = np.arange(360) * (math.tau / 360) - math.pi
    measured = np.where(np.abs(angles) <= masked_rad, ranges, 0.0).astype(np.float32)
    return Scan(stamp_ns, -math.pi, math.tau / 360, 0.1, 12.0, measured)


def test_floor_is_seen_by_any_scan_of_the_last_two_seconds() -> None:
    floor, behind = SeenFloor(), np.array([[-0.4, 0.0], [-0.3, 0.1]])
    assert not floor.seen(behind, Pose2(0.0, 0.0, 0.0)).any()
    floor.add(scan(5.0, masked_rad=1.7), Pose2(0.0, 0.0, math.pi))  # looked the other way, blind behind
    blind = scan(5.0, masked_rad=1.7, stamp_ns=SECOND_NS)
    floor.add(blind, Pose2(0.0, 0.0, 0.0))
    assert floor.newest is blind
    assert floor.seen(behind, Pose2(0.0, 0.0, 0.0)).all()
    floor.add(scan(5.0, masked_rad=1.7, stamp_ns=2 * SECOND_NS + 1), Pose2(0.0, 0.0, 0.0))
    assert not floor.seen(behind, Pose2(0.0, 0.0, 0.0)).any()
    floor.clear()
    assert not floor.seen(-behind, Pose2(0.0, 0.0, 0.0)).any()


def test_floor_behind_something_is_not_seen() -> None:
    floor = SeenFloor()
    floor.add(scan(0.5), Pose2(1.0, 0.0, 0.0))
    places = np.array([[-0.4, 0.0], [-0.7, 0.0]])
    assert floor.seen(places, Pose2(1.0, 0.0, 0.0)).tolist() == [True, False]
