"""Compares the ray caster of the graphics card, or of numba's simulator of one, with that of the CPU."""

from __future__ import annotations

import math

import numpy as np

from revnm_client.geometry import Pose2
from revnm_server.observation import ObservationSpec
from revnm_sim.camera import Camera
from revnm_sim.rays.cuda_raycast import cast_depths_cuda
from revnm_sim.rays.raycast import cast_depths, ego_camera
from revnm_sim.world import Primitive, Shape, primitive_arrays
from revnm_sim.worlds import generated_world

FAMILIES = ("random_pillar", "slits", "aisles", "rooms")
SPEC = ObservationSpec(
    history=1,
    history_interval_s=0.5,
    disparity_hw=(48, 64),
    exo_hw=(48, 64),
    crop_px=32,
    crop_span=0.4,
    crop_heading_up=True,
    ego_px=32,
    ego_hfov_rad=math.radians(120.0),
    ego_height_m=0.25,
    ego_range_m=6.0,
    waypoints=5,
    spacing_m=0.4,
)


def differing_share(family: str, seed: int, cameras: int, grid_hw: tuple[int, int]) -> float:
    """Return the share of pixels in which the two differ by more than 1e-5 of the depth.

    Remote cameras over a generated world and robots' cameras in it take turns; a cylinder hangs before them, and a box
    holds the first of them.
    """
    rng = np.random.default_rng(seed)
    world = generated_world(family, seed)
    chosen = [_camera(rng, number) for number in range(cameras)]
    around = Primitive(Shape.BOX, chosen[0].position_m, (0.3, 0.3, 0.3), 0.4, (0, 0, 0))
    hanging = Primitive(Shape.CYLINDER, (1.0, 1.0, 1.5), (0.8, 0.8, 0.5), 0.0, (0, 0, 0))
    arrays = primitive_arrays((*world.primitives, around, hanging))
    here = cast_depths(arrays, chosen, grid_hw, max_depth_m=9.0)
    there = cast_depths_cuda(arrays, chosen, grid_hw, max_depth_m=9.0)
    assert there.shape == here.shape == (cameras, *grid_hw)
    assert there.dtype == here.dtype == np.float32
    assert np.isfinite(here).mean() > 0.3
    same = (here == there) | (np.abs(here - there) <= 1e-5 * here)
    return 1.0 - float(same.mean())


def _camera(rng: np.random.Generator, number: int) -> Camera:
    x, y, yaw = rng.uniform((-2.0, -2.0, -math.pi), (2.0, 2.0, math.pi))
    if number % 2:
        return ego_camera(Pose2(x, y, yaw), SPEC)
    return Camera(640, 480, math.radians(100.0), (x, y, rng.uniform(1.8, 4.0)), yaw, rng.uniform(0.2, 0.9), 0.02)


if __name__ == "__main__":
    shares = [differing_share(family, seed, 2, (9, 12)) for seed, family in enumerate(FAMILIES)]
    print(max(shares))
