"""One robot, one world, one camera, in simulated time: used live, and by the benchmark faster than real time."""

from __future__ import annotations

import math
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Odometry, Scan, Velocity
from revnm_sim.actuator import Actuator, ActuatorSpec
from revnm_sim.physics import TICK_NS, Physics
from revnm_sim.render import CameraRenderer
from revnm_sim.robot_model import WHEEL_RADIUS_M, wheel_track_m
from revnm_sim.scenario import Scenario
from revnm_sim.sensors import Lidar, LidarSpec, OdometrySpec, WheelOdometry
from revnm_sim.world import Primitive, primitive_arrays

TAG_ID = 3
_CLEARANCE_TICKS = 4  # 50 ms, 2.5 cm of driving


class Simulation:
    """The simulated end of everything: takes velocities, gives scans, odometry and pictures.

    Equal scenarios, seeds and commands give equal results. Stamps are simulated time, from 0.
    """

    def __init__(self, scenario: Scenario, seed: int, *, walker: Primitive | None = None) -> None:
        """Set the robot on its start, standing.

        Args:
            scenario: World, camera, robot and start.
            seed: Of the errors of LiDAR and odometry.
            walker: What stands on the floor beside the world's own and can be moved; pictures do not show it.
        """
        robot, world = scenario.robot, scenario.world
        if walker is not None:
            world = replace(world, primitives=(*world.primitives, walker))
        self._scenario = scenario
        self._physics = Physics(world, scenario.start, robot)
        self._actuator = Actuator(ActuatorSpec(max_v_mps=robot.max_v_mps, max_w_radps=robot.max_w_radps))
        self._odometry = WheelOdometry(WHEEL_RADIUS_M, wheel_track_m(robot), OdometrySpec(), seed)
        self._seen = primitive_arrays(world.primitives)
        self._lidar = Lidar(self._seen, robot.lidar_height_m, LidarSpec(), seed)
        self._renderer: CameraRenderer | None = None
        self._ticks = 0
        self._due_ns = 0
        self._pose = self._physics.world_from_robot
        self._path_m = 0.0
        self._touching, self._contacts = False, 0
        self._closest_m = self._physics.clearance_m

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free what PyBullet holds; a second call does nothing."""
        self._physics.close()
        if self._renderer is not None:
            self._renderer.close()

    def command(self, velocity: Velocity) -> None:
        """Send a velocity to the base, which delays it, limits it, and brakes when none follows."""
        self._actuator.command(velocity, self.time_ns)

    def move_walker(self, place_m: FloatArray) -> None:
        """Put the walker, with which the simulation was made, at (x, y), metres."""
        self._seen.centre_m[-1, :2] = place_m
        self._physics.move_last_obstacle(place_m)

    def advance(self, dt_s: float) -> None:
        """Let ``dt_s`` pass, rounded down to whole ticks; what is left over counts next time."""
        self._due_ns += round(dt_s * 1e9)
        while self.time_ns + TICK_NS <= self._due_ns:
            self._tick()

    @property
    def time_ns(self) -> int:
        """Simulated time since the start."""
        return self._ticks * TICK_NS

    @property
    def true_pose(self) -> Pose2:
        """``world_from_robot``, exact."""
        return self._pose

    @property
    def in_contact(self) -> bool:
        """Whether the body touches an obstacle now."""
        return self._physics.in_contact

    @property
    def had_contact(self) -> bool:
        """Whether the body has touched an obstacle since the start."""
        return self._contacts > 0

    @property
    def contacts(self) -> int:
        """How often the body began to touch an obstacle since the start."""
        return self._contacts

    @property
    def clearance_m(self) -> float:
        """Distance from the body to the nearest obstacle now, capped as in the physics."""
        return self._physics.clearance_m

    @property
    def closest_m(self) -> float:
        """Least clearance since the start."""
        return self._closest_m

    @property
    def path_m(self) -> float:
        """Length of the path driven since the start."""
        return self._path_m

    def scan(self) -> Scan:
        """Return a LiDAR scan taken now."""
        return self._lidar.scan(self._pose, self.time_ns)

    def odometry(self) -> Odometry:
        """Return the newest wheel odometry."""
        return self._odometry.latest

    def picture(self) -> NDArray[np.uint8]:
        """Return what the remote camera sees now, (H, W, 3) uint8 RGB; the first call is slow."""
        if self._renderer is None:
            scenario = self._scenario
            self._renderer = CameraRenderer(scenario.world, scenario.camera, scenario.robot, tag_id=TAG_ID)
        return self._renderer.picture(self._pose)

    def _tick(self) -> None:
        self._physics.drive(self._actuator.advance(self.time_ns, TICK_NS * 1e-9))
        self._physics.tick()
        self._ticks += 1
        before, self._pose = self._pose, self._physics.world_from_robot
        self._path_m += math.hypot(self._pose.x_m - before.x_m, self._pose.y_m - before.y_m)
        self._odometry.update(self._physics.wheel_angles_rad, self.time_ns)
        touching = self._physics.in_contact
        self._contacts += touching and not self._touching
        self._touching = touching
        if self._ticks % _CLEARANCE_TICKS == 0:
            self._closest_m = min(self._closest_m, self._physics.clearance_m)
