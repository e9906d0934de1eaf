"""What stands in the place of camera and operator in a trial: exact disparity, sightings and a clicked goal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame, RobotSighting
from revnm_server.observation import Image32
from revnm_sim.bench.methods.pose import KeptSightings
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth, overlay_depth, robot_primitive
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.world import primitive_arrays


class TrueDisparity:
    """Exact disparity of the remote camera's view, the robot included."""

    def __init__(self, scenario: Scenario, simulation: Simulation, grid_hw: tuple[int, int]) -> None:
        self._scenario, self._simulation = scenario, simulation
        arrays = primitive_arrays(scenario.world.primitives)
        self._background = cast_depth(arrays, scenario.camera, grid_hw)

    def disparity(self, frame: Frame) -> Image32:  # noqa: ARG002 — the truth needs no picture
        """Return the disparity (h, w) as of now."""
        body = robot_primitive(self._simulation.true_pose, self._scenario.robot)
        return disparity_from_depth(overlay_depth(self._background, self._scenario.camera, body))


class TrueSightings:
    """What stands in the place of the tag detector."""

    def __init__(self, scenario: Scenario, simulation: Simulation) -> None:
        self._kept = KeptSightings(scenario, simulation)

    def sightings(
        self,
        frame: Frame,
        expected: Mapping[str, FloatArray] | None = None,  # noqa: ARG002
    ) -> list[RobotSighting]:
        """Return the robot; nothing before it was seen first."""
        found = self._kept.sighting(frame.stamp_ns)
        return [] if found is None else [found]


@dataclass(frozen=True, slots=True)
class PixelGoal:
    """The goal as an operator would click it.

    Attributes:
        id: Name of the goal.
        normalised: Its pixel, divided by the picture's size.
    """

    id: str
    normalised: tuple[float, float]
