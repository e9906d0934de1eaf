"""ReVNM: the server's own pipeline with the models of a bundle, and the base of its ablations.

The robot's pose in the picture comes from the simulator, as in the paper: at 640×480 and 120° no tag can be read. A
hidden robot keeps its last pose, as in the paper; the live server gives no plan instead. With perception ``truth`` the
exo disparity comes from the simulator too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.bundle import Bundle, load_bundle
from revnm_server.depth import OnnxDepth
from revnm_server.exo2ego import OnnxExo2Ego
from revnm_server.frame import Frame, RobotSighting
from revnm_server.observation import Image32
from revnm_server.pipeline import Pipeline
from revnm_server.policy import OnnxPolicy
from revnm_server.ports import EgoDepth
from revnm_sim.bench.methods.method import MethodContext
from revnm_sim.bench.methods.pose import ROBOT, KeptSightings
from revnm_sim.raycast import cast_depth, disparity_from_depth, overlay_depth, robot_primitive
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.world import primitive_arrays

EgoSource = Callable[[Bundle, MethodContext], EgoDepth]


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

    def sightings(self, frame: Frame) -> list[RobotSighting]:
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


class RevnmMethod:
    """The pipeline, fed with simulated pictures."""

    def __init__(self, context: MethodContext, ego: EgoSource = lambda bundle, _: OnnxExo2Ego(bundle)) -> None:
        """Load the bundle.

        Args:
            context: The trial.
            ego: What gives the robot's view; the bundle's exo2ego, unless an ablation has another.

        Raises:
            FileError: The bundle does not fit.
        """
        scenario, self._simulation = context.scenario, context.simulation
        bundle = load_bundle(Path(context.bundle), threads=1)
        self._rendered = context.perception == "models"
        truth = TrueDisparity(scenario, self._simulation, bundle.spec.disparity_hw)
        self._pipeline = Pipeline(
            bundle.spec,
            depth=OnnxDepth(bundle) if self._rendered else truth,
            tags=TrueSightings(scenario, self._simulation),
            exo2ego=ego(bundle, context),
            planner=OnnxPolicy(bundle),
        )
        camera = scenario.camera
        self._image = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)
        pixel, _ = camera.project(np.array([*scenario.goal_m, 0.0]))
        goal = (float(pixel[0]) / camera.width_px, float(pixel[1]) / camera.height_px)
        self._goals = {ROBOT: PixelGoal("goal", goal)}
        self._seq = 0

    def look(self) -> None:
        """Render the picture, where depth comes from it."""
        if self._rendered:
            self._image = self._simulation.picture()

    def waypoints(self) -> FloatArray | None:
        """Return the policy's waypoints; None before the robot was seen first."""
        self._seq += 1
        plans = self._pipeline.step(Frame(self._image, self._simulation.time_ns, self._seq), self._goals).plans
        return plans[0].waypoints_m if plans else None
