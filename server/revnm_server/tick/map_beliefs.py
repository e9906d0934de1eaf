"""What a policy makes of the map around each robot: it corrects what the camera saw wrong, and guesses what is hidden.

route + map → window, way, goal  ┐
disparity + place → crop, prior → exo2ego → ego depth  ┴→ policy → beliefs → map

The planner plans on the map with the beliefs in it. Source of the idea: Ramakrishnan, Al-Halah and Grauman, 2020,
arXiv:2008.09285 (occupancy anticipation).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from revnm_client.geometry import Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_server.mapping.ego_prior import ego_prior
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.map_window import WAY_POINTS, map_window
from revnm_server.mapping.site_map import SiteMap
from revnm_server.observation import (
    Image32,
    ImagePose,
    ObservationSpec,
    crop_around,
    normalise_disparity,
    normalise_pixel,
)
from revnm_server.planning.way import at_lengths
from revnm_server.ports import BeliefRequest, EgoDepth, EgoRequest, FloorPolicy
from revnm_server.stage_checks import check_array, timed
from revnm_server.tick.map_route import MapRoute, NavigatorTick
from revnm_server.tick.turns import Turns

_STEP_M = 0.01
AT_ONCE = 4  # robots a picture: with 16 at five pictures a second each is judged anew every 0.8 s


class MapBeliefs:
    """Renews the beliefs about one camera's map."""

    def __init__(self, spec: ObservationSpec, *, exo2ego: EgoDepth, policy: FloorPolicy, tag_height_m: float) -> None:
        """Assemble it.

        Args:
            spec: What the networks observe.
            exo2ego: Gives ego depth.
            policy: Gives beliefs.
            tag_height_m: Of the robots' tags over the floor.
        """
        self._spec, self._exo2ego, self._policy, self._tag_m = spec, exo2ego, policy, tag_height_m
        self._turns, self._egos = Turns(AT_ONCE), dict[str, Image32]()

    def renew(
        self, tick: NavigatorTick, site: SiteMap, disparity: Image32, stamp_ns: int, timings_ms: dict[str, float]
    ) -> dict[str, Image32]:
        """Let the policy judge the floor around robots that follow a way, for the next plan; many robots take turns.

        Args:
            tick: What the navigator made of the picture.
            site: The map; takes the beliefs.
            disparity: (h, w) of the picture.
            stamp_ns: Its capture time.
            timings_ms: Takes the durations of ``exo2ego`` and ``policy``.

        Returns:
            The ego depth (ego_px, ego_px) of all such robots, of their last turn.
        """
        camera, grid = tick.calibration.camera, tick.grid
        led = [robot for robot, route in tick.routes.items() if route.way_m is not None and route.aim_m is not None]
        if camera is None or grid is None or not led:
            self._egos = {}
            return {}
        led, before = self._turns.next(led), {robot: self._egos[robot] for robot in led if robot in self._egos}
        with timed(timings_ms, "exo2ego"):
            egos = self._imagine(led, tick.places, camera, grid, site, disparity, stamp_ns)
        with timed(timings_ms, "policy"):
            scans = site.scans_alone()
            occupied = self._policy.believe(
                [
                    self._request(tick.routes[robot], tick.places[robot], grid, scans, ego)
                    for robot, ego in zip(led, egos, strict=True)
                ]
            )
        site.believe([(each, tick.places[robot]) for robot, each in zip(led, occupied, strict=True)], stamp_ns)
        self._egos = before | dict(zip(led, egos, strict=True))
        return self._egos

    def _imagine(
        self,
        robots: Sequence[str],
        places: Mapping[str, Pose2],
        camera: FloorCamera,
        grid: FloorGrid,
        site: SiteMap,
        disparity: Image32,
        stamp_ns: int,
    ) -> Image32:
        """Return what the robots would see, (R, ego_px, ego_px)."""
        spec, shown = self._spec, normalise_disparity(disparity)
        aspect = camera.size_px[0] / camera.size_px[1]
        requests = []
        for robot in robots:
            place = places[robot]
            pose = image_pose(camera, place, self._tag_m)
            crops = crop_around(shown, pose, aspect, spec)[None]
            prior = ego_prior(site.lifted, grid, place, spec)
            requests.append(EgoRequest(robot, stamp_ns, pose, crops, prior))
        egos = self._exo2ego.synthesise(requests)
        check_array("ego depth", egos, (len(requests), spec.ego_px, spec.ego_px))
        return egos

    def _request(
        self, route: MapRoute, place: Pose2, grid: FloorGrid, scans: Image32 | None, ego: Image32
    ) -> BeliefRequest:
        assert route.way_m is not None
        assert route.aim_m is not None
        lengths = self._spec.spacing_m * np.arange(1.0, WAY_POINTS + 1.0)
        way = place.inverse().apply(at_lengths(route.way_m, lengths))
        return BeliefRequest(map_window(grid, place, scans), way, place.inverse().apply(route.aim_m), ego)


def image_pose(camera: FloorCamera, place: Pose2, tag_height_m: float) -> ImagePose:
    """Return where a robot at a place on the floor, seen or hidden, is in the picture.

    Behind the camera there is no such place: then it is the middle, heading up.
    """
    ahead = place @ Pose2(_STEP_M, 0.0, 0.0)
    points = np.array([[*place[:2], tag_height_m], [*ahead[:2], tag_height_m]])
    pixels, depths = camera.project(points)
    step = pixels[1] - pixels[0]
    length = math.hypot(*step)
    if not (depths > 0.0).all() or not math.isfinite(length) or length < 1e-9:
        return ImagePose(np.array([0.5, 0.5]), np.array([0.0, -1.0]))
    return ImagePose(normalise_pixel(pixels[0], camera.size_px), step / length)
