"""The planner on the self-calibrated map: the server's own map navigator, which begins each trial knowing nothing.

The camera is learnt from sightings of the tag, as a detector would report them from a picture of enough pixels: four
corners with noise, nothing while the tag is hidden; a hidden robot is carried on by its odometry. With perception
``truth`` the exo disparity is the simulator's, up to scale and shift; with ``models`` it is the bundle's network's.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.calibration.calibrator import Calibrator
from revnm_server.calibration.keyframes import TagMount
from revnm_server.frame import Frame
from revnm_server.mapping.site_map import SiteMap
from revnm_server.networks.bundle import load_bundle
from revnm_server.stages.depth import OnnxDepth
from revnm_server.tick.map_beliefs import MapBeliefs
from revnm_server.tick.map_navigator import MapNavigator
from revnm_server.tick.map_robot import RobotShape
from revnm_sim.bench.methods.method import MethodContext
from revnm_sim.bench.methods.pose import ROBOT, NoisySightings
from revnm_sim.bench.methods.truth import PixelGoal, TrueDisparity

_DISPARITY_HW = (192, 256)


class BevMethod:
    """Calibrates, maps, plans; with the robot's scans in the map."""

    scans = True

    def __init__(self, context: MethodContext, beliefs: MapBeliefs | None = None) -> None:
        """Begin with an unknown camera.

        Args:
            context: The trial.
            beliefs: Correct and complete the map; None plans on what was measured alone.

        Raises:
            FileError: The bundle, which perception ``models`` needs, does not fit.
        """
        scenario, self._simulation, self._feed = context.scenario, context.simulation, context.feed
        camera, spec = scenario.camera, scenario.robot
        size_px = (camera.width_px, camera.height_px)
        self._rendered = context.perception == "models"
        if self._rendered:
            bundle = load_bundle(Path(context.bundle), threads=1)
            self._depth: OnnxDepth | TrueDisparity = OnnxDepth(bundle)
            grid_hw = bundle.spec.disparity_hw
        else:
            self._depth, grid_hw = TrueDisparity(scenario, self._simulation, _DISPARITY_HW), _DISPARITY_HW
        shape = RobotShape(TagMount(spec.tag_m, spec.top_m), spec.length_m, spec.width_m)
        self._beliefs, self._site = beliefs, SiteMap(size_px, grid_hw, scans=self.scans)
        self._navigator = MapNavigator({ROBOT: shape}, Calibrator(size_px), self._site)
        self._sightings = NoisySightings(scenario, self._simulation)
        self._image = np.zeros((camera.height_px, camera.width_px, 3), dtype=np.uint8)
        pixel, _ = camera.project(np.array([*scenario.goal_m, 0.0]))
        goal = (float(pixel[0] + 0.5) / camera.width_px, float(pixel[1] + 0.5) / camera.height_px)
        self._goals = {ROBOT: PixelGoal("goal", goal)}

    def look(self) -> None:
        """Render the picture, where depth comes from it."""
        if self._rendered:
            self._image = self._simulation.picture()

    def waypoints(self) -> FloatArray | None:
        """Return the navigator's waypoints; None where it has no plan."""
        now_ns = self._simulation.time_ns
        for odometry in self._feed.odometry:
            self._navigator.hear_odometry(ROBOT, odometry)
        for scan in self._feed.scans:
            self._navigator.hear_scan(ROBOT, scan)
        self._feed.odometry.clear()
        self._feed.scans.clear()
        disparity = self._depth.disparity(Frame(self._image, now_ns, 0))
        tick = self._navigator.step(now_ns, disparity, self._sightings.sightings(now_ns), self._goals)
        if self._beliefs is not None:
            self._beliefs.renew(tick, self._site, disparity, now_ns, {})
        self._navigator.learn()
        return tick.routes[ROBOT].waypoints_m


class BevNoLidarMethod(BevMethod):
    """The same without scans in the map."""

    scans = False
