"""The server's tick over the map: picture → depth, tags → map of the floor → a way for each robot.

Stands in the place of :class:`revnm_server.tick.pipeline.Pipeline`; a policy corrects and completes the map. What
it knows of the camera it has learnt from the robots' odometry, and the robots' scans correct its map.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_client.messages import Scan
from revnm_server.calibration.calibrator import CalibrationState, Calibrator
from revnm_server.calibration.keeper import CalibrationKeeper
from revnm_server.calibration.keyframes import TagMount
from revnm_server.calibration.places import PlaceKeeper
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import Frame, RobotSighting
from revnm_server.mapping.site_map import SiteMap
from revnm_server.mapping.tag_places import tag_corners
from revnm_server.observation import Image32, normalise_disparity
from revnm_server.ports import DisparitySource, GoalPixel, Senses, SightingSource
from revnm_server.stage_checks import check_array, timed
from revnm_server.tick.map_beliefs import MapBeliefs
from revnm_server.tick.map_navigator import MapNavigator
from revnm_server.tick.map_robot import RobotShape
from revnm_server.tick.map_route import MapRoute, NavigatorTick
from revnm_server.tick.pipeline import RobotPlan, TickResult
from revnm_server.tick.site_report import SiteReport, SiteRoute

logger = logging.getLogger(__name__)

_DRAWN_EVERY = 6  # points of a way, which are 0.05 m apart
_FARTHEST_PX = 20_000.0
_LEAST_DEPTH_M = 0.1
_NS_PER_S = 1e9
_Thought = tuple[dict[str, Image32], dict[str, float]]


class MapPipeline:
    """One camera's pictures in, plans out. Used by one thread."""

    def __init__(
        self,
        *,
        depth: DisparitySource,
        disparity_hw: tuple[int, int],
        tags: SightingSource,
        senses: Mapping[str, Senses],
        shape: RobotShape,
        beliefs: MapBeliefs | None = None,
        keeper: CalibrationKeeper | None = None,
        place_keeper: PlaceKeeper | None = None,
        max_sighting_age_s: float = 1.0,
    ) -> None:
        """Begin with an unknown camera, whose first picture says how large its pictures are.

        Args:
            depth: Sees how near things are.
            disparity_hw: Height and width of what it gives.
            tags: Sees where robots are.
            senses: By robot, what it measures itself.
            shape: Of each robot.
            beliefs: Correct and complete the map; None plans on what was measured alone.
            keeper: Keeps the calibration over a restart; None keeps nothing.
            place_keeper: Keeps where the robots are, where the calibration is kept.
            max_sighting_age_s: For how long the last sighting of a hidden robot is shown.
        """
        self._depth, self._hw, self._tags = depth, disparity_hw, tags
        self._senses, self._shape, self._beliefs = senses, shape, beliefs
        self._keeper, self._place_keeper = keeper, place_keeper
        self._max_sighting_age_s = max_sighting_age_s
        self._size_px: tuple[int, int] | None = None
        self._resized: str | None = None
        self._calibrator: Calibrator
        self._navigator: MapNavigator
        self._site: SiteMap
        self._last_seen: dict[str, RobotSighting] = {}
        self._expected: dict[str, FloatArray] = {}
        self._last_scans: dict[str, Scan] = {}
        self._threads = ThreadPoolExecutor(max_workers=2, thread_name_prefix="beside-tick")
        self._thought: Future[_Thought] | None = None

    def step(self, frame: Frame, goals: Mapping[str, GoalPixel]) -> TickResult:
        """Process one picture.

        While the depth network looks at it, the robots are found and heard. What it teaches of the camera, and what the
        policy makes of it, serves the plans of the next one, so that its own do not wait for it.

        Args:
            frame: The newest picture.
            goals: Where robots should go, by the robot's name; who is not in it gets no plan.

        Raises:
            ContractError: The depth source gave an array of the wrong shape or with values that are not finite, or a
                network did so with the picture before. What else failed with that is raised, too.
        """
        timings_ms: dict[str, float] = {}
        with timed(timings_ms, "tick"):
            looking = self._threads.submit(self._look, frame, timings_ms)
            try:
                with timed(timings_ms, "tag"):
                    sightings = self._see_robots(frame)
                egos = self._recall(timings_ms)
                with timed(timings_ms, "map"):
                    self._hear(frame.size_px)
            finally:
                wait([looking])  # networks do not run beside themselves, whatever fails
            disparity = looking.result()
            with timed(timings_ms, "map"):
                self._hear(frame.size_px)  # and what came since: the newest odometry tells best where the robots were
                tick = self._navigator.step(frame.stamp_ns, disparity, sightings, goals)
        self._expected = _expected_tags(tick, self._shape.mount)
        if self._keeper is not None:
            self._offer(self._keeper, frame.size_px)
        if self._place_keeper is not None:
            places = tick.places if tick.calibration.status == "good" else {}
            self._place_keeper.offer(self._navigator.whereabouts(frame.stamp_ns, places))
        self._thought = self._threads.submit(self._think, tick, disparity, frame.stamp_ns)
        plans = tuple(
            RobotPlan(robot, route.waypoints_m, frame.stamp_ns, goals[robot].id)
            for robot, route in tick.routes.items()
            if route.waypoints_m is not None
        )
        site = self._report(frame, tick)
        seen = tuple(self._last_seen.values())
        return TickResult(plans, seen, normalise_disparity(disparity), egos, timings_ms, site)

    def close(self) -> None:
        """Keep what was learnt of the camera, and where the robots are."""
        self._threads.shutdown()
        if self._place_keeper is not None:
            self._place_keeper.close()
        if self._keeper is not None:
            if self._size_px is not None:
                self._offer(self._keeper, self._size_px)
            self._keeper.close()

    def _offer(self, keeper: CalibrationKeeper, size_px: tuple[int, int]) -> None:
        keeper.offer(size_px, self._calibrator.belief, good=self._calibrator.state.status == "good")

    def _look(self, frame: Frame, timings_ms: dict[str, float]) -> Image32:
        with timed(timings_ms, "depth"):
            disparity = self._depth.disparity(frame)
            check_array("disparity", disparity, self._hw)
        return disparity

    def _think(self, tick: NavigatorTick, disparity: Image32, stamp_ns: int) -> _Thought:
        timings_ms: dict[str, float] = {}
        egos: dict[str, Image32] = {}
        try:
            if self._beliefs is not None:
                egos = self._beliefs.renew(tick, self._site, disparity, stamp_ns, timings_ms)
        finally:  # afterwards, since beliefs are of the tick's frame; and whatever became of them
            with timed(timings_ms, "learn"):
                self._navigator.learn()
        return egos, timings_ms

    def _recall(self, timings_ms: dict[str, float]) -> dict[str, Image32]:
        """Wait for what is made of the picture before: from here on the map is this thread's alone again."""
        thought, self._thought = self._thought, None
        if thought is None:
            return {}
        egos, durations_ms = thought.result()
        timings_ms |= durations_ms
        return egos

    def _see_robots(self, frame: Frame) -> list[RobotSighting]:
        """Return the robots that are seen now, and remember for a while where they were."""
        seen = self._tags.sightings(frame, self._expected)
        now = [sighting for sighting in seen if sighting.robot in self._senses]
        self._last_seen |= {sighting.robot: sighting for sighting in now}
        self._last_seen = {
            robot: sighting
            for robot, sighting in self._last_seen.items()
            if 0.0 <= (frame.stamp_ns - sighting.stamp_ns) / _NS_PER_S <= self._max_sighting_age_s
        }
        return now

    def _hear(self, size_px: tuple[int, int]) -> None:
        if size_px != self._size_px:
            self._begin(size_px)
        for robot, senses in self._senses.items():
            heard = senses.listen()
            for odometry in heard.odometry:
                self._navigator.hear_odometry(robot, odometry)
            for scan in heard.scans:
                self._navigator.hear_scan(robot, scan)
                self._last_scans[robot] = scan

    def _begin(self, size_px: tuple[int, int]) -> None:
        """Begin with a camera of which nothing is known but the size of its picture."""
        if self._size_px is not None:
            before, after = (f"{width} × {height}" for width, height in (self._size_px, size_px))
            self._resized = f"the camera's pictures are {after} now, not {before}: learning it anew"
            logger.warning(self._resized)
        self._size_px = size_px
        kept = self._keeper.load(size_px) if self._keeper is not None else None
        self._calibrator = Calibrator(size_px, kept=kept)
        self._site = SiteMap(size_px, self._hw)
        places = self._place_keeper.load() if self._place_keeper is not None and kept is not None else {}
        robots = dict.fromkeys(self._senses, self._shape)
        self._navigator = MapNavigator(robots, self._calibrator, self._site, kept=places)

    def _report(self, frame: Frame, tick: NavigatorTick) -> SiteReport:
        rejected: dict[str, int] = {}
        for senses in self._senses.values():
            rejected |= senses.rejected
        return SiteReport(
            stamp_ns=frame.stamp_ns,
            calibration=tick.calibration,
            grid=tick.grid,
            places=tick.places,
            routes={robot: _site_route(route, tick.calibration.camera) for robot, route in tick.routes.items()},
            warnings=self._warnings(tick.calibration),
            rejected=rejected,
            scans=dict(self._last_scans),
            standing=tick.standing,
        )

    def _warnings(self, calibration: CalibrationState) -> tuple[str, ...]:
        if calibration.status == "good":
            self._resized = None
        troubles = [each.trouble for each in (self._keeper, self._place_keeper) if each is not None]
        return tuple(text for text in (self._resized, *troubles) if text is not None)


def _expected_tags(tick: NavigatorTick, mount: TagMount) -> dict[str, FloatArray]:
    """Return about where the corners (4, 2) of the robots' tags are in the next picture, seen or hidden."""
    camera = tick.calibration.camera
    if camera is None:
        return {}
    found = {robot: tag_corners(camera, place, mount) for robot, place in tick.places.items()}
    return {robot: corners for robot, corners in found.items() if corners is not None}


def _site_route(route: MapRoute, camera: FloorCamera | None) -> SiteRoute:
    if route.goal_m is None or camera is None:
        return SiteRoute(route.reason)
    way_px = way_in_picture(route.way_m, camera) if route.way_m is not None else None
    return SiteRoute(route.reason, route.way_m, way_px, route.goal_m, route.arrived)


def way_in_picture(way_m: FloatArray, camera: FloorCamera) -> FloatArray:
    """Draw a way on the floor in the picture.

    Args:
        way_m: (P, 2) metres, floor frame.
        camera: What is known of the camera.

    Returns:
        (Q, 2) pixels of every few of its points and the last; it ends where it would pass below the camera.
    """
    few = np.concatenate([way_m[:-1:_DRAWN_EVERY], way_m[-1:]])
    pixels, depths = camera.project(np.column_stack([few, np.zeros(len(few))]))
    shown = (depths > _LEAST_DEPTH_M) & np.all(np.abs(pixels) < _FARTHEST_PX, axis=1)
    return np.asarray(pixels[np.logical_and.accumulate(shown)], dtype=np.float64)
