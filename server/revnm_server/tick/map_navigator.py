"""From depth pictures, sightings, odometry and scans to waypoints, over a map that the camera's own calibration makes.

    calibration + odometry → floor_from_robot
    disparity → memory → lift → map of the floor ← scans
    map + floor_from_robot + goal pixel → way → waypoints
    sightings + odometry → calibration of the next picture

Until the calibration is good enough the robot takes careful first steps that teach it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Odometry, Scan
from revnm_server.calibration.calibrator import CalibrationState, Calibrator
from revnm_server.calibration.keyframes import DRIVES_OF_A_ROBOT, Keyframe, Travel
from revnm_server.calibration.odometry_track import OdometryTrack
from revnm_server.calibration.places import Anchor, Place
from revnm_server.frame import RobotSighting
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.scan_trail import PastScan
from revnm_server.mapping.site_map import Reframed, SiteMap
from revnm_server.mapping.tag_plane import TagPlane
from revnm_server.observation import Image32
from revnm_server.planning.first_steps import StepSettings, first_steps
from revnm_server.planning.goal_search import TRUSTED_M
from revnm_server.planning.map_planner import MapPlanner, PlannerSettings
from revnm_server.ports import GoalPixel
from revnm_server.tick.map_robot import MapRobot, RobotShape
from revnm_server.tick.map_route import MapRoute, NavigatorTick
from revnm_server.tick.turns import Turns

_SEARCHES = 2  # ways a tick that are looked for only because it is time
_ARRIVED_M = 0.2
_SEARCHING = "the robot should be at its goal, but the camera does not see it there: looking around"
_UNSEEN = "the camera has not seen the robot yet"
_FROM_BEFORE = "led from where the robot was before the restart: the camera has not seen it since"
_BEYOND = "the robot is beyond the map: it is led straight towards it"
_BACK_LEAST_M = 0.15
_BACK_M = 0.4  # a robot that was lost from sight is led back at least so far: nearer is as good as there


class MapNavigator:
    """One camera, its map, and the ways of its robots."""

    def __init__(
        self,
        robots: Mapping[str, RobotShape],
        calibrator: Calibrator,
        site: SiteMap,
        *,
        planner: PlannerSettings | None = None,
        steps: StepSettings | None = None,
        kept: Mapping[str, Place] | None = None,
    ) -> None:
        """Begin with an empty map.

        Args:
            robots: By name.
            calibrator: Of the camera.
            site: The map.
            planner: How to plan on it.
            steps: How to drive before there is a calibration.
            kept: Where robots were before, in the floor frame of a calibration that was kept.
        """
        self._calibrator, self._site = calibrator, site
        self._steps = steps or StepSettings()
        kept = kept or {}
        self._robots = {
            name: MapRobot(
                shape,
                OdometryTrack(index * DRIVES_OF_A_ROBOT),
                MapPlanner(planner or PlannerSettings()),
                anchor=Anchor(kept.get(name)),
            )
            for index, (name, shape) in enumerate(robots.items())
        }
        self._untaught: list[Keyframe] = []
        self._turns = Turns(_SEARCHES)
        self._misplaced = False  # scans may lie in the map where they were not made
        self.learn()  # places the map in a calibration that was kept

    def hear_odometry(self, robot: str, odometry: Odometry) -> None:
        """Take a robot's odometry."""
        self._robots[robot].hear(odometry)

    def hear_scan(self, robot: str, scan: Scan) -> None:
        """Take a robot's scan, whose odometry came before it."""
        each = self._robots[robot]
        each.scan = scan
        travel = each.track.at(scan.stamp_ns)
        if travel is None:
            return
        each.trail.push(PastScan(scan, travel, each.track.drive))
        place = self._floor_from_robot(each, travel, each.track.drive)
        if place is not None:
            self._site.hear_scan(scan, place)

    def step(
        self,
        stamp_ns: int,
        disparity: Image32,
        sightings: Sequence[RobotSighting],
        goals: Mapping[str, GoalPixel],
    ) -> NavigatorTick:
        """Process one picture. What sightings teach of a camera that has placed their robots waits for :meth:`learn`.

        Args:
            stamp_ns: Its capture time.
            disparity: (h, w) its disparity, up to scale and shift.
            sightings: The robots that are visible in it.
            goals: Where robots should go; who is not in it gets no route.
        """
        standing = [sighting.robot for sighting in sightings if self._sight(sighting)]
        state = self._calibrator.state
        places = self._places(stamp_ns)
        self._see(stamp_ns, disparity, places)
        grid = self._site.grid(stamp_ns)
        believed = self._site.believed_grid(grid, stamp_ns) if grid is not None and goals else None
        searching = self._turns.next(goals)
        routes = {
            robot: self._route(robot, goal, stamp_ns, places.get(robot), state, believed, has_turn=robot in searching)
            for robot, goal in goals.items()
        }
        return NavigatorTick(routes, places, grid, state, standing[0] if standing else None)

    def whereabouts(self, stamp_ns: int, places: Mapping[str, Pose2]) -> dict[str, Place | None]:
        """Return what to keep of where the robots are that are heard; None where that is not known.

        Args:
            stamp_ns: Of a picture.
            places: floor_from_robot then, as of its tick.
        """
        travels = {name: each.track.at(stamp_ns) for name, each in self._robots.items()}
        return {
            name: Place(stamp_ns, places[name], travel.odom_from_robot) if name in places else None
            for name, travel in travels.items()
            if travel is not None
        }

    def learn(self) -> None:
        """Calibrate with the sightings of the pictures so far, and place the map in what the camera is known to be.

        The map's frame may change: what was said of it with :meth:`step` must be used before, and nothing beside.
        """
        untaught, self._untaught = self._untaught, []
        self._calibrator.observe(*untaught)
        state = self._calibrator.state
        reframed = self._site.recalibrate(state) if state.camera is not None else None
        if reframed is not None:
            self._reframe(reframed)
        elif self._misplaced:
            self._site.forget_scans()
        if reframed is not None or self._misplaced:
            self._place_scans()
        self._misplaced = False

    def _sight(self, sighting: RobotSighting) -> bool:
        """Take a sighting; return whether its robot stands in the picture though it drove."""
        each = self._robots[sighting.robot]
        each.sighting = sighting
        self._misplaced |= each.anchor.holds
        each.anchor.forget()
        travel = each.track.at(sighting.stamp_ns)
        if travel is None:
            return False
        each.note_driven(travel.odom_from_robot, learning=not self._calibrator.state.leads)
        each.seen = travel
        drive = each.track.drive
        frame = Keyframe(sighting.pixel, sighting.heading, sighting.corners, travel, each.shape.mount, drive)
        if self._calibrator.floor_from_robot(travel, drive) is None:  # without it the robot is nowhere
            self._calibrator.observe(frame)
        else:
            self._untaught.append(frame)
        return each.tag.note(sighting, travel.odom_from_robot, drive)

    def _places(self, stamp_ns: int) -> dict[str, Pose2]:
        found = {}
        for name, each in self._robots.items():
            travel = each.track.at(stamp_ns)
            place = self._floor_from_robot(each, travel, each.track.drive) if travel is not None else None
            if place is not None:
                found[name] = place
        return found

    def _floor_from_robot(self, each: MapRobot, travel: Travel, drive: int) -> Pose2 | None:
        """Return where a robot is: since it was seen by the calibration, else by where it was before a restart."""
        if self._calibrator.state.restarts:  # of what was known before, nothing holds
            each.anchor.forget()
        place = self._calibrator.floor_from_robot(travel, drive)
        return place if place is not None else each.anchor.floor_from_robot(travel.odom_from_robot, drive)

    def _reframe(self, reframed: Reframed) -> None:
        """Place ways and robots again in the frame of the new calibration: where the picture shows them."""
        for each in self._robots.values():
            each.planner.carry(reframed.carry)
            if reframed.before is not None:  # the first frame is the one that was kept
                each.anchor.carry(reframed.carry)

    def _place_scans(self) -> None:
        """Take the scans into a map that has none."""
        for each in self._robots.values():
            for past in each.trail.all():
                place = self._floor_from_robot(each, past.travel, past.drive)
                if place is not None:
                    self._site.hear_scan(past.scan, place, times=past.times)

    def _see(self, stamp_ns: int, disparity: Image32, places: Mapping[str, Pose2]) -> None:
        bodies = tuple(self._robots[name].shape.body(place) for name, place in places.items())
        unplaced = [each.sighting for name, each in self._robots.items() if each.sighting and name not in places]
        self._site.see(stamp_ns, disparity, bodies, unplaced)

    def _route(
        self,
        robot: str,
        goal: GoalPixel,
        stamp_ns: int,
        place: Pose2 | None,
        state: CalibrationState,
        grid: FloorGrid | None,
        *,
        has_turn: bool,
    ) -> MapRoute:
        each = self._robots[robot]
        if each.sighting is None and not each.anchor.holds:
            return MapRoute(None, None, _UNSEEN)
        travel = each.track.at(stamp_ns)
        if travel is None:
            return MapRoute(None, None, "the server hears no odometry of the robot")
        pixel = np.asarray(goal.normalised) * np.array(self._site.size_px) - 0.5
        if state.camera is None or place is None or not state.leads:
            return self._first_steps(each, pixel, stamp_ns, state)
        if grid is None and state.status == "learning":
            return self._first_steps(each, pixel, stamp_ns, state)
        if grid is None:
            return MapRoute(None, None, self._site.reason)
        goal_m, valid = state.camera.on_plane(pixel)
        if not valid:
            return MapRoute(None, None, "the goal is above the horizon")
        hidden_m = each.hidden_m(travel)
        target_m = each.search.target_m(goal.id, goal_m, np.array(place[:2]), hidden_m=hidden_m, stamp_ns=stamp_ns)
        if target_m is None:
            return MapRoute(None, None, "the camera sees the robot nowhere near its goal", goal_m)
        plan = each.planner.plan(grid, place, target_m, goal_id=goal.id, stamp_ns=stamp_ns, has_turn=has_turn)
        reason = plan.reason or self._site.reason
        if each.search.searching:
            reason = _SEARCHING
        elif each.anchor.holds:
            reason = _FROM_BEFORE
        elif not grid.covers(np.array(place[:2])):
            reason = _BEYOND
        arrived = hidden_m <= TRUSTED_M and math.hypot(*(goal_m - place[:2])) <= _ARRIVED_M
        return MapRoute(plan.waypoints_m, plan.way_m, reason, goal_m, arrived, target_m)

    def _first_steps(self, each: MapRobot, pixel: FloatArray, stamp_ns: int, state: CalibrationState) -> MapRoute:
        if each.sighting is None:
            return MapRoute(None, None, _UNSEEN)
        back = self._back(each, stamp_ns) if stamp_ns != each.sighting.stamp_ns else None
        if back is not None:
            return back
        bearing = _bearing_rad(each.sighting, pixel, each.shape.mount.size_m)
        scan = each.scan.points_m() if each.scan is not None else None
        steps = first_steps(scan, bearing, each.driven, self._steps)
        reason = steps.reason or f"learning the camera: {state.progress:.0%}"
        return MapRoute(steps.waypoints_m, None, reason)

    def _back(self, each: MapRobot, stamp_ns: int) -> MapRoute | None:
        """Lead a robot that left the camera's sight too early back the way it came; None if it hardly moved since."""
        travel = each.track.at(stamp_ns)
        if travel is None or not each.driven:
            return None
        odom_from_robot = travel.odom_from_robot
        apart = [math.hypot(*np.subtract(pose[:2], odom_from_robot[:2])) for pose in each.driven]
        seen = next((i for i in range(len(apart) - 1, -1, -1) if apart[i] >= _BACK_M), 0)
        if apart[seen] < _BACK_LEAST_M:
            return None
        back = odom_from_robot.inverse() @ each.driven[seen]
        shares = np.arange(1.0, self._steps.waypoints + 1.0)[:, None] / self._steps.waypoints
        waypoints = shares * np.array([back.x_m, back.y_m])
        return MapRoute(waypoints, None, "back to where the camera saw the robot: it is not calibrated yet")


def _bearing_rad(sighting: RobotSighting, pixel: FloatArray, tag_m: float) -> float:
    """Return about where a pixel lies from a robot's heading, left positive, by its tag alone."""
    places, valid = TagPlane(sighting, tag_size_m=tag_m).locate(pixel[None])
    if valid[0]:
        return math.atan2(places[0, 1], places[0, 0])
    ahead, aside = sighting.heading, pixel - sighting.pixel
    return -math.atan2(ahead[0] * aside[1] - ahead[1] * aside[0], float(ahead @ aside))  # v points down
