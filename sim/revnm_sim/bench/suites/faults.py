"""What may go wrong between server, sensors and robot while it drives: one class a fault.

A fault knows how long it lasts, when the robot must have noticed, and whether the robot may go on by itself once it is
over. Limits are those of the robot's supervisor.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from revnm_client.geometry import Pose2
from revnm_client.messages import Odometry, Plan, Scan
from revnm_client.safety import SafetyConfig
from revnm_sim.bench.suites.drive import Wires
from revnm_sim.bench.trial import CONTROL_S

_LIMITS = SafetyConfig()
_WATCHED_S = 10.0  # a fault that does not end
_STUCK_S = 0.3  # three scans alike at 10 Hz: by then a robot that drives has moved by 3 cm
_FLOOD_PER_TICK = round(1000 * CONTROL_S)  # at 1 kHz
_CLOCK_STEP_NS = 5_000_000_000
_PROBE_S = (0.1, 1.1)  # until the robot has asked for the server's time anew

Rng = np.random.Generator


class Fault(Wires):
    """Wires in which something goes wrong from :meth:`begin` to :meth:`end`.

    Attributes:
        limit_s: The rule's: after this the robot must stand; None where it may drive on.
        heals: Whether the fault ends, so that the robot must arrive in spite of it.
        hold_s: How long it lasts, drawn; 0: an instant.
        active: Whether it is on.
    """

    limit_s: ClassVar[float | None]
    heals: ClassVar[bool] = True

    def __init__(self, rng: Rng) -> None:
        """Draw what is random in it."""
        self.hold_s = float(rng.uniform(2.0, 5.0))
        self.active = False

    def begin(self) -> None:
        """Go wrong from now on."""
        self.active = True

    def end(self) -> None:
        """Be right again from now on."""
        self.active = False


class ServerKilled(Fault):
    """No plans any more, no answers of its clock either; what the robot knew of the clock remains."""

    limit_s = _LIMITS.max_plan_age_s
    heals = False

    def __init__(self, rng: Rng) -> None:
        super().__init__(rng)
        self.hold_s = _WATCHED_S

    def plans(self, due: list[Plan]) -> list[Plan]:
        """Return nothing once it is killed."""
        return [] if self.active else due


class RouterFrozen(Fault):
    """No plans for a while; then those that waited come all at once, or were dropped."""

    limit_s = _LIMITS.max_plan_age_s

    def __init__(self, rng: Rng) -> None:
        super().__init__(rng)
        self._drops = bool(rng.integers(2))
        self._waiting: list[Plan] = []

    def plans(self, due: list[Plan]) -> list[Plan]:
        """Keep the plans back while frozen."""
        plans = [*self._waiting, *due]
        self._waiting = [] if self._drops or not self.active else plans
        return [] if self.active else plans


class LidarSilent(Fault):
    """No scans for a while."""

    limit_s = _LIMITS.max_scan_age_s

    def scan(self, scan: Scan) -> Scan | None:
        """Return nothing while silent."""
        return None if self.active else scan


class LidarStuck(Fault):
    """The ranges of one scan again and again, with fresh stamps."""

    limit_s = _STUCK_S

    def __init__(self, rng: Rng) -> None:
        super().__init__(rng)
        self._last: Scan | None = None

    def scan(self, scan: Scan) -> Scan:
        """Return the last scan before it was stuck, stamped anew."""
        if self.active and self._last is not None:
            return replace(self._last, stamp_ns=scan.stamp_ns)
        self._last = scan
        return scan


class OdometryJump(Fault):
    """The pose jumps by 1 to 5 m for good, as when a base restarts, or the stamps lag by 0.5 to 3 s for a while."""

    limit_s = _LIMITS.max_odometry_age_s

    def __init__(self, rng: Rng) -> None:
        super().__init__(rng)
        self._lag_ns = round(rng.uniform(0.5, 3.0) * 1e9) if rng.integers(2) else 0
        distance_m, bearing = rng.uniform(1.0, 5.0), rng.uniform(-math.pi, math.pi)
        self._shift = Pose2(distance_m * math.cos(bearing), distance_m * math.sin(bearing), rng.uniform(-3.0, 3.0))
        self._new_from_old: Pose2 | None = None
        self._late: list[Plan] = []
        if not self._lag_ns:
            self.hold_s = 0.0

    def odometry(self, odometry: Odometry) -> Odometry:
        """Return it displaced in time while the fault lasts, or in place for ever after."""
        if self._lag_ns:
            return replace(odometry, stamp_ns=odometry.stamp_ns - self._lag_ns) if self.active else odometry
        pose = odometry.odom_from_robot
        if self.active and self._new_from_old is None:
            x, y, yaw = self._shift
            self._new_from_old = Pose2(pose.x_m + x, pose.y_m + y, pose.yaw_rad + yaw) @ pose.inverse()
        if self._new_from_old is None:
            return odometry
        return replace(odometry, odom_from_robot=self._new_from_old @ pose)

    def plans(self, due: list[Plan]) -> list[Plan]:
        """Return what is due, one tick late where the pose jumps: else the robot need not stand even for a moment."""
        plans = [*self._late, *due]
        jumps = self.active and not self._lag_ns
        self._late = plans if jumps else []
        return [] if jumps else plans


class PlanFlood(Fault):
    """The server runs away: 1000 plans a second, half of them the newest under new numbers, half of them old ones."""

    limit_s = None

    def __init__(self, rng: Rng) -> None:
        super().__init__(rng)
        self._rng = rng
        self._known: deque[Plan] = deque(maxlen=50)
        self._seq = 0

    def plans(self, due: list[Plan]) -> list[Plan]:
        """Return what is due in the flood's numbers, and the flood while it lasts."""
        plans = [self._number(plan) for plan in due]
        if self.active and self._known:
            plans += [self._one() for _ in range(_FLOOD_PER_TICK)]
        return plans

    def _one(self) -> Plan:
        if self._rng.integers(2):
            return self._number(max(self._known, key=lambda plan: plan.stamp_ns))
        return self._known[int(self._rng.integers(len(self._known)))]

    def _number(self, plan: Plan) -> Plan:
        self._seq += 1
        numbered = replace(plan, seq=self._seq)
        self._known.append(numbered)
        return numbered


class ClockStep(Fault):
    """Somebody sets the robot's wall clock by ± 5 s; the offset to the server's is unknown until it is asked for."""

    limit_s = 0.0

    def __init__(self, rng: Rng) -> None:
        super().__init__(rng)
        self.hold_s = float(rng.uniform(*_PROBE_S))
        self._step_ns = _CLOCK_STEP_NS * int(rng.choice([-1, 1]))

    def begin(self) -> None:
        """Set the clock."""
        super().begin()
        self.clock_shift_ns = self._step_ns

    def clock_offset_ns(self, right_ns: int) -> int | None:
        """Return None until the server has answered."""
        return None if self.active else right_ns


FAULTS: Mapping[str, type[Fault]] = MappingProxyType(
    {
        "server_killed": ServerKilled,
        "router_frozen": RouterFrozen,
        "lidar_silent": LidarSilent,
        "lidar_stuck": LidarStuck,
        "odometry_jump": OdometryJump,
        "plan_flood": PlanFlood,
        "clock_step": ClockStep,
    }
)
