"""Every rule that makes the robot stand, and every plan that it refuses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.braking import BrakingConfig, is_collision_course, rectangle_distance, stopping_poses
from revnm_client.errors import ConfigError
from revnm_client.messages import STANDSTILL, Plan, Velocity
from revnm_client.mppi import Footprint
from revnm_client.plan_gate import PlanGate
from revnm_client.safety import BACKWARDS, COLLISION_COURSE, SafetyConfig, Situation, Supervisor, Times

MS = 1_000_000
NOW = 100_000 * MS
OFFSET = 3_000 * MS
CRUISE = Velocity(0.5, 0.0)


def ago(milliseconds: int) -> Times:
    return Times(NOW - milliseconds * MS, NOW - milliseconds * MS)


def situation(**changes: object) -> Situation:
    good: dict[str, object] = {
        "stopped": False,
        "trouble": None,
        "clock_known": True,
        "odometry": ago(20),
        "scan": ago(50),
        "scan_trouble": None,
        "plan": ago(200),
    }
    return Situation(**{**good, **changes})  # type: ignore[arg-type]


def test_all_fresh_may_drive() -> None:
    assert Supervisor(SafetyConfig()).objection(situation(), NOW) is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"stopped": True}, "stopped until it is resumed"),
        ({"trouble": "a bumper is pressed"}, "a bumper is pressed"),
        ({"odometry": None}, "no odometry yet"),
        ({"odometry": ago(400)}, "odometry is 0.4 s old"),
        ({"scan": None}, "no scan yet"),
        ({"scan": ago(310)}, "scan is 0.3 s old"),
        ({"scan_trouble": "scan sees nothing"}, "scan sees nothing"),
        ({"clock_known": False}, "the clock offset to the server is unknown"),
        ({"plan": None}, "no plan yet"),
        ({"plan": ago(900)}, "plan is 0.9 s old"),
        ({"plan": ago(510)}, "plan is 0.5 s old"),
        ({"scan": ago(-700)}, "scan is stamped 0.7 s in the future"),
        ({"plan": Times(NOW - 900 * MS, NOW)}, "plan is 0.9 s old"),
        ({"plan": Times(NOW, NOW - 900 * MS)}, "plan is 0.9 s old"),
    ],
)
def test_anything_amiss_is_named(changes: dict[str, object], reason: str) -> None:
    assert Supervisor(SafetyConfig()).objection(situation(**changes), NOW) == reason


@pytest.mark.parametrize("changes", [{"scan": ago(300)}, {"plan": ago(500)}, {"odometry": ago(300)}])
def test_limits_themselves_are_allowed(changes: dict[str, object]) -> None:
    assert Supervisor(SafetyConfig()).objection(situation(**changes), NOW) is None


def test_stopping_distance_at_cruise() -> None:
    poses = stopping_poses(CRUISE, CRUISE, BrakingConfig(delay_s=0.15, braking_mps2=1.0))
    # v * delay + v^2 / (2 a) = 0.075 + 0.125.
    assert poses[-1].tolist() == pytest.approx([0.2, 0.0, 0.0])


def test_stopping_angle_of_a_turn() -> None:
    spin = Velocity(0.0, 0.7)
    poses = stopping_poses(spin, spin, BrakingConfig(delay_s=0.15, braking_radps2=2.0))
    # w * delay + w^2 / (2 alpha) = 0.105 + 0.1225.
    assert poses[-1].tolist() == pytest.approx([0.0, 0.0, 0.2275])


def test_rectangle_distance_by_hand() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, math.pi / 2]])
    points = np.array([[0.315, 0.0], [0.0, 0.0], [0.245, 0.22], [1.0, 0.3]])
    distance = rectangle_distance(points, poses, Footprint())
    # The front side lies at 0.215, the left one at 0.18; the middle is 0.18 deep; off the corner 0.03, 0.04.
    assert distance[0, :3].tolist() == pytest.approx([0.1, -0.18, 0.05])
    assert distance[1, 3] == pytest.approx(0.3 - 0.215)
    # The middle 0.1 m ahead: the front lies at 0.315, the rear 0.115 behind the frame.
    shifted = rectangle_distance(points, poses, Footprint(center_x_m=0.1))
    assert shifted[0, :2].tolist() == pytest.approx([0.0, -0.115])
    assert shifted[1, 3] == pytest.approx(0.3 - 0.315)


@pytest.mark.parametrize(
    ("point", "command", "stops"),
    [
        ((0.440, 0.0), CRUISE, True),  # 0.215 to the front side + 0.2 to stop + 0.03 margin = 0.445
        ((0.450, 0.0), CRUISE, False),
        ((0.430, 0.22), CRUISE, False),  # beside the lane: 0.18 + 0.03
        ((0.430, 0.19), CRUISE, True),
        ((0.0, 0.25), Velocity(0.0, 0.7), False),  # beside the middle; the corner does not get that far
        ((0.15, 0.21), Velocity(0.0, 0.7), True),  # the front left corner sweeps over it
        ((-0.5, 0.0), CRUISE, False),
    ],
)
def test_collision_course(point: tuple[float, float], command: Velocity, stops: bool) -> None:
    verdict = Supervisor(SafetyConfig()).judge(command, command, np.array([point]))
    assert verdict.velocity == (STANDSTILL if stops else command)
    assert verdict.reason == (COLLISION_COURSE if stops else None)


def test_backwards_only_where_it_may_back_off() -> None:
    supervisor, back, nothing = Supervisor(SafetyConfig()), Velocity(-0.15, 0.0), np.empty((0, 2))
    assert supervisor.judge(back, STANDSTILL, nothing).reason == BACKWARDS
    assert supervisor.judge(back, STANDSTILL, nothing, least_v_mps=-0.15).velocity == back
    assert supervisor.judge(Velocity(-0.16, 0.0), STANDSTILL, nothing, least_v_mps=-0.15).velocity == STANDSTILL
    close = np.array([[-0.27, 0.0]])  # the rear at 0.215 + 0.15 * 0.15 + 0.15^2 / 2 + 0.03 = 0.279
    assert supervisor.judge(back, back, close, least_v_mps=-0.15).reason == COLLISION_COURSE


def test_the_rectangle_may_lie_behind_the_frame() -> None:
    # Turning about a frame 0.2 m ahead of the middle, the rear corners reach hypot(0.415, 0.18) = 0.452.
    spin, beside = Velocity(0.0, 0.7), np.array([[-0.38, 0.235]])
    rear_heavy = SafetyConfig(braking=BrakingConfig(footprint=Footprint(center_x_m=-0.2)))
    assert Supervisor(SafetyConfig()).judge(spin, spin, beside).reason is None
    assert Supervisor(rear_heavy).judge(Velocity(0.0, -0.7), Velocity(0.0, -0.7), beside).reason == COLLISION_COURSE


def test_arc_is_followed_not_the_straight_line() -> None:
    left = Velocity(0.5, 0.7)
    ahead_right = np.array([[0.425, -0.17]])
    config = BrakingConfig()
    assert is_collision_course(CRUISE, CRUISE, ahead_right, config)
    assert not is_collision_course(left, left, ahead_right, config)


def test_robot_too_near_may_leave_but_not_go_nearer() -> None:
    nose = np.array([[0.225, 0.0]])  # 1 cm in front
    config = BrakingConfig()
    assert is_collision_course(Velocity(0.02, 0.0), STANDSTILL, nose, config)
    assert not is_collision_course(STANDSTILL, STANDSTILL, nose, config)
    tail = np.array([[-0.225, 0.0]])
    assert not is_collision_course(CRUISE, STANDSTILL, tail, config)


def plan(*, seq: int = 1, epoch: int = 0, stamp_ms: int = -100) -> Plan:
    return Plan(NOW + OFFSET + stamp_ms * MS, np.array([[1.0, 0.0]]), epoch, seq, "goal")


def accepts(
    gate: PlanGate,
    item: Plan,
    *,
    offset_ns: int | None = OFFSET,
    server: str | None = None,
    has_pose: bool = True,
) -> bool:
    return gate.accepts(item, received_ns=NOW, offset_ns=offset_ns, server=server, has_pose=has_pose)


def test_sequence_must_rise_within_an_epoch() -> None:
    gate = PlanGate()
    assert accepts(gate, plan(seq=5))
    assert not accepts(gate, plan(seq=5))
    assert not accepts(gate, plan(seq=4))
    assert accepts(gate, plan(seq=6))
    assert gate.refused == {"seq": 2}
    assert gate.last_refusal == "plan 4 is not newer than plan 5"


def test_newer_epoch_restarts_the_sequence_and_older_one_is_refused() -> None:
    gate = PlanGate()
    assert accepts(gate, plan(seq=90, epoch=2))
    assert accepts(gate, plan(seq=1, epoch=3))
    assert not accepts(gate, plan(seq=91, epoch=2))
    assert (gate.epoch, gate.seq) == (3, 1)
    assert gate.refused == {"epoch": 1}


@pytest.mark.parametrize(
    ("item", "how", "kind"),
    [
        (plan(stamp_ms=250), {}, "future"),
        (plan(), {"offset_ns": None}, "clock"),
        (plan(), {"has_pose": False}, "odometry"),
        (plan(epoch=9), {"server": "hall"}, "server"),
    ],
)
def test_refusal_is_counted_and_changes_nothing(item: Plan, how: dict[str, object], kind: str) -> None:
    gate = PlanGate()
    assert not accepts(gate, item, **how)  # type: ignore[arg-type]
    assert gate.refused == {kind: 1}
    assert (gate.epoch, gate.seq) == (0, None)


def test_only_the_server_that_is_followed_leads() -> None:
    gate = PlanGate()
    ours, others = replace(plan(seq=3), server="hall"), replace(plan(seq=9, epoch=7), server="yard")
    assert accepts(gate, ours, server="hall")
    assert not accepts(gate, others, server="hall")
    assert gate.last_refusal == "plan of server yard: this robot follows hall"
    assert (gate.epoch, gate.seq) == (0, 3)
    assert accepts(gate, others, server="yard")


def test_stamp_a_little_in_the_future_passes() -> None:
    assert accepts(PlanGate(), plan(stamp_ms=150))


def test_stop_latches_and_raises_the_epoch_and_never_lowers_it() -> None:
    gate = PlanGate()
    gate.stop(4)
    assert (gate.stopped, gate.epoch) == (True, 4)
    gate.stop(2)
    assert (gate.stopped, gate.epoch) == (True, 4)
    assert not accepts(gate, plan(epoch=3))
    assert gate.stopped
    gate.resume(4)
    assert (gate.stopped, gate.epoch) == (False, 4)
    assert accepts(gate, plan(epoch=4))


def test_resume_raises_the_epoch_too_and_never_lowers_it() -> None:
    gate = PlanGate()
    gate.stop(4)
    gate.resume(6)
    assert (gate.stopped, gate.epoch) == (False, 6)
    assert not accepts(gate, plan(epoch=5))
    gate.resume(2)
    assert gate.epoch == 6


@pytest.mark.parametrize(
    "bad", [{"braking_mps2": 0.0}, {"braking_radps2": -1.0}, {"braking_mps2": math.nan}, {"margin_m": -0.01}]
)
def test_a_robot_that_never_stops_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="decelerations over 0"):
        BrakingConfig(**bad)
