"""Renders what the map policy sees in the states of an episode, and what it should learn there.

An episode's states are visited in their order, as if one robot drove from each to the next: its scans stay in the map.
Imports neither torch nor PyBullet.

Symbols: S states, side of the window, P points of the way, H waypoints, e side of the ego picture, c of the crop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.ego_prior import ego_prior
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.map_window import WAY_POINTS, WindowSpec, map_window, window_points_m
from revnm_server.observation import (
    Image32,
    ImagePose,
    ObservationSpec,
    crop_around,
    normalise_disparity,
    normalise_ego_depth,
    normalise_pixel,
)
from revnm_server.planning.travel_cost import CostSettings, travel_cost
from revnm_sim.expert.planner import CostToGo, Expert
from revnm_sim.expert.potential import march, waypoints_of
from revnm_sim.occupancy import OccupancyGrid
from revnm_sim.rays.raycast import cast_depths, ego_camera
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.world import primitive_arrays
from revnm_training.episodes import Episode
from revnm_training.map_scene import MapFaults, MapScene
from revnm_training.render_device import DepthCaster
from revnm_training.samples import build_world

COST_RANGE_M = 8.0
COST_STRIDE = 2
_REPLAN_STATES = 4  # states that share a look for ways: it takes as long as all else
_SCANS_PER_STATE = 5
_SECONDS_PER_STATE = 1.0
_RESTART_SHARE = 0.5
_CLOSED_COST = 300.0
_SURE_M = 0.12
_PARTS = 2


@dataclass(frozen=True, slots=True)
class MapSample:
    """One state, seen and labelled.

    Attributes:
        layers: (4, side, side) the map's window.
        way: (P, 2) points 0.4 m apart on the planner's way, robot frame, metres, by the map.
        goal: (2,) where the map has the goal, robot frame, metres.
        crop: (c, c) disparity around the robot, heading up, in [0, 1].
        prior: (2, e, e) the reprojected depth.
        ego: (e, e) the true ego depth in [−1, 1].
        robot: (2,) normalised pixel.
        heading: (2,) unit vector in the picture.
        occupied: (side, side) what truly stands there, outside of the world included.
        cost: (side / 2, side / 2) how much more the expert's way to the goal costs from there than from the robot,
            metres, within ± 8; inf where there is no way.
        waypoints: (H, 2) the expert's way, robot frame, metres.
    """

    layers: Image32
    way: FloatArray
    goal: FloatArray
    crop: Image32
    prior: Image32
    ego: Image32
    robot: FloatArray
    heading: FloatArray
    occupied: NDArray[np.bool_]
    cost: Image32
    waypoints: FloatArray


class MapEpisodeRenderer:
    """Renders the states of one episode in order."""

    def __init__(
        self,
        episode: Episode,
        spec: ObservationSpec,
        faults: MapFaults,
        rng: np.random.Generator,
        cast: DepthCaster = cast_depths,
    ) -> None:
        self._episode, self._spec, self._rng = episode, spec, rng
        world = build_world(episode.family, episode.world_seed)
        self._expert = Expert(world)
        robots = [ego_camera(Pose2(*pose), spec) for pose in episode.poses[:, -1]]
        self._egos = cast(primitive_arrays(world.primitives), robots, (spec.ego_px, spec.ego_px))
        self._scene = MapScene(world, episode.camera, spec.disparity_hw, faults, rng)
        self._disparity = normalise_disparity(self._scene.disparity)
        self._window = WindowSpec()
        self._points_m = window_points_m(self._window)

    def samples(self) -> list[MapSample]:
        """Return a sample of every state."""
        episode, found = self._episode, []
        for number, goal in enumerate(episode.goals_m):
            states = np.flatnonzero(episode.goal == number)
            if not len(states):
                continue
            if self._rng.random() < _RESTART_SHARE:
                self._scene.forget_scans()
            field = self._expert.field(goal)
            potential: FloatArray | None = None
            for count, state in enumerate(states):
                pose = Pose2(*episode.poses[state, -1])
                robot = self._scene.place(pose)
                self._scene.hear_scan(pose, robot, elapsed_s=_SECONDS_PER_STATE, times=_SCANS_PER_STATE)
                grid, place = self._scene.grid(robot), self._scene.goal(goal)
                if place is None:  # over the horizon of the wrong calibration
                    place = robot.apply(pose.inverse().apply(goal))
                if potential is None or count % _REPLAN_STATES == 0:
                    potential = _potential(grid, place)
                way = _way(grid, potential, robot, place)
                found.append(self._sample(int(state), robot, place, grid, way, field))
        return found

    def _sample(
        self, state: int, robot: Pose2, goal_m: FloatArray, grid: FloorGrid, way: FloatArray, field: CostToGo
    ) -> MapSample:
        scene, spec, camera = self._scene, self._spec, self._episode.camera
        pose = Pose2(*self._episode.poses[state, -1])
        size = (camera.width_px, camera.height_px)
        sighting = see_robot(camera, pose, RobotSpec(), robot="rover", stamp_ns=0)
        seen = ImagePose(normalise_pixel(sighting.pixel, size), sighting.heading)
        return MapSample(
            layers=map_window(grid, robot, scene.lidar(), self._window),
            way=way,
            goal=robot.inverse().apply(goal_m),
            crop=crop_around(self._disparity, seen, size[0] / size[1], spec),
            prior=ego_prior(scene.lifted, grid, robot, spec),
            ego=normalise_ego_depth(self._egos[state], spec),
            robot=seen.p_rob,
            heading=seen.q_rel,
            occupied=occupied_window(self._expert.grid, pose, self._points_m, self._window.cell_m),
            cost=_cost_window(field, pose, self._points_m[::COST_STRIDE, ::COST_STRIDE]),
            waypoints=np.asarray(self._episode.waypoints_m[state], dtype=np.float64),
        )


def occupied_window(grid: OccupancyGrid, pose: Pose2, points_m: FloatArray, cell_m: float) -> NDArray[np.bool_]:
    """Return which cells (side, side) with middles (side, side, 2), robot frame, something stands in."""
    offsets = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5) * cell_m
    found = np.zeros(points_m.shape[:2], dtype=np.bool_)
    for dx in offsets:
        for dy in offsets:
            rows, columns, inside = _world_cells(grid, pose.apply(points_m + np.array([dx, dy])))
            found |= ~inside | grid.occupied[rows, columns]
    return found


def _cost_window(field: CostToGo, pose: Pose2, points_m: FloatArray) -> Image32:
    rows, columns, inside = _world_cells(field.grid, pose.apply(points_m))
    here = _world_cells(field.grid, np.array([[pose.x_m, pose.y_m]]))
    relative = field.potential[rows, columns] - field.potential[here[0][0], here[1][0]]
    reached = inside & np.isfinite(relative)
    return np.where(reached, np.clip(relative, -COST_RANGE_M, COST_RANGE_M), np.inf).astype(np.float32)


def _world_cells(
    grid: OccupancyGrid, points_m: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Return rows, columns and whether they are inside, of points (..., 2); those outside get row and column 0."""
    cells = np.floor((points_m - np.array(grid.origin_m)) / grid.resolution_m).astype(np.int64)
    rows, columns = cells[..., 1], cells[..., 0]
    inside = (rows >= 0) & (rows < grid.occupied.shape[0]) & (columns >= 0) & (columns < grid.occupied.shape[1])
    return np.where(inside, rows, 0), np.where(inside, columns, 0), inside


def _potential(grid: FloorGrid, goal_m: FloatArray) -> FloatArray:
    """Return the cost (Ny, Nx), in cells, from everywhere on the map to a goal, as the server's planner counts."""
    cost = travel_cost(grid, CostSettings())
    per_cell = np.where(cost.sure_m <= _SURE_M, _CLOSED_COST, cost.per_m).astype(np.float64)
    per_cell[[0, -1]] = np.inf
    per_cell[:, [0, -1]] = np.inf
    row, column = _clipped(grid, goal_m)
    return np.asarray(march(per_cell, row, column, 1.5))


def _way(grid: FloorGrid, potential: FloatArray, robot: Pose2, goal_m: FloatArray) -> FloatArray:
    """Return the way's points (P, 2), robot frame; straight ahead where the robot is off the map."""
    spacing_m = 0.4
    start = np.array([_clipped(grid, np.array(robot[:2]))])
    out = np.empty((1, WAY_POINTS, 2))
    waypoints_of(potential, start, np.array(_clipped(grid, goal_m)), 2.0, spacing_m / grid.cell_m, out)
    return np.asarray(robot.inverse().apply(grid.points_m(out[0])))


def _clipped(grid: FloorGrid, point_m: FloatArray) -> tuple[float, float]:
    """Return the cell (row, column) of a point, moved into the map if need be."""
    row, column = np.clip(grid.cells(point_m), 1.0, np.array(grid.obstacle.shape) - 2.0)
    return float(row), float(column)
