"""A robot that drives a course by the expert's plans, in simulated time, with wires that a fault can cut.

Plans are made at 5 Hz of the true pose and reach the robot 100 ms later, scans come at 10 Hz, control runs at 20 Hz, as
in the benchmark's other trials. The server's clock is 3.7 s ahead of the robot's, which is known to the robot.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from types import TracebackType
from typing import Self

from revnm_client.agent import AgentConfig, RobotAgent, Tick
from revnm_client.messages import Odometry, Plan, Scan, Velocity
from revnm_client.mppi import Footprint
from revnm_sim.bench.methods.method import SPACING_M, WAYPOINTS
from revnm_sim.bench.suites.courses import Course
from revnm_sim.bench.suites.walker import Walker
from revnm_sim.bench.trial import CONTROL_S, CONTROLS_PER_PICTURE, CONTROLS_PER_SCAN, PLAN_DELAY_NS
from revnm_sim.camera import Camera
from revnm_sim.expert.planner import Expert, UnreachableError
from revnm_sim.physics import TICK_NS
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation

GOAL_RADIUS_M = 0.25
_NO_CAMERA = Camera(640, 480, math.radians(90.0), (0.0, 0.0, 4.0), 0.0, math.pi / 2.0)  # nobody looks
_BOOT_NS = 1_000_000_000_000  # robot's clock at the beginning
_SERVER_AHEAD_NS = 3_700_000_000
_RING = 3  # so many plans of one tick get through, the newest


class Wires:
    """What lies between simulation, server and agent; nothing is amiss here.

    Attributes:
        clock_shift_ns: By how much somebody has set the robot's wall clock.
    """

    clock_shift_ns = 0

    def odometry(self, odometry: Odometry) -> Odometry:
        """Return what the agent gets instead of the odometry, in stamps of a clock that nobody sets."""
        return odometry

    def scan(self, scan: Scan) -> Scan | None:
        """Return what the agent gets instead of a scan, in stamps of a clock that nobody sets."""
        return scan

    def plans(self, due: list[Plan]) -> list[Plan]:
        """Return the plans that come in with this tick instead of those that are due."""
        return due

    def clock_offset_ns(self, right_ns: int) -> int | None:
        """Return what the robot takes for the server's clock minus its own."""
        return right_ns


class Drive:
    """Simulation, expert and agent; a context manager."""

    def __init__(self, course: Course, *, seed: int, wires: Wires) -> None:
        """Set the robot on its start.

        Args:
            course: Where.
            seed: Of sensors, drift and controller.
            wires: Between the robot and the rest.
        """
        world, (start, goal_m) = course.world, course.pair
        self._field = Expert(world).field(goal_m)
        self.way_m = self._field.length_m(start[:2])
        body = None if course.walk is None else course.walk.body
        scenario = Scenario(world, _NO_CAMERA, start, goal_m, seed=seed, goal_radius_m=GOAL_RADIUS_M)
        self._scenario, self.simulation = scenario, Simulation(scenario, seed, walker=body)
        self._walker = None if course.walk is None else Walker(course.walk)
        self._wires, self._footprint = wires, Footprint()
        self._agent = RobotAgent(AgentConfig(robot="rover", seed=seed))
        self._on_the_way: deque[tuple[int, Plan]] = deque()
        self._steps = self._seq = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.simulation.close()

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return self.simulation.time_ns * 1e-9

    @property
    def at_goal(self) -> bool:
        """Whether the robot is within :data:`GOAL_RADIUS_M` of the goal."""
        pose, (x, y) = self.simulation.true_pose, self._scenario.goal_m
        return math.hypot(pose.x_m - x, pose.y_m - y) <= GOAL_RADIUS_M

    @property
    def ended(self) -> bool:
        """Whether the robot is at the goal or has touched something."""
        return self.at_goal or self.simulation.had_contact

    def step(self) -> Tick:
        """Sense, decide and drive for one control period; return what the agent decided."""
        now_ns = self._robot_ns(self.simulation.time_ns)
        self._agent.set_clock_offset(self._wires.clock_offset_ns(_SERVER_AHEAD_NS - self._wires.clock_shift_ns))
        self._sense(now_ns)
        for plan in self._wires.plans(self._due_plans())[-_RING:]:
            self._agent.on_plan(plan, now_ns)
        tick = self._agent.tick(now_ns)
        self._advance(tick.velocity)
        self._steps += 1
        return tick

    def _robot_ns(self, simulated_ns: int) -> int:
        return simulated_ns + _BOOT_NS + self._wires.clock_shift_ns

    def _sense(self, now_ns: int) -> None:
        odometry = self._wires.odometry(self.simulation.odometry())
        self._agent.on_odometry(replace(odometry, stamp_ns=self._robot_ns(odometry.stamp_ns)), now_ns)
        if self._steps % CONTROLS_PER_SCAN == 0:
            scan = self._wires.scan(self.simulation.scan())
            if scan is not None:
                self._agent.on_scan(replace(scan, stamp_ns=self._robot_ns(scan.stamp_ns)), now_ns)
        if self._steps % CONTROLS_PER_PICTURE == 0:
            self._make_plan()

    def _make_plan(self) -> None:
        now_ns = self.simulation.time_ns
        try:
            waypoints = self._field.waypoints(self.simulation.true_pose, count=WAYPOINTS, spacing_m=SPACING_M)
        except UnreachableError:
            return
        self._seq += 1
        plan = Plan(now_ns + _BOOT_NS + _SERVER_AHEAD_NS, waypoints, epoch=1, seq=self._seq, goal_id="goal")
        self._on_the_way.append((now_ns + PLAN_DELAY_NS, plan))

    def _due_plans(self) -> list[Plan]:
        due = []
        while self._on_the_way and self._on_the_way[0][0] <= self.simulation.time_ns:
            due.append(self._on_the_way.popleft()[1])
        return due

    def _advance(self, velocity: Velocity) -> None:
        simulation, tick_s = self.simulation, TICK_NS * 1e-9
        simulation.command(velocity)
        if self._walker is None:
            simulation.advance(CONTROL_S)
            return
        for _ in range(round(CONTROL_S / tick_s)):
            self._walker.advance(tick_s, simulation.true_pose, self._footprint)
            simulation.move_walker(self._walker.place_m)
            simulation.advance(tick_s)
