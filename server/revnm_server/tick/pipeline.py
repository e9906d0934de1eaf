"""The server's tick: from a picture and goals to waypoints for each robot (paper, Fig. 2).

Symbols: R robots, N frames of history, H waypoints.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame, RobotSighting
from revnm_server.observation import (
    Image32,
    ImagePose,
    ObservationSpec,
    crops_around,
    exo_views,
    normalise_disparity,
    normalise_pixel,
)
from revnm_server.ports import (
    DisparitySource,
    EgoDepth,
    EgoRequest,
    GoalPixel,
    Planner,
    PlanRequest,
    SightingSource,
)
from revnm_server.stage_checks import check_array, timed
from revnm_server.tick.history import ImageHistory
from revnm_server.tick.site_report import SiteReport

_NS_PER_S = 1e9


@dataclass(frozen=True, slots=True)
class RobotPlan:
    """Where one robot should go.

    Attributes:
        robot: The robot's name.
        waypoints_m: (H, 2), metres, in the robot's frame at ``stamp_ns``.
        stamp_ns: Capture time of the picture that says where the robot is, nanoseconds, server's clock.
        goal_id: The goal that the waypoints lead to.
    """

    robot: str
    waypoints_m: FloatArray
    stamp_ns: int
    goal_id: str


@dataclass(frozen=True, slots=True)
class TickResult:
    """What one picture gave.

    Attributes:
        plans: One per robot that has a goal and whose place is known.
        sightings: Every robot that was seen recently, goal or not; ``stamp_ns`` says when.
        disparity: (h, w) in [0, 1], the whole picture.
        ego_depths: (ego_px, ego_px) in [−1, 1] of each robot that got a plan; where plans are made on the map, with
            the picture before, or with the one of its last turn where there are many robots.
        timings_ms: Duration of the stages ``depth``, ``tag``, ``exo2ego`` and ``policy``, and of the ``tick``, from
            picture to plans. Where plans are made on the map, there are the stages ``map``, a part of which runs beside
            the depth network, and ``learn``, of the camera; exo2ego, policy and learn are those of the picture before:
            they ran after its tick.
        site: What the camera has learnt of itself and of the place; None where no map is made.
    """

    plans: tuple[RobotPlan, ...]
    sightings: tuple[RobotSighting, ...]
    disparity: Image32
    ego_depths: dict[str, Image32]
    timings_ms: dict[str, float]
    site: SiteReport | None = None


class Pipeline:
    """Depth, pose, crop, exo2ego, policy; keeps the history that the networks see.

    Give it every picture once, in the order of time; pictures of another camera or another trial need another
    pipeline.
    """

    def __init__(
        self,
        spec: ObservationSpec,
        *,
        depth: DisparitySource,
        tags: SightingSource,
        exo2ego: EgoDepth,
        planner: Planner,
        max_sighting_age_s: float = 1.0,
    ) -> None:
        """Assemble the pipeline.

        Args:
            spec: What the networks observe.
            depth: Gives the picture's disparity.
            tags: Finds the robots.
            exo2ego: Gives ego depth.
            planner: Gives waypoints.
            max_sighting_age_s: A robot that was seen longer ago gets no plan; may be infinite.
        """
        self._spec = spec
        self._depth = depth
        self._tags = tags
        self._exo2ego = exo2ego
        self._planner = planner
        self._max_sighting_age_s = max_sighting_age_s
        self._disparities = self._new_history()
        self._egos: dict[str, ImageHistory] = {}
        self._last_seen: dict[str, RobotSighting] = {}

    def step(self, frame: Frame, goals: Mapping[str, GoalPixel]) -> TickResult:
        """Process one picture.

        Args:
            frame: The newest picture.
            goals: Where robots should go, by the robot's name; who is not in it gets no plan.

        Returns:
            The plans and what they were made from.

        Raises:
            ContractError: A stage gave an array of the wrong shape or with values that are not finite.
        """
        timings_ms: dict[str, float] = {}
        with timed(timings_ms, "tick"):
            with timed(timings_ms, "depth"):
                disparity = self._see_depth(frame)
            with timed(timings_ms, "tag"):
                sightings = self._see_robots(frame)
            driven = [sighting for sighting in sightings if sighting.robot in goals]
            with timed(timings_ms, "exo2ego"):
                crops = self._crop(frame, driven)
                egos = self._synthesise(crops)
            with timed(timings_ms, "policy"):
                observations = self._observe(crops, driven, goals)
                plans = self._plan(observations)
        return TickResult(plans, sightings, disparity, egos, timings_ms)

    def close(self) -> None:
        """Do nothing: nothing is kept, and nothing runs beside."""

    def _see_depth(self, frame: Frame) -> Image32:
        raw = self._depth.disparity(frame)
        check_array("disparity", raw, self._spec.disparity_hw)
        disparity = normalise_disparity(raw)
        self._disparities.push(disparity, frame.stamp_ns)
        return disparity

    def _see_robots(self, frame: Frame) -> tuple[RobotSighting, ...]:
        """Return the robots seen now or recently; who is hidden keeps the last sighting."""
        for sighting in self._tags.sightings(frame):
            self._last_seen[sighting.robot] = sighting
        self._last_seen = {
            robot: sighting
            for robot, sighting in self._last_seen.items()
            if 0.0 <= (frame.stamp_ns - sighting.stamp_ns) / _NS_PER_S <= self._max_sighting_age_s
        }
        return tuple(self._last_seen.values())

    def _crop(self, frame: Frame, driven: list[RobotSighting]) -> list[EgoRequest]:
        """Cut each robot's surroundings out of the history of disparity."""
        history = self._disparities.stack()
        width, height = frame.size_px
        requests = []
        for sighting in driven:
            pose = ImagePose(normalise_pixel(sighting.pixel, frame.size_px), sighting.heading)
            crops = crops_around(history, pose, width / height, self._spec)  # (N, crop_px, crop_px)
            requests.append(EgoRequest(sighting.robot, frame.stamp_ns, pose, crops))
        return requests

    def _synthesise(self, requests: list[EgoRequest]) -> dict[str, Image32]:
        """Return what each robot would see, and remember it for the history."""
        egos = self._exo2ego.synthesise(requests)  # (R, ego_px, ego_px)
        check_array("ego depth", egos, (len(requests), self._spec.ego_px, self._spec.ego_px))
        for request, ego in zip(requests, egos, strict=True):
            self._egos.setdefault(request.robot, self._new_history()).push(ego, request.stamp_ns)
        return {request.robot: ego for request, ego in zip(requests, egos, strict=True)}

    def _observe(
        self,
        crops: list[EgoRequest],
        driven: list[RobotSighting],
        goals: Mapping[str, GoalPixel],
    ) -> list[PlanRequest]:
        """Gather what the policy sees of each robot."""
        exo = exo_views(self._disparities.stack(), self._spec)  # (N, h, w)
        return [
            PlanRequest(
                robot=request.robot,
                stamp_ns=request.stamp_ns,
                sighting=sighting,
                pose=request.pose,
                goal=np.asarray(goals[request.robot].normalised, dtype=np.float64),
                goal_id=goals[request.robot].id,
                exo=exo,
                ego=self._egos[request.robot].stack(),  # (N, ego_px, ego_px)
            )
            for request, sighting in zip(crops, driven, strict=True)
        ]

    def _plan(self, requests: list[PlanRequest]) -> tuple[RobotPlan, ...]:
        waypoints = self._planner.waypoints(requests)
        check_array("waypoints", waypoints, (len(requests), self._spec.waypoints, 2))
        return tuple(
            RobotPlan(request.robot, waypoints_m, request.sighting.stamp_ns, request.goal_id)
            for request, waypoints_m in zip(requests, waypoints, strict=True)
        )

    def _new_history(self) -> ImageHistory:
        return ImageHistory(count=self._spec.history, interval_s=self._spec.history_interval_s)
