"""Where the robot is in the picture: as the paper's simulation has it (section V-A), or as a detector would see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from revnm_server.frame import RobotSighting
from revnm_server.mapping.tag_plane import TagPlane
from revnm_sim.robot import see_robot
from revnm_sim.scenario import Scenario, tag_seen
from revnm_sim.simulation import Simulation
from revnm_sim.world import primitive_arrays

ROBOT = "rover"


class KeptSightings:
    """The robot's exact pose in the picture while the camera sees its tag; hidden, the last one, as if seen now."""

    def __init__(self, scenario: Scenario, simulation: Simulation) -> None:
        self._scenario, self._simulation = scenario, simulation
        self._arrays = primitive_arrays(scenario.world.obstacles)
        self._last: RobotSighting | None = None

    def sighting(self, stamp_ns: int) -> RobotSighting | None:
        """Return the sighting at a time, nanoseconds; None before the robot was seen first."""
        pose, scenario = self._simulation.true_pose, self._scenario
        place = np.array([[pose.x_m, pose.y_m]])
        if tag_seen(self._arrays, scenario.camera, place, scenario.robot)[0]:
            self._last = see_robot(scenario.camera, pose, scenario.robot, robot=ROBOT, stamp_ns=stamp_ns)
        elif self._last is not None:
            self._last = replace(self._last, stamp_ns=stamp_ns)
        return self._last


class NoisySightings:
    """What a tag detector reports where a tag has enough pixels: its corners with noise, nothing while it is hidden."""

    def __init__(self, scenario: Scenario, simulation: Simulation, *, sigma_px: float = 0.5) -> None:
        self._scenario, self._simulation = scenario, simulation
        self._arrays = primitive_arrays(scenario.world.obstacles)
        self._rng = np.random.default_rng([scenario.seed, 5])
        self._sigma_px = sigma_px

    def sightings(self, stamp_ns: int) -> list[RobotSighting]:
        """Return the robot, if the camera sees its whole tag now."""
        pose, scenario = self._simulation.true_pose, self._scenario
        if not tag_seen(self._arrays, scenario.camera, np.array([[pose.x_m, pose.y_m]]), scenario.robot)[0]:
            return []
        exact = see_robot(scenario.camera, pose, scenario.robot, robot=ROBOT, stamp_ns=stamp_ns)
        corners = exact.corners + self._rng.normal(0.0, self._sigma_px, exact.corners.shape)
        plane = TagPlane(replace(exact, corners=corners), tag_size_m=scenario.robot.tag_m)
        (middle, ahead), _ = plane.project(np.array([[0.0, 0.0], [1e-3, 0.0]]))
        step = ahead - middle
        return [replace(exact, pixel=middle, heading=step / np.linalg.norm(step), corners=corners)]
