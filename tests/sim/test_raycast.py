"""Exact depth and scans: hand-made arithmetic, and PyBullet as an independent library."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pybullet as p
import pytest

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.observation import ObservationSpec
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import (
    FLOOR,
    SKY,
    cast_depth,
    cast_ids,
    cast_scan,
    disparity_from_depth,
    ego_camera,
    overlay_depth,
    robot_primitive,
    visible,
)
from revnm_sim.robot import RobotSpec
from revnm_sim.world import Primitive, PrimitiveArrays, Shape, primitive_arrays

GREY = (128, 128, 128)


def box(centre: tuple[float, float, float], size: tuple[float, float, float], yaw: float = 0.0) -> Primitive:
    return Primitive(Shape.BOX, centre, size, yaw, GREY)


def cylinder(centre: tuple[float, float, float], diameter: float, height: float) -> Primitive:
    return Primitive(Shape.CYLINDER, centre, (diameter, diameter, height), 0.3, GREY)


def arrays_of(*primitives: Primitive) -> PrimitiveArrays:
    return primitive_arrays(primitives)


def level(position: tuple[float, float, float], *, width: int = 5, height: int = 5) -> Camera:
    return Camera(width, height, math.radians(90.0), position, 0.0, 0.0)


def random_primitives(seed: int, count: int = 25) -> tuple[Primitive, ...]:
    """A walled room of 8 m with boxes and cylinders, one of them hanging; (1, 1) stays free."""
    rng = np.random.default_rng(seed)
    walls = [((0.0, 4.0), (0.2, 8.0)), ((8.0, 4.0), (0.2, 8.0)), ((4.0, 0.0), (8.0, 0.2)), ((4.0, 8.0), (8.0, 0.2))]
    found = [box((*middle, 1.2), (*size, 2.4)) for middle, size in walls]
    found.append(box((5.0, 5.0, 1.5), (1.0, 0.6, 0.4), 0.8))
    while len(found) < count:
        x, y = rng.uniform(0.8, 7.2, 2)
        if math.hypot(x - 1.0, y - 1.0) < 1.5:
            continue
        height, width = rng.uniform(0.3, 2.0), rng.uniform(0.2, 0.8)
        if rng.random() < 0.5:
            found.append(cylinder((x, y, height / 2.0), width, height))
        else:
            size = (width, rng.uniform(0.2, 1.5), height)
            found.append(box((x, y, height / 2.0), size, rng.uniform(-3.0, 3.0)))
    return tuple(found)


def random_camera(rng: np.random.Generator, *, width: int = 64, height: int = 48) -> Camera:
    position = (*rng.uniform(0.4, 1.4, 2), rng.uniform(1.0, 3.5))
    fov, yaw, pitch = rng.uniform(1.0, 2.1), rng.uniform(-0.3, 1.8), rng.uniform(0.0, 0.8)
    return Camera(width, height, fov, position, yaw, pitch, rng.uniform(-0.2, 0.2))


def ray_ends(camera: Camera, grid_hw: tuple[int, int], depth_m: float) -> FloatArray:
    """World points (h·w, 3) at a depth on the rays of a grid, from the camera's own pixel convention."""
    height, width = grid_hw
    u = (np.arange(width) + 0.5) * camera.width_px / width - 0.5
    v = (np.arange(height) + 0.5) * camera.height_px / height - 0.5
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    local = np.column_stack([(pixels - camera.centre_px) / camera.focal_px, np.ones(len(pixels))])
    return np.asarray(np.array(camera.position_m) + depth_m * local @ camera.world_from_camera().T)


# Hand-made arithmetic. Cells of a level 5 × 5 camera with 90°: focal length 2.5, so x/z and y/z are ±0.8, ±0.4, 0.


def test_depth_of_wall_is_constant_and_of_floor_follows_the_slope() -> None:
    wall = box((3.5, 0.0, 5.0), (1.0, 100.0, 10.0))  # its near face stands at x = 3
    depth = cast_depth(arrays_of(wall), level((0.0, 0.0, 1.0)), (5, 5))
    # Rows 0 to 2 look up or level: the wall. Row 3 falls 0.4 per metre, reaches the floor at 2.5 m; row 4 at 1.25 m.
    expected = np.repeat(np.array([3.0, 3.0, 3.0, 2.5, 1.25])[:, None], 5, axis=1)
    assert depth.dtype == np.float32
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


def test_empty_world_is_floor_and_sky() -> None:
    depth, ids, normals = cast_ids(arrays_of(), level((0.0, 0.0, 1.0)), (5, 5))
    assert np.isposinf(depth[:3]).all()
    assert (ids[:3] == SKY).all()
    assert (ids[3:] == FLOOR).all()
    np.testing.assert_array_equal(normals[3:], np.broadcast_to([0.0, 0.0, 1.0], (2, 5, 3)))
    assert not normals[:3].any()
    np.testing.assert_allclose(disparity_from_depth(depth)[:, 0], [0.0, 0.0, 0.0, 0.4, 0.8], rtol=1e-6)


def test_cylinder_side_and_cap() -> None:
    # Eye at height 1, axis 3 m ahead, radius 1. Level ray: 3 − 1 = 2. Column 3 (slope 0.4): (t − 3)² + 0.16 t² = 1,
    # 1.16 t² − 6 t + 8 = 0, discriminant 36 − 37.12 < 0: passes.
    tall = arrays_of(cylinder((3.0, 0.0, 1.0), 2.0, 2.0))
    depth = cast_depth(tall, level((0.0, 0.0, 1.0)), (5, 5))
    assert depth[2, 2] == pytest.approx(2.0)
    assert np.isinf(depth[2, [0, 1, 3, 4]]).all()
    # With radius 1.5: 1.16 t² − 6 t + 6.75 = 0, t = (6 − √4.68) / 2.32.
    depth = cast_depth(arrays_of(cylinder((3.0, 0.0, 1.0), 3.0, 2.0)), level((0.0, 0.0, 1.0)), (5, 5))
    assert depth[2, 3] == pytest.approx((6.0 - math.sqrt(4.68)) / 2.32)
    # A low one, 0.2 high, from x = 1.8: row 3 (falls 0.4 a metre) comes down to its cap after 0.8 / 0.4 = 2 m. Row 4
    # reaches the floor before it, at 1.25 m.
    depth, ids, normals = cast_ids(arrays_of(cylinder((3.0, 0.0, 0.1), 2.4, 0.2)), level((0.0, 0.0, 1.0)), (5, 5))
    assert depth[3, 2] == pytest.approx(2.0)
    assert ids[3, 2] == 0
    np.testing.assert_array_equal(normals[3, 2], [0.0, 0.0, 1.0])
    assert ids[4, 2] == FLOOR


def test_yawed_box_shows_its_edge_and_normals() -> None:
    # A square post of side √2 turned by 45° points an edge at the eye: half diagonal 1, edge at x = 3 − 1 = 2.
    # A camera of 3 × 3 with focal length 10: slopes ±0.1.
    arrays = arrays_of(box((3.0, 0.0, 1.0), (math.sqrt(2.0), math.sqrt(2.0), 2.0), math.radians(45.0)))
    camera = Camera(3, 3, 2.0 * math.atan(0.15), (0.0, 0.0, 1.0), 0.0, 0.0)
    depth, _, normals = cast_ids(arrays, camera, (3, 3))
    # Left column: y = 0.1 t on the face x = 2 + y, so t = 2 / 0.9. Right column: the same by symmetry.
    np.testing.assert_allclose(depth[1], [2.0 / 0.9, 2.0, 2.0 / 0.9], rtol=1e-6)
    half = math.sqrt(0.5)
    np.testing.assert_allclose(normals[1, 0], [-half, half, 0.0], atol=1e-6)
    np.testing.assert_allclose(normals[1, 2], [-half, -half, 0.0], atol=1e-6)


def test_cylinder_normal_points_from_its_axis() -> None:
    camera = Camera(3, 3, 2.0 * math.atan(0.15), (0.0, 0.0, 1.0), 0.0, 0.0)
    depth, ids, normals = cast_ids(arrays_of(cylinder((3.0, 0.0, 1.0), 2.0, 2.0)), camera, (3, 3))
    hit = np.array([depth[1, 0], 0.1 * depth[1, 0]])
    assert ids[1, 0] == 0
    np.testing.assert_allclose(normals[1, 0, :2], hit - np.array([3.0, 0.0]), atol=1e-6)


def test_limit_turns_far_cells_into_sky() -> None:
    wall = arrays_of(box((3.5, 0.0, 5.0), (1.0, 100.0, 10.0)))
    depth = cast_depth(wall, level((0.0, 0.0, 1.0)), (5, 5), max_depth_m=2.0)
    assert np.isinf(depth[:4]).all()
    np.testing.assert_allclose(depth[4], 1.25)


def test_primitive_across_the_plane_of_the_camera() -> None:
    # A wall beside the camera, from 5 m behind to 5 m ahead, its face at y = 1: column 0 (y = 0.8 t) meets it at 1.25.
    depth = cast_depth(arrays_of(box((0.0, 1.5, 1.0), (10.0, 1.0, 2.0))), level((0.0, 0.0, 1.0)), (5, 5))
    np.testing.assert_allclose(depth[2, :2], [1.25, 2.5], rtol=1e-6)
    assert np.isinf(depth[2, 2:]).all()
    above = Camera(5, 5, math.radians(90.0), (0.0, 0.0, 3.0), 0.0, math.radians(90.0))
    depth = cast_depth(arrays_of(cylinder((0.0, 0.0, 0.5), 1.0, 1.0)), above, (5, 5))
    assert depth[2, 2] == pytest.approx(2.0)  # its cap, straight below


def test_primitive_behind_or_around_the_camera_is_not_seen() -> None:
    behind = box((-3.0, 0.0, 1.0), (1.0, 50.0, 2.0))
    around = cylinder((0.0, 0.0, 1.0), 1.0, 2.0)
    depth = cast_depth(arrays_of(behind, around), level((0.0, 0.0, 1.0)), (5, 5))
    np.testing.assert_array_equal(depth, cast_depth(arrays_of(), level((0.0, 0.0, 1.0)), (5, 5)))


def test_scan_by_hand() -> None:
    arrays = arrays_of(
        box((3.5, 0.0, 0.5), (1.0, 2.0, 1.0)),  # near face at x = 3
        cylinder((0.0, 4.0, 0.5), 2.0, 1.0),  # nearest point at y = 3
        box((-2.0, 0.0, 0.05), (1.0, 1.0, 0.1)),  # under the scan
        box((0.0, -9.0, 0.5), (4.0, 2.0, 1.0)),  # beyond the range
    )
    angles = np.radians([0.0, 90.0, 180.0, 270.0]) - 0.5
    ranges = cast_scan(arrays, Pose2(0.0, 0.0, 0.5), height_m=0.2155, angles_rad=angles, max_range_m=7.0)
    assert ranges.dtype == np.float32
    np.testing.assert_allclose(ranges, [3.0, 3.0, np.inf, np.inf], rtol=1e-6)


def test_visible_by_hand() -> None:
    wall = box((3.0, 0.0, 0.5), (0.2, 2.0, 1.0))
    points = np.array(
        [
            [2.0, 0.0, 0.5],  # before the wall
            [5.0, 0.0, 0.5],  # behind it
            [5.0, 0.0, 1.5],  # over it
            [2.9, 0.0, 0.5],  # on its face
            [3.0, 0.0, 1.0],  # on its top
            [-2.0, 0.0, 1.0],  # behind the camera
            [2.0, 3.0, 1.0],  # beside the picture
            [2.0, 0.0, -0.2],  # under the floor
        ]
    )
    seen = visible(arrays_of(wall), level((0.0, 0.0, 1.5)), points)
    np.testing.assert_array_equal(seen, [True, False, True, True, True, False, False, False])


@pytest.mark.parametrize("seed", range(8))
def test_visible_agrees_with_depth(seed: int) -> None:
    # From anywhere, so that things stand across the camera's plane and even around it.
    rng = np.random.default_rng(seed)
    arrays = primitive_arrays(random_primitives(5))
    x, y, z = rng.uniform([0.3, 0.3, 0.1], [7.7, 7.7, 2.0])
    camera = Camera(64, 48, 2.0, (x, y, z), rng.uniform(-3.0, 3.0), rng.uniform(-0.5, 1.5), rng.uniform(-0.5, 0.5))
    depth = cast_depth(arrays, camera, (48, 64)).reshape(-1, 1).astype(np.float64)
    origin = np.array(camera.position_m)
    rays = ray_ends(camera, (48, 64), 1.0) - origin
    depth = np.where(np.isinf(depth), 50.0, depth)
    assert visible(arrays, camera, origin + 0.999 * depth * rays).all()
    hit = depth[:, 0] < 50.0
    assert not visible(arrays, camera, (origin + 1.001 * depth * rays)[hit]).any()


# The robot in the picture.


@pytest.mark.parametrize("seed", range(6))
def test_overlay_equals_casting_the_world_with_the_robot(seed: int) -> None:
    rng = np.random.default_rng(seed)
    primitives, camera = random_primitives(seed), random_camera(rng)
    background = cast_depth(primitive_arrays(primitives), camera, (96, 128))
    before = background.copy()
    changed = 0
    for _ in range(20):
        x, y = rng.uniform(0.3, 7.7, 2)
        robot = robot_primitive(Pose2(x, y, rng.uniform(-3.0, 3.0)), RobotSpec())
        drawn = overlay_depth(background, camera, robot)
        full = cast_depth(primitive_arrays((*primitives, robot)), camera, (96, 128))
        np.testing.assert_array_equal(drawn, full)
        changed += int((drawn != background).sum())
    np.testing.assert_array_equal(background, before)
    assert changed > 0


def test_robot_stands_on_the_floor() -> None:
    robot = robot_primitive(Pose2(1.0, 2.0, 0.5), RobotSpec())
    assert robot.centre_m == (1.0, 2.0, 0.07)
    assert robot.size_m == (0.43, 0.36, 0.14)
    assert robot.yaw_rad == 0.5


def test_ego_camera_looks_ahead_of_the_robot() -> None:
    spec = ObservationSpec(5, 0.5, (96, 128), (96, 128), 64, 0.3, True, 32, math.radians(90.0), 0.3, 5.0, 5, 0.4)
    camera = ego_camera(Pose2(1.0, 2.0, math.pi / 2.0), spec)
    assert (camera.width_px, camera.height_px, camera.pitch_rad) == (32, 32, 0.0)
    wall = box((1.0, 4.5, 1.0), (50.0, 1.0, 2.0))  # its face is 2 m ahead, to the left in the world
    depth = cast_depth(arrays_of(wall), camera, (32, 32))
    np.testing.assert_allclose(depth[15], np.full(32, 2.0), rtol=1e-6)
    pixel, _ = camera.project(np.array([1.0, 4.0, 0.3]))
    np.testing.assert_allclose(pixel, [15.5, 15.5], atol=1e-9)


def test_squeezed_grid_samples_the_full_picture() -> None:
    # Every third row and fifth column of an odd split has its middle on the middle of a full-resolution cell.
    arrays = primitive_arrays(random_primitives(2))
    camera = random_camera(np.random.default_rng(3), width=160, height=90)
    full = cast_depth(arrays, camera, (90, 160))
    squeezed = cast_depth(arrays, camera, (30, 32))
    np.testing.assert_allclose(squeezed, full[1::3, 2::5], rtol=1e-6)


# PyBullet.


def build(client: int, primitives: tuple[Primitive, ...]) -> None:
    p.createMultiBody(0.0, p.createCollisionShape(p.GEOM_PLANE, physicsClientId=client), physicsClientId=client)
    for item in primitives:
        half = [extent / 2.0 for extent in item.size_m]
        if item.shape == Shape.BOX:
            solid = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
            look = p.createVisualShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
        else:
            height = item.size_m[2]
            solid = p.createCollisionShape(p.GEOM_CYLINDER, radius=half[0], height=height, physicsClientId=client)
            look = p.createVisualShape(p.GEOM_CYLINDER, radius=half[0], length=height, physicsClientId=client)
        turn = p.getQuaternionFromEuler([0.0, 0.0, item.yaw_rad])
        p.createMultiBody(0.0, solid, look, item.centre_m, turn, physicsClientId=client)


@pytest.fixture
def bullet() -> Iterator[int]:
    client = p.connect(p.DIRECT)
    yield client
    p.disconnect(client)


def bullet_fractions(client: int, starts: FloatArray, ends: FloatArray) -> FloatArray:
    hits = p.rayTestBatch(starts.tolist(), ends.tolist(), physicsClientId=client)
    return np.array([hit[2] if hit[0] >= 0 else np.inf for hit in hits])


@pytest.mark.parametrize("seed", range(4))
def test_depth_agrees_with_pybullet_rays(bullet: int, seed: int) -> None:
    primitives = random_primitives(seed)
    build(bullet, primitives)
    camera = random_camera(np.random.default_rng(100 + seed))
    depth = cast_depth(primitive_arrays(primitives), camera, (48, 64)).ravel()
    ends = ray_ends(camera, (48, 64), 30.0)
    starts = np.broadcast_to(np.array(camera.position_m), ends.shape)
    expected = 30.0 * bullet_fractions(bullet, starts, ends)
    differs = ~np.isclose(depth, expected, rtol=2e-3, atol=2e-3)
    differs &= ~((depth > 29.9) & np.isinf(expected))
    assert differs.mean() < 0.003  # Bullet rounds silhouettes by its collision margin


@pytest.mark.parametrize("seed", range(4))
def test_scan_agrees_with_pybullet_rays(bullet: int, seed: int) -> None:
    primitives = random_primitives(seed)
    build(bullet, primitives)
    pose = Pose2(1.0, 1.0, 0.7 * seed)
    angles = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    ranges = cast_scan(primitive_arrays(primitives), pose, height_m=0.2155, angles_rad=angles, max_range_m=12.0)
    starts = np.broadcast_to(np.array([1.0, 1.0, 0.2155]), (720, 3))
    away = angles + pose.yaw_rad
    ends = starts + 12.0 * np.column_stack([np.cos(away), np.sin(away), np.zeros(720)])
    expected = 12.0 * bullet_fractions(bullet, starts, ends)
    assert (~np.isclose(ranges, expected, rtol=1e-3, atol=2e-3)).mean() < 0.005
    assert np.isfinite(ranges).all()  # the room is closed


@pytest.mark.parametrize("seed", range(2))
def test_depth_agrees_with_pybullet_renderer(bullet: int, seed: int) -> None:
    primitives = random_primitives(seed)
    build(bullet, primitives)
    camera = random_camera(np.random.default_rng(200 + seed), width=160, height=120)
    rotation, eye = camera.world_from_camera(), np.array(camera.position_m)
    near, far = 0.05, 40.0
    looking = p.computeViewMatrix(eye.tolist(), (eye + rotation[:, 2]).tolist(), (-rotation[:, 1]).tolist())
    # TinyRenderer samples its cells half a pixel to the left and below of their middles: move its frustum back.
    pixel = near / camera.focal_px
    sides = ((-79.5) * pixel, 80.5 * pixel, (-59.5) * pixel, 60.5 * pixel)
    lens = p.computeProjectionMatrix(*sides, near, far)
    buffer = p.getCameraImage(160, 120, looking, lens, renderer=p.ER_TINY_RENDERER, physicsClientId=bullet)[3]
    expected = far * near / (far - (far - near) * np.asarray(buffer, dtype=np.float64).reshape(120, 160))
    depth = cast_depth(primitive_arrays(primitives), camera, (120, 160))
    thing = np.isfinite(depth) & (expected < 0.99 * far)
    error = np.abs(depth[thing] / expected[thing] - 1.0)
    assert thing.mean() > 0.5
    assert np.median(error) < 1e-4
    assert (error > 0.01).mean() < 0.01  # silhouettes, and cylinders that the renderer makes of flat faces
