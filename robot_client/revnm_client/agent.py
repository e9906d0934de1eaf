"""The whole robot brain, without input, output or clock: what the live loop and the benchmark both drive."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from revnm_client.braking import stopping_poses
from revnm_client.errors import ConfigError
from revnm_client.escape import BACK_MPS, LEAST_MPS, Escape, Surroundings
from revnm_client.geometry import FloatArray
from revnm_client.messages import STANDSTILL, Mounting, Odometry, Plan, Scan, Velocity
from revnm_client.mppi import Mppi, MppiConfig, MppiInput
from revnm_client.obstacle_memory import ObstacleMemory
from revnm_client.plan_gate import PlanGate
from revnm_client.plan_tracking import OdometryBuffer, TrackedPlan, track
from revnm_client.safety import SafetyConfig, Situation, Supervisor, Times, Verdict
from revnm_client.scan_watch import ScanWatch
from revnm_client.seen_floor import SeenFloor
from revnm_client.sight import speed_limit_mps

ARRIVED = "at the end of the plan"
BLIND = "the LiDAR is blind ahead"

_NEARLY_THERE_M = 0.5  # so near to the end of the plan, standing is no reason to escape


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """Settings of the robot brain.

    Attributes:
        robot: Name, as in the keys.
        seed: Of the controller's noise.
        lidar: How the LiDAR is mounted.
        arrive_m: The robot stands once the last waypoint is this near...
        leave_m: ...and drives again when it is farther than this.
        mppi: The controller.
        safety: The supervisor.
    """

    robot: str = "robot"
    seed: int = 0
    lidar: Mounting = field(default_factory=Mounting)
    arrive_m: float = 0.12
    leave_m: float = 0.2
    mppi: MppiConfig = field(default_factory=MppiConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)

    def __post_init__(self) -> None:
        if self.mppi.footprint != self.safety.braking.footprint:
            raise ConfigError("the controller and the supervisor have different footprints: expected one robot's")


@dataclass(frozen=True, slots=True)
class Tick:
    """Result of one tick.

    Attributes:
        velocity: To be sent to the base.
        reason: Why the robot does not follow the plan, in words; None while it does.
        mppi_ms: Time that the controller took; 0 where it was not asked.
    """

    velocity: Velocity
    reason: str | None
    mppi_ms: float


class RobotAgent:
    """Takes in scans, odometry and plans; gives a velocity every control period.

    All times come in as arguments, in nanoseconds of one clock of the robot, in which scans and odometry are
    stamped too; plans are stamped in the server's clock. So simulated time works as well as real time.
    Not thread-safe: one loop owns it.
    """

    def __init__(self, config: AgentConfig, *, stopwatch_ns: Callable[[], int] = time.perf_counter_ns) -> None:
        """Create the agent.

        Args:
            config: Settings.
            stopwatch_ns: Measures computing time for the reports only; nothing else depends on it.
        """
        self._config = config
        self._stopwatch_ns = stopwatch_ns
        self._mppi = Mppi(config.mppi, config.seed)
        self._supervisor = Supervisor(config.safety)
        self._gate = PlanGate()
        self._odometry = OdometryBuffer()
        self._memory = ObstacleMemory()
        self._watch = ScanWatch()
        self._seen = SeenFloor()
        self._escape = Escape(config.mppi, config.safety.braking)
        self._plan: TrackedPlan | None = None
        self._odometry_times: Times | None = None
        self._scan_times: Times | None = None
        self._offset_ns: int | None = None
        self._round_trip_ns: int | None = None
        self._server: str | None = None
        self._trouble: str | None = None
        self._arrived = False
        self._last = Tick(STANDSTILL, "not started yet", 0.0)
        self._tick_ms: deque[float] = deque(maxlen=200)

    def set_clock_offset(
        self, offset_ns: int | None, *, round_trip_ns: int | None = None, server: str | None = None
    ) -> None:
        """Set the server's clock minus the robot's, how long the exchange took that told it, and which server it is.

        None: unknown. The robot stands where the offset is; the round trip is only shown. Plans of other servers than
        ``server`` are refused; None takes any's.
        """
        self._offset_ns, self._round_trip_ns, self._server = offset_ns, round_trip_ns, server

    def set_trouble(self, trouble: str | None) -> None:
        """Set why the base would not obey, as its driver says: the robot stands, for that reason. None: all is well."""
        self._trouble = trouble

    def on_odometry(self, odometry: Odometry, received_ns: int) -> None:
        """Take in odometry. If its frame began anew, remembered obstacles and the plan are dropped."""
        if not self._odometry.add(odometry):
            self._memory.clear()
            self._watch.forget()
            self._seen.clear()
            self._escape.forget()
            self._plan = None
            self._scan_times = None
        self._odometry_times = Times(self._odometry.newest_ns, received_ns)

    def on_scan(self, scan: Scan, received_ns: int) -> None:
        """Take in a scan; one older than the last, or without odometry around its stamp, is counted and dropped."""
        if self._scan_times is not None and scan.stamp_ns < self._scan_times.stamp_ns:
            self._gate.refused["scan_out_of_order"] += 1
            return
        pose = self._odometry.at(scan.stamp_ns)
        if pose is None:
            self._gate.refused["scan_without_odometry"] += 1
            return
        scan = self._config.lidar.place(scan)
        self._scan_times = Times(scan.stamp_ns, received_ns)
        self._watch.look(scan, pose)
        if self._watch.trouble is None:
            self._memory.add(scan, pose)
            self._seen.add(scan, pose)

    def on_plan(self, plan: Plan, received_ns: int) -> bool:
        """Take in a plan; return whether it was accepted. A refusal is counted by its reason."""
        pose = None if self._offset_ns is None else self._odometry.at(plan.stamp_ns - self._offset_ns)
        accepted = self._gate.accepts(
            plan,
            received_ns=received_ns,
            offset_ns=self._offset_ns,
            server=self._server,
            has_pose=pose is not None,
        )
        if accepted and pose is not None:
            self._plan = track(plan, pose, received_ns)
        return accepted

    def stop(self, epoch: int) -> None:
        """Stop until :meth:`resume`; plans older than ``epoch`` are refused from now on."""
        self._gate.stop(epoch)
        self._plan = None

    def resume(self, epoch: int) -> None:
        """Unlatch the stop; the robot drives with the next plan that is not older than ``epoch``."""
        self._gate.resume(epoch)

    @property
    def epoch(self) -> int:
        """The robot's epoch."""
        return self._gate.epoch

    @property
    def stopped(self) -> bool:
        """Whether the stop is latched."""
        return self._gate.stopped

    @property
    def refused(self) -> dict[str, int]:
        """How many inputs were refused, by kind of reason."""
        return dict(self._gate.refused)

    def tick(self, now_ns: int) -> Tick:
        """Return the velocity for the next control period."""
        started_ns = self._stopwatch_ns()
        reason = self._supervisor.objection(self._situation(), now_ns)
        if reason is not None:
            self._mppi.reset()
            self._escape.reset()
            self._last = Tick(STANDSTILL, reason, 0.0)
        else:
            self._last = self._drive(now_ns)
        self._tick_ms.append((self._stopwatch_ns() - started_ns) * 1e-6)
        return self._last

    def state(self, now_ns: int) -> dict[str, Any]:
        """Return the state for display, flat and fit for JSON; unknown values are None."""
        situation, velocity = self._situation(), self._last.velocity
        lidar = self._config.lidar.robot_from_lidar
        p50, p95 = np.percentile(self._tick_ms, (50, 95)) if self._tick_ms else (math.nan, math.nan)
        return {
            "robot": self._config.robot,
            "server": self._server,
            "moving": velocity != STANDSTILL,
            "reason": self._last.reason,
            "stopped": self._gate.stopped,
            "epoch": self._gate.epoch,
            "plan_seq": self._gate.seq,
            "plan_age_ms": _age_ms(situation.plan, now_ns),
            "scan_age_ms": _age_ms(situation.scan, now_ns),
            "odometry_age_ms": _age_ms(situation.odometry, now_ns),
            "goal_id": None if self._plan is None else self._plan.plan.goal_id,
            "v_mps": round(velocity.v_mps, 4),
            "w_radps": round(velocity.w_radps, 4),
            "rejected": self._gate.refused.total(),
            "last_refusal": self._gate.last_refusal or None,
            "tick_p50_ms": None if math.isnan(p50) else round(float(p50), 3),
            "tick_p95_ms": None if math.isnan(p95) else round(float(p95), 3),
            "clock_offset_ms": None if self._offset_ns is None else round(self._offset_ns * 1e-6, 3),
            "round_trip_ms": None if self._round_trip_ns is None else round(self._round_trip_ns * 1e-6, 3),
            "stopping_m": self._stopping_m(),
            "lidar_x_m": lidar.x_m,
            "lidar_y_m": lidar.y_m,
            "lidar_yaw_rad": lidar.yaw_rad,
        }

    def _situation(self) -> Situation:
        plan = None
        if self._plan is not None and self._offset_ns is not None:
            plan = Times(self._plan.plan.stamp_ns - self._offset_ns, self._plan.received_ns)
        return Situation(
            stopped=self._gate.stopped,
            trouble=self._trouble,
            clock_known=self._offset_ns is not None,
            odometry=self._odometry_times,
            scan=self._scan_times,
            scan_trouble=self._watch.trouble,
            plan=plan,
        )

    def _stopping_m(self) -> float:
        """Return how far the robot still comes if it is told to stand next, and the margin it keeps then."""
        braking, now = self._config.safety.braking, self._odometry.velocity
        x, y, _ = stopping_poses(self._last.velocity, now, braking)[-1]
        return round(math.hypot(x, y) + braking.margin_m, 3)

    def _drive(self, now_ns: int) -> Tick:
        """Ask the controller; the supervisor has agreed to driving as such."""
        pose = self._odometry.latest(now_ns)
        assert pose is not None  # else the supervisor had objected
        assert self._plan is not None
        path = self._plan.path_m(pose)
        if self._has_arrived(path):
            self._mppi.reset()
            self._escape.reset()
            return Tick(STANDSTILL, ARRIVED, 0.0)
        points = self._memory.points_m(pose)
        now = self._odometry.velocity
        limit_mps = speed_limit_mps(self._seen.newest, self._config.mppi.max_v_mps, self._config.safety.braking)
        if limit_mps < LEAST_MPS or math.hypot(*path[-1]) < _NEARLY_THERE_M:  # it stands, or is there, for a reason
            self._escape.reset()
            stuck = None
        else:
            around = Surroundings(pose, points, lambda places: self._seen.seen(places, pose))
            stuck = self._escape.step(now_ns, around)
        if stuck is not None and stuck.velocity is not None:
            self._mppi.reset()
            verdict = self._supervisor.judge(stuck.velocity, now, points, least_v_mps=-BACK_MPS)
            return Tick(verdict.velocity, verdict.reason or stuck.reason, 0.0)
        started_ns = self._stopwatch_ns()
        command = self._mppi.plan(MppiInput(path, points, now, limit_mps))
        mppi_ms = (self._stopwatch_ns() - started_ns) * 1e-6
        verdict = self._soften(command, now, points)
        reason = verdict.reason if stuck is None else stuck.reason
        return Tick(verdict.velocity, reason or (None if limit_mps else BLIND), mppi_ms)

    def _has_arrived(self, path_m: FloatArray) -> bool:
        near_m = self._config.leave_m if self._arrived else self._config.arrive_m
        self._arrived = math.hypot(*path_m[-1]) <= near_m
        return self._arrived

    def _soften(self, command: Velocity, now: Velocity, points_m: FloatArray) -> Verdict:
        """Return the verdict on the command, or on the first milder one that the supervisor lets pass.

        The same arc slower, then the turn alone: a robot close to a wall can still creep or turn away.
        """
        verdict = self._supervisor.judge(command, now, points_m)
        if verdict.reason is None:
            return verdict
        v, w = command.v_mps, command.w_radps
        for milder in (Velocity(0.5 * v, 0.5 * w), Velocity(0.25 * v, 0.25 * w), Velocity(0.0, w)):
            second = self._supervisor.judge(milder, now, points_m)
            if second.reason is None:
                return second
        return verdict


def _age_ms(times: Times | None, now_ns: int) -> float | None:
    return None if times is None else round(times.age_s(now_ns) * 1e3, 1)
