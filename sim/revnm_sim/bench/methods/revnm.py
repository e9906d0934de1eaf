"""ReVNM: the server's own pipeline with the models of a bundle.

The robot's pose in the picture comes from the simulator, as in the paper: at 640×480 and 120° no tag can be read. A
hidden robot keeps its last pose (paper, section V-A), moved on by its odometry through the plane of its tag; the live
server does not yet know the odometry, and gives no plan after a second. With perception ``truth`` the exo disparity
comes from the simulator too.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.bundle import load_bundle
from revnm_server.depth import OnnxDepth
from revnm_server.exo2ego import OnnxExo2Ego
from revnm_server.frame import Frame, RobotSighting
from revnm_server.observation import Image32, ObservationSpec
from revnm_server.pipeline import Pipeline
from revnm_server.policy import OnnxPolicy
from revnm_server.tag_plane import TagPlane
from revnm_sim.bench.methods.method import MethodContext
from revnm_sim.raycast import cast_depth, disparity_from_depth, overlay_depth, robot_primitive
from revnm_sim.robot import see_robot
from revnm_sim.scenario import Scenario, tag_seen
from revnm_sim.simulation import Simulation
from revnm_sim.world import primitive_arrays

_ROBOT = "rover"


class TrueDisparity:
    """Exact disparity of the remote camera's view, the robot included."""

    def __init__(self, scenario: Scenario, simulation: Simulation, spec: ObservationSpec) -> None:
        self._scenario, self._simulation = scenario, simulation
        arrays = primitive_arrays(scenario.world.primitives)
        self._background = cast_depth(arrays, scenario.camera, spec.disparity_hw)

    def disparity(self, frame: Frame) -> Image32:  # noqa: ARG002 — the truth needs no picture
        """Return the disparity (h, w) as of now."""
        body = robot_primitive(self._simulation.true_pose, self._scenario.robot)
        return disparity_from_depth(overlay_depth(self._background, self._scenario.camera, body))


class TrueSightings:
    """The robot's exact pose in the picture while the camera sees its tag; hidden, the last one moved by odometry."""

    def __init__(self, scenario: Scenario, simulation: Simulation) -> None:
        self._scenario, self._simulation = scenario, simulation
        self._arrays = primitive_arrays(scenario.world.primitives)
        self._last: tuple[TagPlane, Pose2] | None = None

    def sightings(self, frame: Frame) -> list[RobotSighting]:
        """Return the robot; nothing before it was seen first, or where odometry would lead it out of sight."""
        pose, scenario = self._simulation.true_pose, self._scenario
        odom_from_robot = self._simulation.odometry().odom_from_robot
        place = np.array([[pose.x_m, pose.y_m]])
        if tag_seen(self._arrays, scenario.camera, place, scenario.robot)[0]:
            seen = see_robot(scenario.camera, pose, scenario.robot, robot=_ROBOT, stamp_ns=frame.stamp_ns)
            self._last = TagPlane(seen, tag_size_m=scenario.robot.tag_m), odom_from_robot
            return [seen]
        if self._last is None:
            return []
        plane, odom_from_seen = self._last
        carried = plane.carry(odom_from_seen.inverse() @ odom_from_robot, stamp_ns=frame.stamp_ns)
        return [] if carried is None else [carried]


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

    def __init__(self, context: MethodContext) -> None:
        """Load the bundle.

        Raises:
            FileError: The bundle does not fit.
        """
        scenario, self._simulation = context.scenario, context.simulation
        bundle = load_bundle(Path(context.bundle), threads=1)
        self._rendered = context.perception == "models"
        depth = OnnxDepth(bundle) if self._rendered else TrueDisparity(scenario, self._simulation, bundle.spec)
        self._pipeline = Pipeline(
            bundle.spec,
            depth=depth,
            tags=TrueSightings(scenario, self._simulation),
            exo2ego=OnnxExo2Ego(bundle),
            planner=OnnxPolicy(bundle),
            max_sighting_age_s=float("inf"),
        )
        camera = scenario.camera
        self._image = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)
        pixel, _ = camera.project(np.array([*scenario.goal_m, 0.0]))
        goal = (float(pixel[0]) / camera.width_px, float(pixel[1]) / camera.height_px)
        self._goals = {_ROBOT: PixelGoal("goal", goal)}
        self._seq = 0

    def look(self) -> None:
        """Render the picture, where depth comes from it."""
        if self._rendered:
            self._image = self._simulation.picture()

    def waypoints(self) -> FloatArray | None:
        """Return the policy's waypoints; None while nobody knows where the robot is."""
        now_ns = self._simulation.time_ns
        self._seq += 1
        plans = self._pipeline.step(Frame(self._image, now_ns, self._seq), self._goals).plans
        return plans[0].waypoints_m if plans and plans[0].stamp_ns == now_ns else None
