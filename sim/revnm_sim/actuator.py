"""What lies between a velocity command and the wheels of a real base: delay, limits, and a watchdog.

Imports no simulator, so that the model can be tested by arithmetic.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from revnm_client.messages import STANDSTILL, Velocity


@dataclass(frozen=True, slots=True)
class ActuatorSpec:
    """Limits of the base.

    Attributes:
        max_v_mps: Greatest speed, forward and backward.
        max_w_radps: Greatest turn rate.
        speed_up_mps2: Greatest forward acceleration.
        brake_mps2: Greatest deceleration.
        turn_radps2: Greatest change of the turn rate.
        delay_ns: Time between the arrival of a command and its first effect.
        watchdog_ns: The base brakes by itself when the last command arrived this long ago.
    """

    max_v_mps: float = 0.5
    max_w_radps: float = 0.7
    speed_up_mps2: float = 1.0
    brake_mps2: float = 2.0
    turn_radps2: float = 2.0
    delay_ns: int = 50_000_000
    watchdog_ns: int = 250_000_000


class Actuator:
    """Turns commands into the velocity that the base really asks of its wheels."""

    def __init__(self, spec: ActuatorSpec) -> None:
        self._spec = spec
        self._pending: deque[tuple[int, Velocity]] = deque()
        self._target = STANDSTILL
        self._last_command_ns: int | None = None
        self._velocity = STANDSTILL

    @property
    def velocity(self) -> Velocity:
        """The velocity asked of the wheels now."""
        return self._velocity

    def command(self, velocity: Velocity, now_ns: int) -> None:
        """Take a command that arrives at ``now_ns``; what is beyond the limits is clipped."""
        spec = self._spec
        clipped = Velocity(
            _clip(velocity.v_mps, spec.max_v_mps),
            _clip(velocity.w_radps, spec.max_w_radps),
        )
        self._pending.append((now_ns + spec.delay_ns, clipped))
        self._last_command_ns = now_ns

    def advance(self, now_ns: int, dt_s: float) -> Velocity:
        """Move the velocity towards the command in force at ``now_ns`` for ``dt_s`` and return it."""
        spec = self._spec
        while self._pending and self._pending[0][0] <= now_ns:
            self._target = self._pending.popleft()[1]
        if self._last_command_ns is not None and now_ns - self._last_command_ns >= spec.watchdog_ns:
            self._target = STANDSTILL
            self._pending.clear()
        up, down = spec.speed_up_mps2 * dt_s, spec.brake_mps2 * dt_s
        turn = spec.turn_radps2 * dt_s
        self._velocity = Velocity(
            _approach(self._velocity.v_mps, self._target.v_mps, up=up, down=down),
            _approach(self._velocity.w_radps, self._target.w_radps, up=turn, down=turn),
        )
        return self._velocity


def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def _approach(value: float, target: float, *, up: float, down: float) -> float:
    """Step from ``value`` to ``target``: ``up`` at most away from 0, ``down`` at most towards it.

    A change of sign passes through 0 and rests there for one step.
    """
    if value * target < 0.0:
        target = 0.0
    step = up if abs(target) > abs(value) else down
    return value + _clip(target - value, step)
