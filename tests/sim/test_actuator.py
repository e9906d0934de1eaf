from __future__ import annotations

import pytest

from revnm_client.messages import STANDSTILL, Velocity
from revnm_sim.actuator import Actuator, ActuatorSpec

MS = 1_000_000


def drive(actuator: Actuator, until_ms: int, *, from_ms: int = 0, keep: Velocity | None = None) -> list[Velocity]:
    """Advance by 10 ms steps, repeating the command ``keep``; return the velocity after each step."""
    velocities = []
    for now_ms in range(from_ms, until_ms, 10):
        if keep is not None:
            actuator.command(keep, now_ms * MS)
        velocities.append(actuator.advance(now_ms * MS, 0.01))
    return velocities


def test_command_takes_effect_after_the_delay_and_ramps_up_at_1_mps2() -> None:
    velocities = drive(Actuator(ActuatorSpec()), 700, keep=Velocity(0.5, 0.0))
    speeds = [velocity.v_mps for velocity in velocities]
    assert speeds[:5] == [0.0] * 5  # 0 to 40 ms: still on its way
    # From 50 ms on 0.01 m/s per 10 ms: after the step at 50 ms 0.01, at 540 ms 0.50.
    assert speeds[5] == pytest.approx(0.01)
    assert speeds[29] == pytest.approx(0.25)
    assert speeds[54:] == pytest.approx([0.5] * 16)


def test_braking_is_twice_as_fast_as_speeding_up() -> None:
    actuator = Actuator(ActuatorSpec())
    drive(actuator, 1000, keep=Velocity(0.5, 0.0))
    speeds = [each.v_mps for each in drive(actuator, 1400, from_ms=1000, keep=STANDSTILL)]
    assert speeds[4] == pytest.approx(0.5)
    assert speeds[5] == pytest.approx(0.48)
    assert speeds[30:] == [0.0] * 10  # 0.25 s after the delay


def test_reversal_brakes_first_and_then_speeds_up() -> None:
    actuator = Actuator(ActuatorSpec(delay_ns=0))
    drive(actuator, 200, keep=Velocity(0.2, 0.0))  # 0.2 m/s
    speeds = [each.v_mps for each in drive(actuator, 550, from_ms=200, keep=Velocity(-0.2, 0.0))]
    assert speeds[9] == pytest.approx(0.0, abs=1e-12)  # 0.1 s of braking at 2 m/s²
    assert speeds[-1] == pytest.approx(-0.2)  # 0.2 s at 1 m/s²
    assert -0.11 < speeds[19] < -0.08
    assert speeds == sorted(speeds, reverse=True)


def test_turn_rate_changes_at_2_radps2() -> None:
    rates = [each.w_radps for each in drive(Actuator(ActuatorSpec(delay_ns=0)), 500, keep=Velocity(0.0, 0.7))]
    assert rates[9] == pytest.approx(0.2)
    assert rates[34:] == pytest.approx([0.7] * 16)


def test_commands_beyond_the_limits_are_clipped() -> None:
    velocity = drive(Actuator(ActuatorSpec()), 3000, keep=Velocity(-9.0, 9.0))[-1]
    assert velocity == Velocity(-0.5, 0.7)


def test_watchdog_brakes_when_commands_stop() -> None:
    actuator = Actuator(ActuatorSpec())
    drive(actuator, 1000, keep=Velocity(0.5, 0.7))  # the last command arrives at 990 ms
    speeds = [each.v_mps for each in drive(actuator, 1600, from_ms=1000)]
    assert speeds[23] == pytest.approx(0.5)  # 1230 ms
    assert speeds[24] < 0.5  # 1240 ms = 990 + 250
    assert speeds[-1] == 0.0
    assert actuator.velocity == STANDSTILL


def test_no_command_no_motion() -> None:
    assert set(drive(Actuator(ActuatorSpec()), 1000)) == {STANDSTILL}
