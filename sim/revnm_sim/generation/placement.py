"""Where to put the remote camera in a world: near a wall or in a corner, looking in, by ray casting.

Must not import PyBullet: training places cameras too.
"""

from __future__ import annotations

import math

import numpy as np

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import visible
from revnm_sim.world import Bounds, PrimitiveArrays, Shape, World, primitive_arrays

_TRIES = 40
_TRIES_FOR_POINTS = 400
_GOOD_SHARE = 0.5  # a view of this much of the free floor is taken at once
_LEAST_SHARE = 0.25  # the best of all tries must see this much
_CELL_M = 0.4
_OVERHEAD_M = 0.5  # what begins higher leaves the floor under it free
_CLEAR_M = 0.1  # least distance of the camera from everything
_INSET_M = (0.2, 0.8)  # distance from the wall, or from both walls of a corner
_CORNER_SHARE = 0.5


def sample_camera(
    world: World,
    rng: np.random.Generator,
    *,
    width_px: int,
    height_px: int,
    hfov_rad: float,
    height_range_m: tuple[float, float] = (1.8, 4.0),
    pitch_range_rad: tuple[float, float] = (math.radians(15.0), math.radians(50.0)),
    points_m: FloatArray | None = None,
) -> Camera:
    """Draw a remote camera that sees much of the free floor, and all of the points that it must see.

    The first of 40 draws (400 if there are points) that sees half of the free floor is taken, else the one that sees
    most.

    Args:
        world: The room.
        rng: Decides the draws.
        width_px: Width of the picture.
        height_px: Height of the picture.
        hfov_rad: Horizontal field of view.
        height_range_m: Height over the floor.
        pitch_range_rad: How far the view is bent down.
        points_m: (M, 3), what the camera must see, world frame.

    Raises:
        ContractError: No draw is clear of the obstacles and sees a quarter of the free floor and the points.
    """
    arrays = primitive_arrays(world.obstacles)
    floor = _free_floor(world.bounds, arrays)
    best, best_share = None, 0.0
    tries = _TRIES if points_m is None else _TRIES_FOR_POINTS
    for _ in range(tries if len(floor) else 0):
        position, yaw = _beside_wall(world.bounds, rng)
        point = (*position, rng.uniform(*height_range_m))
        camera = Camera(width_px, height_px, hfov_rad, point, yaw, rng.uniform(*pitch_range_rad))
        if distances_m(arrays, np.array([point])).min(initial=math.inf) < _CLEAR_M:
            continue
        if points_m is not None and not visible(arrays, camera, points_m).all():
            continue
        if camera.inside(*camera.project(floor)).mean() <= best_share:
            continue  # what is in the picture bounds what is visible, and costs less to know
        share = float(visible(arrays, camera, floor).mean())
        if share > best_share:
            best, best_share = camera, share
        if share >= _GOOD_SHARE:
            break
    if best is None or best_share < _LEAST_SHARE:
        raise ContractError(
            f"world {world.name!r}: none of {tries} camera poses is clear of the obstacles and sees "
            f"{'' if points_m is None else 'start and goal and '}{_LEAST_SHARE:.0%} of the {len(floor)} free floor "
            f"cells; the best sees {best_share:.0%}"
        )
    return best


def _free_floor(bounds: Bounds, arrays: PrimitiveArrays) -> FloatArray:
    """Return the middles (M, 3) of the floor cells that nothing stands on."""
    x = np.arange(bounds.x_min_m + _CELL_M / 2.0, bounds.x_max_m, _CELL_M)
    y = np.arange(bounds.y_min_m + _CELL_M / 2.0, bounds.y_max_m, _CELL_M)
    points = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1).reshape(-1, 3)
    standing = arrays.centre_m[:, 2] - arrays.half_m[:, 2] < _OVERHEAD_M
    away = _plan_distances(arrays, points)[:, standing].min(axis=1, initial=math.inf)
    return np.asarray(points[away > 0.0])


def distances_m(arrays: PrimitiveArrays, points_m: FloatArray) -> FloatArray:
    """Return the distance (M, P) of points (M, 3) from primitives, metres, 0 inside."""
    z = np.abs(points_m[:, None, 2] - arrays.centre_m[:, 2]) - arrays.half_m[:, 2]
    return np.hypot(_plan_distances(arrays, points_m), np.maximum(z, 0.0))


def _plan_distances(arrays: PrimitiveArrays, points_m: FloatArray) -> FloatArray:
    """Return the distance (M, P) of points (M, 3) from primitives as seen from above, metres, 0 inside."""
    offset = points_m[:, None, :2] - arrays.centre_m[:, :2]  # (M, P, 2)
    c, s = arrays.axis[:, 0], arrays.axis[:, 1]
    x, y = offset[..., 0], offset[..., 1]
    out_x = np.abs(c * x + s * y) - arrays.half_m[:, 0]
    out_y = np.abs(c * y - s * x) - arrays.half_m[:, 1]
    box = np.hypot(np.maximum(out_x, 0.0), np.maximum(out_y, 0.0))
    disc = np.maximum(np.hypot(x, y) - arrays.half_m[:, 0], 0.0)
    return np.where(arrays.shape == Shape.CYLINDER, disc, box)


def _beside_wall(bounds: Bounds, rng: np.random.Generator) -> tuple[tuple[float, float], float]:
    """Draw a place near the edge of the room and a direction from it into the middle half of the room."""
    low = np.array([bounds.x_min_m, bounds.y_min_m])
    high = np.array([bounds.x_max_m, bounds.y_max_m])
    inset = rng.uniform(*_INSET_M, 2)
    place = np.where(rng.random(2) < 0.5, low + inset, high - inset)
    if rng.random() >= _CORNER_SHARE:
        along = int(rng.integers(2))
        place[along] = rng.uniform(low[along] + inset[along], high[along] - inset[along])
    target = rng.uniform(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)
    yaw = math.atan2(target[1] - place[1], target[0] - place[0])
    return (float(place[0]), float(place[1])), yaw
