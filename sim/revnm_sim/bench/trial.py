"""One trial: the live system's pipeline and controller around a simulated robot, faster than real time.

The clock is the simulation's. Pictures come at 5 Hz, scans at 10 Hz, control at 20 Hz; a plan reaches the robot
100 ms after its picture, as inference and network would have it.
"""

from __future__ import annotations

import math
import time
from collections import deque
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from revnm_client.agent import AgentConfig, RobotAgent
from revnm_client.errors import FileError
from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Plan
from revnm_sim.bench.methods import METHODS, MethodContext, Perception, RobotFeed
from revnm_sim.bench.protocol import PairRule, draw_setting, trial_seed
from revnm_sim.expert.route import Route
from revnm_sim.rays.raycast import visible
from revnm_sim.scenario import Scenario, at_height
from revnm_sim.simulation import Simulation
from revnm_sim.world import primitive_arrays

CONTROL_S = 0.05
CONTROLS_PER_SCAN = 2
CONTROLS_PER_PICTURE = 4
_CONTROLS_PER_TRACK_POINT = 10
PLAN_DELAY_NS = 100_000_000
TIME_LIMIT_S = 60.0


@dataclass(frozen=True, slots=True)
class TrialKey:
    """Which trial: equal keys give equal results, times apart.

    Attributes:
        world: Name of the world, or path of its file.
        method: Name of the method.
        perception: Where depth comes from.
        seed: Of the benchmark.
        pair: Number of the start and goal.
        camera: Number of the camera pose.
        repeat: Number of the repeat.
        cameras: Camera poses for each pair; a pair that fewer cameras see is drawn anew.
        rule: Which pairs are drawn.
        world_sha256: Of the world's file; empty for generated worlds.
        bundle: Folder of the model bundle; empty for the methods that have no models.
        manifest_sha256: Of the bundle's manifest, which holds the hashes of its models; empty as above.
    """

    world: str
    method: str
    perception: Perception
    seed: int
    pair: int
    camera: int
    repeat: int
    cameras: int
    rule: PairRule
    world_sha256: str
    bundle: str
    manifest_sha256: str


@dataclass(frozen=True, slots=True)
class TrialResult:
    """What came of a trial.

    Attributes:
        success: Within the goal's radius in time and without contact.
        collision: The body, a rectangle, touched something.
        timeout: Neither in time.
        duration_s: Simulated time until it ended.
        path_m: Driven.
        expert_m: Length of the expert's way.
        geodesic_m: Length of the shortest way.
        closest_m: Least clearance of the body.
        blocked: Something stood in the straight way.
        hidden_m: How much of the planner's way lies on floor that the camera does not see.
        tick_p50_ms: Median time to make a plan and to learn from its picture, one after the other, rendering not
            included; perception ``truth`` needs no depth network.
        robot_tick_p50_ms: Median time of the robot's tick.
        track_m: Where the robot was, (x, y), world frame, every half second and at the end.
    """

    success: bool
    collision: bool
    timeout: bool
    duration_s: float
    path_m: float
    expert_m: float
    geodesic_m: float
    closest_m: float
    blocked: bool
    hidden_m: float
    tick_p50_ms: float
    robot_tick_p50_ms: float
    track_m: list[list[float]]


@threadpool_limits.wrap(limits=1, user_api="blas")
def run_trial(key: TrialKey) -> TrialResult:
    """Draw the setting of a key and drive it to its end.

    Raises:
        ContractError: The world has no place for a camera that sees a start and a goal.
        FileError: The world's file or the bundle does not fit.
    """
    setting = draw_setting(key.world, seed=key.seed, pair=key.pair, cameras=key.cameras, rule=key.rule)
    if setting.site.file_sha256 != key.world_sha256:
        raise FileError(f"{key.world}: is not the file that the benchmark began with: it was changed, or differs here")
    seed = trial_seed(key.seed, pair=key.pair, camera=key.camera, repeat=key.repeat)
    return Trial(setting.scenario(camera=key.camera, seed=seed), setting.route, key).run()


class Trial:
    """A robot on its way."""

    def __init__(self, scenario: Scenario, route: Route, key: TrialKey) -> None:
        """Set everything up.

        Args:
            scenario: Where.
            route: The planner's way of the scenario's start and goal.
            key: How.
        """
        self._scenario, self._route = scenario, route
        self._simulation = Simulation(scenario, scenario.seed)
        self._feed = RobotFeed()
        context = MethodContext(scenario, self._simulation, route.field, key.perception, key.bundle, self._feed)
        self._method = METHODS[key.method](context)
        self._agent = RobotAgent(AgentConfig(robot="rover", seed=scenario.seed))
        self._agent.set_clock_offset(0)
        self._plans: deque[tuple[int, Plan]] = deque()
        self._plan_ms: list[float] = []
        self._robot_ms: list[float] = []
        self._poses: list[Pose2] = []

    @property
    def poses(self) -> FloatArray:
        """Where the robot was at each control step so far and at the end: (T, 3) x, y, yaw, metres and radians."""
        return np.array(self._poses).reshape(-1, 3)

    def run(self) -> TrialResult:
        """Drive until arrival, contact or the end of time."""
        with self._simulation as simulation:
            for step in range(round(TIME_LIMIT_S / CONTROL_S)):
                self._poses.append(simulation.true_pose)
                self._sense(step)
                self._control()
                simulation.advance(CONTROL_S)
                if simulation.had_contact or self._at_goal():
                    break
            self._poses.append(simulation.true_pose)
            return self._result()

    def _sense(self, step: int) -> None:
        now_ns = self._simulation.time_ns
        odometry = self._simulation.odometry()
        self._agent.on_odometry(odometry, now_ns)
        self._feed.odometry.append(odometry)
        if step % CONTROLS_PER_SCAN == 0:
            scan = self._simulation.scan()
            self._agent.on_scan(scan, now_ns)
            self._feed.scans.append(scan)
        if step % CONTROLS_PER_PICTURE == 0:
            self._make_plan(now_ns)
        while self._plans and self._plans[0][0] <= now_ns:
            self._agent.on_plan(self._plans.popleft()[1], now_ns)

    def _make_plan(self, now_ns: int) -> None:
        self._method.look()
        started = time.perf_counter()
        waypoints = self._method.waypoints()
        self._plan_ms.append((time.perf_counter() - started) * 1e3)
        if waypoints is not None:
            plan = Plan(now_ns, waypoints, epoch=1, seq=len(self._plan_ms), goal_id="goal")
            self._plans.append((now_ns + PLAN_DELAY_NS, plan))

    def _control(self) -> None:
        started = time.perf_counter()
        tick = self._agent.tick(self._simulation.time_ns)
        self._robot_ms.append((time.perf_counter() - started) * 1e3)
        self._simulation.command(tick.velocity)

    def _at_goal(self) -> bool:
        pose, (x, y) = self._simulation.true_pose, self._scenario.goal_m
        return math.hypot(pose.x_m - x, pose.y_m - y) <= self._scenario.goal_radius_m

    def _result(self) -> TrialResult:
        simulation = self._simulation
        collision = simulation.had_contact
        success = self._at_goal() and not collision
        return TrialResult(
            success=success,
            collision=collision,
            timeout=not (success or collision),
            duration_s=round(simulation.time_ns * 1e-9, 3),
            path_m=round(simulation.path_m, 4),
            expert_m=round(self._route.expert_m, 4),
            geodesic_m=round(self._route.geodesic_m, 4),
            closest_m=round(simulation.closest_m, 4),
            blocked=self._route.blocked,
            hidden_m=round(_hidden_m(self._scenario, self._route), 2),
            tick_p50_ms=round(float(np.median(self._plan_ms)), 3),
            robot_tick_p50_ms=round(float(np.median(self._robot_ms)), 3),
            track_m=np.round([*self._poses[:-1:_CONTROLS_PER_TRACK_POINT], self._poses[-1]], 2)[:, :2].tolist(),
        )


def _hidden_m(scenario: Scenario, route: Route) -> float:
    """Return the length of the planner's way over floor that the camera does not see."""
    path = route.field.path((scenario.start.x_m, scenario.start.y_m))
    seen = visible(primitive_arrays(scenario.world.obstacles), scenario.camera, at_height(path, 0.0))
    return float(np.hypot(*np.diff(path, axis=0).T) @ ~seen[1:])
