"""Where the robot is in the picture, as the paper's simulation has it (section V-A): exact, and kept while hidden."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from revnm_server.frame import RobotSighting
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
