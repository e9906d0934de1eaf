"""One drive along the expert's way, seen through the map that the server makes of it. Imports no PyBullet."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_server.mapping.disparity_memory import DisparityMemory
from revnm_server.mapping.floor_map import Body, FloorMapper
from revnm_server.mapping.floor_view import floor_view
from revnm_server.mapping.lift import FloorLifter, NoFloor
from revnm_server.mapping.map_window import WindowSpec, map_window
from revnm_server.mapping.robot_mask import robot_mask
from revnm_server.observation import Image32
from revnm_sim.bench.protocol import Setting
from revnm_sim.camera import Camera
from revnm_sim.measures.lift_faults import CalibrationFault, DepthFault
from revnm_sim.measures.lift_truth import Score, Truth, score, true_window
from revnm_sim.occupancy import occupancy
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth, overlay_depth, robot_primitive
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.scenario import tag_seen
from revnm_sim.world import primitive_arrays

HW = (192, 256)
_POSES = 10
_INTERVAL_S = 0.5
_FINE_M = 0.02
WINDOW = WindowSpec()


@dataclass(slots=True)
class Outcome:
    """What a drive showed.

    Attributes:
        scores: One a picture that became a map.
        refused: Why the others did not.
        times_ms: Memory, lift and drawing together, one a picture.
        windows: The first two layers (2, side, side) of every place's window; None for those that were refused.
    """

    scores: list[Score] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    times_ms: list[float] = field(default_factory=list)
    windows: list[Image32 | None] = field(default_factory=list)

    def add(self, other: Outcome) -> None:
        """Take another drive in."""
        self.scores += other.scores
        self.refused += other.refused
        self.times_ms += other.times_ms
        self.windows += other.windows


@dataclass(frozen=True, slots=True)
class View:
    """A place on the way.

    Attributes:
        pose: ``world_from_robot``.
        disparity: (h, w) exact, 1/m, with the robot.
        truth: What its window should show.
    """

    pose: Pose2
    disparity: Image32
    truth: Truth


def views(setting: Setting) -> list[View]:
    """Return the places on the expert's way where the first camera sees the tag."""
    world, camera, robot = setting.site.world, setting.cameras[0], RobotSpec()
    arrays, fine = primitive_arrays(world.obstacles), occupancy(world, resolution_m=_FINE_M)
    depth = cast_depth(arrays, camera, HW)
    found = []
    for pose in _poses(setting):
        if tag_seen(arrays, camera, np.array([pose[:2]]), robot)[0]:
            seen = overlay_depth(depth, camera, robot_primitive(pose, robot))
            truth = true_window(arrays, fine, camera, pose, HW, WINDOW)
            found.append(View(pose, disparity_from_depth(seen), truth))
    return found


def drive(
    places: list[View], camera: Camera, calibration: CalibrationFault, depth: DepthFault, rng: np.random.Generator
) -> Outcome:
    """Show the server the places one after the other and score its maps.

    The robot's place in the map is where its tag is seen, lifted with the calibration at hand.
    """
    ours, covariance = calibration.apply(camera, rng)
    view = floor_view(ours, HW, covariance)
    memory, lifter, mapper = DisparityMemory(HW), FloorLifter(view), FloorMapper(view)
    bias, outcome = depth.field(HW, rng), Outcome()
    for number, place in enumerate(places):
        body = _body(ours, camera, place.pose)
        mask = robot_mask(view, (body,))
        disparity = depth.apply(place.disparity, bias, rng)
        begin = time.perf_counter()
        remembered = memory.update(disparity, mask, number * _INTERVAL_S)
        lifted = lifter.lift(remembered.disparity, remembered.usable)
        if isinstance(lifted, NoFloor):
            outcome.refused.append(lifted.reason)
            outcome.windows.append(None)
            continue
        grid = mapper.draw(lifted, remembered.age_s, (body,))
        outcome.times_ms.append(1e3 * (time.perf_counter() - begin))
        window = map_window(grid, body.floor_from_robot, spec=WINDOW)
        outcome.windows.append(window[:2].copy())
        outcome.scores.append(score(place.truth, window[0], window[1]))
    return outcome


def _poses(setting: Setting) -> Iterator[Pose2]:
    start = setting.pair.start
    way = setting.route.field.path(start[:2])
    for index in np.linspace(0, len(way) - 1, _POSES).astype(int):
        ahead = way[min(index + 4, len(way) - 1)] - way[max(index - 4, 0)]
        yield Pose2(float(way[index, 0]), float(way[index, 1]), float(np.arctan2(ahead[1], ahead[0])))


def _body(ours: FloorCamera, camera: Camera, pose: Pose2) -> Body:
    robot = RobotSpec()
    corners = see_robot(camera, pose, robot, robot="rover", stamp_ns=0).corners
    places, _ = ours.on_plane(corners, robot.top_m)
    return Body(_pose_of(places), robot.length_m, robot.width_m, robot.top_m)


def _pose_of(corners_m: FloatArray) -> Pose2:
    """Return the pose of a tag with corners (4, 2), front left first, clockwise."""
    ahead = corners_m[0] + corners_m[1] - corners_m[2] - corners_m[3]
    x, y = corners_m.mean(axis=0)
    return Pose2(float(x), float(y), float(np.arctan2(ahead[1], ahead[0])))
