"""The paper's pipeline with a policy that sees the picture.

The robot's pose in the picture comes from the simulator, as in the paper: at 640×480 and 120° no tag can be read. A
hidden robot keeps its last pose, as in the paper; the live server gives no plan instead. With perception ``truth`` the
exo disparity comes from the simulator too.
"""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame
from revnm_server.networks.bundle import Bundle
from revnm_server.ports import EgoDepth
from revnm_server.stages.depth import OnnxDepth
from revnm_server.stages.policy import OnnxPolicy
from revnm_server.tick.pipeline import Pipeline
from revnm_sim.bench.methods.method import MethodContext
from revnm_sim.bench.methods.pose import ROBOT
from revnm_sim.bench.methods.truth import PixelGoal, TrueDisparity, TrueSightings


class PictureMethod:
    """The pipeline, fed with simulated pictures."""

    def __init__(self, context: MethodContext, bundle: Bundle, ego: EgoDepth) -> None:
        """Assemble it.

        Args:
            context: The trial.
            bundle: The models.
            ego: What gives the robot's view.
        """
        scenario, self._simulation = context.scenario, context.simulation
        self._rendered = context.perception == "models"
        truth = TrueDisparity(scenario, self._simulation, bundle.spec.disparity_hw)
        self._pipeline = Pipeline(
            bundle.spec,
            depth=OnnxDepth(bundle) if self._rendered else truth,
            tags=TrueSightings(scenario, self._simulation),
            exo2ego=ego,
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
