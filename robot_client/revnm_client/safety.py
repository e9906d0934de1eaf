"""The supervisor: the last word on every velocity. Anything amiss means zero, with the reason in words.

All times are in the robot's clock. An age is the larger of the age by stamp and the age by time of receipt,
so neither a wrong stamp nor a slow network makes old data look fresh.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from revnm_client.braking import BrakingConfig, is_collision_course
from revnm_client.geometry import FloatArray
from revnm_client.messages import STANDSTILL, Velocity

COLLISION_COURSE = "an obstacle lies within the stopping distance"
BACKWARDS = "driving backwards is only for backing off"


@dataclass(frozen=True, slots=True)
class SafetyConfig:
    """Limits of the supervisor.

    Attributes:
        max_plan_age_s: Since the capture of the plan's picture.
        max_scan_age_s: Of the newest scan.
        max_odometry_age_s: Of the newest odometry.
        max_ahead_s: How far in the future a stamp may lie before the clocks must be wrong.
        braking: How the robot stops.
    """

    max_plan_age_s: float = 0.5
    max_scan_age_s: float = 0.3
    max_odometry_age_s: float = 0.3
    max_ahead_s: float = 0.2
    braking: BrakingConfig = field(default_factory=BrakingConfig)


@dataclass(frozen=True, slots=True)
class Times:
    """When something was measured and when it was received, nanoseconds, robot's clock."""

    stamp_ns: int
    received_ns: int

    def age_s(self, now_ns: int) -> float:
        """Return the larger of both ages, seconds."""
        return (now_ns - min(self.stamp_ns, self.received_ns)) / 1e9

    def ahead_s(self, now_ns: int) -> float:
        """Return how far the later of both lies in the future, seconds; negative if in the past."""
        return (max(self.stamp_ns, self.received_ns) - now_ns) / 1e9


@dataclass(frozen=True, slots=True)
class Situation:
    """What the supervisor judges before anything is computed.

    Attributes:
        stopped: The stop is latched.
        trouble: Why the base would not obey, as its driver says; None where all is well.
        clock_known: The offset to the server's clock is known.
        odometry: Newest odometry; None before the first.
        scan: Newest scan.
        scan_trouble: Why it is not to be believed; None where it is.
        plan: Plan in force, by the capture of its picture.
    """

    stopped: bool
    trouble: str | None
    clock_known: bool
    odometry: Times | None
    scan: Times | None
    scan_trouble: str | None
    plan: Times | None


@dataclass(frozen=True, slots=True)
class Verdict:
    """What may be sent.

    Attributes:
        velocity: The command, or zero.
        reason: Why zero, in words for a person; None if the command stands.
    """

    velocity: Velocity
    reason: str | None


class Supervisor:
    """The rules of the design's section on safety."""

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config

    def objection(self, situation: Situation, now_ns: int) -> str | None:
        """Return why the robot must stand whatever the command; None if it may drive."""
        if situation.stopped:
            return "stopped until it is resumed"
        if situation.trouble is not None:
            return situation.trouble
        config = self._config
        return (
            self._stale("odometry", situation.odometry, config.max_odometry_age_s, now_ns)
            or self._stale("scan", situation.scan, config.max_scan_age_s, now_ns)
            or situation.scan_trouble
            or (None if situation.clock_known else "the clock offset to the server is unknown")
            or self._stale("plan", situation.plan, config.max_plan_age_s, now_ns)
        )

    def judge(self, command: Velocity, now: Velocity, points_m: FloatArray, *, least_v_mps: float = 0.0) -> Verdict:
        """Stop a command that leads into an obstacle, or backwards.

        Args:
            command: What the controller wants.
            now: Velocity of the robot.
            points_m: (M, 2) obstacle points, robot frame now.
            least_v_mps: Negative only where the robot may back off, which looks at the floor behind it.
        """
        if command.v_mps < least_v_mps:
            return Verdict(STANDSTILL, BACKWARDS)
        if is_collision_course(command, now, points_m, self._config.braking):
            return Verdict(STANDSTILL, COLLISION_COURSE)
        return Verdict(command, None)

    def _stale(self, name: str, times: Times | None, limit_s: float, now_ns: int) -> str | None:
        if times is None:
            return f"no {name} yet"
        if times.age_s(now_ns) > limit_s:
            return f"{name} is {times.age_s(now_ns):.1f} s old"
        if times.ahead_s(now_ns) > self._config.max_ahead_s:
            return f"{name} is stamped {times.ahead_s(now_ns):.1f} s in the future"
        return None
