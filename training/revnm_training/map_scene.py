"""What the server's map shows in one world under one camera: as wrong as its calibration, depth and odometry are.

The server's own lift, drawing and scan memory, fed by the ray caster. Errors are drawn once a scene, but those of the
robot's place, which every look has its own. Imports neither torch nor PyBullet.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.floor_camera import FloorCamera
from revnm_server.frame import Frame
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import Body, FloorMapper, take_out
from revnm_server.mapping.floor_view import floor_view
from revnm_server.mapping.lift import FloorLifter, Lifted, NoFloor
from revnm_server.mapping.scan_memory import ScanMemory
from revnm_server.observation import Image32
from revnm_sim.camera import Camera
from revnm_sim.measures.lift_faults import DepthFault
from revnm_sim.measures.lift_truth import exact_calibration
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.sensors import Lidar, LidarSpec
from revnm_sim.shade import shade
from revnm_sim.world import World, primitive_arrays

if TYPE_CHECKING:
    from revnm_server.stages.depth import OnnxDepth

_NS_PER_S = 1e9
_BEAMS = 360


@dataclass(frozen=True, slots=True)
class MapFaults:
    """How wrong scenes are; each has errors of its own, drawn about these.

    Attributes:
        exact: Share of scenes with exact depth.
        network: Share of scenes whose depth is the shipped network's, of a picture with random textures and light.
        bias: Largest standard deviation of a smooth error of the other scenes' disparity, of its range.
        blur_px: Their largest blur.
        noise: Their largest noise, of the disparity's range.
        focal: Standard deviation of the focal length's error, relative.
        pitch_rad: The same of the pitch.
        roll_rad: The same of the roll.
        height: The same of the height, relative.
        place_m: The same of the robot's place at each look, on top of what the calibration does.
        heading_rad: The same of its heading.
    """

    exact: float = 0.25
    network: float = 0.45
    bias: float = 0.03
    blur_px: float = 1.5
    noise: float = 0.01
    focal: float = 0.02
    pitch_rad: float = math.radians(0.5)
    roll_rad: float = math.radians(0.3)
    height: float = 0.02
    place_m: float = 0.02
    heading_rad: float = math.radians(1.5)


EXACT = MapFaults(
    exact=1.0, network=0.0, focal=0.0, pitch_rad=0.0, roll_rad=0.0, height=0.0, place_m=0.0, heading_rad=0.0
)
"""Nothing is wrong."""


class MapScene:
    """One camera's map of one world, and the scans of a robot that drives there."""

    def __init__(
        self, world: World, camera: Camera, grid_hw: tuple[int, int], faults: MapFaults, rng: np.random.Generator
    ) -> None:
        """Calibrate wrongly, look once, and lift what is seen.

        Args:
            world: What stands there; the camera is taken to have seen it without the robot.
            camera: The true camera.
            grid_hw: Height and width of the disparity.
            faults: How wrong all is.
            rng: Decides the errors.
        """
        self._camera, self._robot, self._faults, self._rng = camera, RobotSpec(), faults, rng
        arrays = primitive_arrays(world.obstacles)
        self.calibration, covariance = _wrong(camera, faults, rng)
        view = floor_view(self.calibration, grid_hw, covariance)
        self.disparity = _disparity(world, camera, grid_hw, faults, rng)
        lifted = FloorLifter(view).lift(self.disparity, np.ones(grid_hw, dtype=np.bool_))
        self.lifted: Lifted | None = None if isinstance(lifted, NoFloor) else lifted
        mapper = FloorMapper(view)
        self._seen = None if self.lifted is None else mapper.draw(self.lifted, np.zeros(grid_hw, dtype=np.float32))
        self._spec = mapper.spec
        self._scans = ScanMemory(mapper.spec)
        self._lidar = Lidar(arrays, self._robot.lidar_height_m, LidarSpec(beams=_BEAMS), int(rng.integers(2**31)))
        self._now_s = 0.0

    def place(self, pose: Pose2) -> Pose2:
        """Return where the server has a robot that stands at ``world_from_robot``, floor frame, with its errors."""
        corners = see_robot(self._camera, pose, self._robot, robot="rover", stamp_ns=0).corners
        places, _ = self.calibration.on_plane(corners, self._robot.top_m)
        found, rng = _tag_pose(places), self._rng
        dx, dy = self._faults.place_m * rng.standard_normal(2)
        return Pose2(found.x_m + dx, found.y_m + dy, found.yaw_rad + self._faults.heading_rad * rng.standard_normal())

    def goal(self, goal_m: FloatArray) -> FloatArray | None:
        """Return where the server has a goal (2,) that is clicked at its true pixel; None over the horizon."""
        pixel, _ = self._camera.project(np.append(goal_m, 0.0))
        place, valid = self.calibration.on_plane(pixel)
        return place if valid else None

    def hear_scan(self, pose: Pose2, place: Pose2, *, elapsed_s: float, times: int) -> None:
        """Scan at ``world_from_robot``, and enter it where the server has the robot, for so many scans."""
        self._now_s += elapsed_s
        scan = self._lidar.scan(pose, int(self._now_s * _NS_PER_S))
        self._scans.update(scan, place, self._now_s, times=times)

    def forget_scans(self) -> None:
        """Begin anew, as after a restart."""
        self._scans.forget()

    def lidar(self) -> Image32:
        """Return what the scans alone say, (Ny, Nx)."""
        return self._scans.probability

    def grid(self, place: Pose2) -> FloorGrid:
        """Return the map with a robot at a place, which is taken out of it."""
        seen = self._seen or self._spec.unknown()
        grid = self._scans.fuse(seen, self._now_s)
        take_out(grid, Body(place, self._robot.length_m, self._robot.width_m, self._robot.top_m))
        return grid


def _wrong(
    camera: Camera, faults: MapFaults, rng: np.random.Generator
) -> tuple[FloorCamera, NDArray[np.float64] | None]:
    """Return a wrong calibration of a camera with the covariance (5, 5) that it believes in."""
    exact = exact_calibration(camera)
    sigma = rng.uniform(0.0, 2.0) * np.array([faults.focal, faults.pitch_rad, faults.roll_rad, faults.height, 0.0])
    wrong = FloorCamera.from_vector(exact.vector + sigma * rng.standard_normal(5), exact.size_px)
    return wrong, np.diag(np.square(sigma))


def _disparity(
    world: World, camera: Camera, hw: tuple[int, int], faults: MapFaults, rng: np.random.Generator
) -> Image32:
    """Return a disparity (h, w): exact, of the network, or disturbed."""
    kind = rng.random()
    if kind < faults.network:
        picture = shade(world, camera, (hw[1], hw[0]), rng)
        return _network().disparity(Frame(picture, 0, 0))
    exact = disparity_from_depth(cast_depth(primitive_arrays(world.primitives), camera, hw))
    if kind < faults.network + faults.exact:
        return exact
    strength = rng.random(3)
    fault = DepthFault(*(strength * np.array([faults.bias, faults.blur_px, faults.noise])))
    return fault.apply(exact, fault.field(hw, rng), rng)


@functools.cache
def _network() -> OnnxDepth:
    """Return the shipped depth network, loaded once a process; nothing else here needs ONNX."""
    from revnm_server.networks.bundle import default_bundle_path, load_depth_bundle
    from revnm_server.stages.depth import OnnxDepth

    return OnnxDepth(load_depth_bundle(default_bundle_path(), threads=1))


def _tag_pose(corners_m: FloatArray) -> Pose2:
    """Return the pose of a tag with corners (4, 2), front left first, clockwise."""
    ahead = corners_m[0] + corners_m[1] - corners_m[2] - corners_m[3]
    x, y = corners_m.mean(axis=0)
    return Pose2(float(x), float(y), float(np.arctan2(ahead[1], ahead[0])))
