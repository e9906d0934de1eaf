"""PyBullet dynamics of one robot in one world; nothing here knows of cameras or messages.

Each instance owns a PyBullet client of its own, so several may live in one process. The physics runs at
240 Hz; commands, wheel angles and contacts are exchanged every third of its steps (12.5 ms). What begins higher than
the robot's top is left out: it can never be touched.
"""

from __future__ import annotations

import math
from types import TracebackType
from typing import Self

import numpy as np
import pybullet

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import STANDSTILL, Velocity
from revnm_sim.robot import RobotSpec
from revnm_sim.robot_model import LEFT_JOINT, RIGHT_JOINT, WHEEL_RADIUS_M, wheel_track_m
from revnm_sim.scene import add_floor, add_obstacle, add_robot
from revnm_sim.world import World, primitive_arrays

TICK_NS = 12_500_000
SUBSTEPS = 3
CLEARANCE_LIMIT_M = 1.0

# Collision groups: only wheels meet the floor, only the body meets obstacles.
_FLOOR, _OBSTACLE, _BODY, _WHEEL = 1, 2, 4, 8
_WHEEL_TORQUE_NM = 4.0
_HEADROOM_M = 0.02  # over the robot's top; at this distance PyBullet begins to look for contacts
_DISTANCE = 8  # place of the distance in PyBullet's contact points


class Physics:
    """A world and a differential-drive robot in PyBullet."""

    def __init__(self, world: World, start: Pose2, spec: RobotSpec) -> None:
        self._spec = spec
        self._client: int = pybullet.connect(pybullet.DIRECT)
        pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=self._client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=TICK_NS * 1e-9,
            numSubSteps=SUBSTEPS,
            deterministicOverlappingPairs=1,
            physicsClientId=self._client,
        )
        floor = add_floor(self._client, world)
        pybullet.changeDynamics(floor, -1, lateralFriction=1.0, physicsClientId=self._client)
        self._filter(floor, -1, group=_FLOOR, mask=_WHEEL)
        low = tuple(p for p in world.obstacles if p.bottom_m < spec.top_m + _HEADROOM_M)
        self._obstacles = [add_obstacle(self._client, p) for p in low]
        for body in self._obstacles:
            self._filter(body, -1, group=_OBSTACLE, mask=_BODY)
        arrays = primitive_arrays(low)
        self._centres_m = arrays.centre_m[:, :2]
        self._reaches_m = np.hypot(arrays.half_m[:, 0], arrays.half_m[:, 1]) + spec.circumscribed_m
        self._robot, joints = add_robot(self._client, start, spec)
        self._wheels = (joints[LEFT_JOINT], joints[RIGHT_JOINT])
        self._set_up_robot(joints)
        self._driven: Velocity | None = None
        self.drive(STANDSTILL)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the PyBullet client; a second call does nothing."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def drive(self, velocity: Velocity) -> None:
        """Set the wheels' target speeds from the velocity of the body."""
        if velocity == self._driven:
            return
        self._driven = velocity
        half = velocity.w_radps * wheel_track_m(self._spec) / 2.0
        targets = [(velocity.v_mps - half) / WHEEL_RADIUS_M, (velocity.v_mps + half) / WHEEL_RADIUS_M]
        pybullet.setJointMotorControlArray(
            self._robot,
            self._wheels,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=targets,
            forces=[_WHEEL_TORQUE_NM, _WHEEL_TORQUE_NM],
            physicsClientId=self._client,
        )

    def move_last_obstacle(self, place_m: FloatArray) -> None:
        """Put the world's last obstacle, which must be as low as the robot is high, at (x, y), metres."""
        body = self._obstacles[-1]
        (_, _, z), turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=self._client)
        pybullet.resetBasePositionAndOrientation(body, (*place_m, z), turn, physicsClientId=self._client)
        self._centres_m[-1] = place_m

    def tick(self) -> None:
        """Advance by ``TICK_NS``."""
        pybullet.stepSimulation(physicsClientId=self._client)

    @property
    def world_from_robot(self) -> Pose2:
        """The true pose."""
        position, orientation = pybullet.getBasePositionAndOrientation(self._robot, physicsClientId=self._client)
        x, y, z, w = orientation
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return Pose2(position[0], position[1], yaw)

    @property
    def wheel_angles_rad(self) -> tuple[float, float]:
        """Turned angles of the left and the right wheel since the start."""
        left, right = pybullet.getJointStates(self._robot, self._wheels, physicsClientId=self._client)
        return left[0], right[0]

    @property
    def in_contact(self) -> bool:
        """Whether the body touches an obstacle now; the floor is none."""
        points = pybullet.getContactPoints(bodyA=self._robot, linkIndexA=-1, physicsClientId=self._client)
        # Points with a positive distance are near (up to 2 cm), not touching.
        return any(point[_DISTANCE] <= 0.0 for point in points)

    @property
    def clearance_m(self) -> float:
        """Distance from the body to the nearest obstacle, at most ``CLEARANCE_LIMIT_M``; negative inside.

        What begins higher than the robot's top does not count.
        """
        pose, nearest = self.world_from_robot, CLEARANCE_LIMIT_M
        away = np.hypot(self._centres_m[:, 0] - pose.x_m, self._centres_m[:, 1] - pose.y_m)
        least = away - self._reaches_m  # between the circles that hold robot and obstacle
        for index in np.flatnonzero(least < nearest):
            if least[index] >= nearest:
                continue
            points = pybullet.getClosestPoints(
                self._robot, self._obstacles[index], nearest, linkIndexA=-1, physicsClientId=self._client
            )
            nearest = min([nearest, *(point[_DISTANCE] for point in points)])
        return nearest

    def _set_up_robot(self, joints: dict[str, int]) -> None:
        pybullet.changeDynamics(self._robot, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=self._client)
        self._filter(self._robot, -1, group=_BODY, mask=_OBSTACLE)
        for link in joints.values():
            friction = 1.0 if link in self._wheels else 0.0
            pybullet.changeDynamics(self._robot, link, lateralFriction=friction, physicsClientId=self._client)
            self._filter(self._robot, link, group=_WHEEL, mask=_FLOOR)

    def _filter(self, body: int, link: int, *, group: int, mask: int) -> None:
        pybullet.setCollisionFilterGroupMask(body, link, group, mask, physicsClientId=self._client)
