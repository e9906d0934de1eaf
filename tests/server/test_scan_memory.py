"""The LiDAR's layer: hits and free beams by hand, and what they tell the camera's map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_client.messages import Scan
from revnm_server.mapping.floor_grid import FloorGrid
from revnm_server.mapping.floor_map import MapSpec
from revnm_server.mapping.scan_memory import ScanMemory
from revnm_sim.rays.raycast import cast_scan
from revnm_sim.world import primitive_arrays

from .floor_scene import box, wall

GRID = MapSpec()
POSE = Pose2(4.05, 0.05, math.pi / 2.0)
ANGLES = np.linspace(-math.pi, math.pi, 360, endpoint=False)


def scan_of(*things, pose: Pose2 = POSE, every: int = 1) -> Scan:
    angles = ANGLES[::every]
    ranges = cast_scan(primitive_arrays(things), pose, height_m=0.2155, angles_rad=angles, max_range_m=12.0)
    return Scan(0, -math.pi, math.tau / len(angles), 0.05, 12.0, ranges)


def camera(obstacle: float = 0.5, age_s: float = math.inf) -> FloorGrid:
    layer = np.full(GRID.shape, obstacle, dtype=np.float32)
    seen = np.full(GRID.shape, math.isfinite(age_s))
    return FloorGrid(GRID.origin_m, GRID.cell_m, layer, seen, np.full(GRID.shape, age_s, dtype=np.float32))


def at(layer: np.ndarray, x: float, y: float) -> float:
    row, column = np.rint(camera().cells(np.array([x, y]))).astype(int)
    return float(layer[row, column])


def remembered(*scans: Scan, pose: Pose2 = POSE, interval_s: float = 0.1) -> ScanMemory:
    memory = ScanMemory(GRID)
    for i, scan in enumerate(scans):
        memory.update(scan, pose, interval_s * i)
    return memory


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_box_is_hit_where_it_stands_and_the_way_to_it_is_free(every):
    # Near face of the box at x = 6.02, that of the wall at 9.03. The robot looks along y.
    scan = scan_of(box(6.27, 0.0), wall(9.03), every=every)
    memory = remembered(scan, scan, scan)
    assert at(memory.probability, 6.05, 0.05) > 0.9
    assert all(at(memory.probability, x, 0.05) < 0.25 for x in np.arange(4.25, 5.85, 0.1))
    assert at(memory.probability, 6.75, 0.05) == 0.5  # in its shadow
    fused = memory.fuse(camera(), 0.2)
    assert at(fused.floor, 5.05, 0.05)
    assert at(fused.age_s, 5.05, 0.05) == 0.0
    assert math.isinf(at(fused.age_s, 6.75, 0.05))


def test_hits_overrule_a_camera_that_sees_floor():
    scan = scan_of(box(6.27, 0.0))
    memory = remembered(*[scan] * 4)
    assert at(memory.fuse(camera(0.02, 0.0), 0.3).obstacle, 6.05, 0.05) > 0.9


def test_free_beams_correct_an_unsure_camera_and_leave_a_sure_one():
    memory = remembered(*[scan_of(wall(9.0))] * 10)
    assert at(memory.fuse(camera(0.85, 0.0), 0.9).obstacle, 5.05, 0.05) < 0.4
    assert at(memory.fuse(camera(0.98, 0.0), 0.9).obstacle, 5.05, 0.05) > 0.5  # it may be lower than the beams


def test_what_moved_away_is_cleared_within_a_second_of_scans():
    memory = remembered(*[scan_of(box(6.27, 0.0), wall(9.0))] * 20)
    for i in range(10):
        memory.update(scan_of(wall(9.0)), POSE, 2.0 + 0.1 * i)
    assert at(memory.probability, 6.05, 0.05) < 0.5


def test_hits_out_of_sight_fade_over_minutes_and_free_floor_sooner():
    memory = remembered(*[scan_of(box(6.27, 0.0), wall(9.0))] * 10)
    away = Pose2(4.05, -8.0, 0.0)
    nothing = Scan(0, -math.pi, math.tau / 360, 0.05, 12.0, np.zeros(360, dtype=np.float32))
    memory.update(nothing, away, 60.0)
    assert at(memory.probability, 6.05, 0.05) > 0.85
    assert 0.4 < at(memory.probability, 5.05, 0.05) < 0.5
    memory.update(nothing, away, 900.0)
    assert at(memory.probability, 6.05, 0.05) < 0.6


def test_a_wall_along_the_beams_survives_being_grazed():
    # The robot drives along the wall, 0.4 m beside it.
    memory = ScanMemory(GRID)
    for i in range(30):
        pose = Pose2(8.63, -1.5 + 0.1 * i, math.pi / 2.0)
        memory.update(scan_of(wall(9.03), pose=pose), pose, 0.2 * i)
    assert all(at(memory.probability, 9.05, y) > 0.7 for y in np.arange(-2.0, 2.0, 0.1))


def test_beams_without_return_clear_and_beams_without_meaning_do_not():
    for value, expected in ((math.inf, 0.4), (math.nan, 0.5), (0.0, 0.5)):
        scan = Scan(0, -math.pi, math.tau / 360, 0.05, 12.0, np.full(360, value, dtype=np.float32))
        got = at(remembered(scan).probability, 6.05, 0.05)
        assert got == pytest.approx(expected, abs=0.03)


def test_half_a_turn_and_clockwise_beams_are_placed_right():
    angles = np.linspace(math.pi / 2.0, -math.pi / 2.0, 181)
    pose = Pose2(4.05, 0.05, 0.0)
    things = primitive_arrays((box(6.27, 1.0), wall(9.0)))
    ranges = cast_scan(things, pose, height_m=0.2155, angles_rad=angles, max_range_m=12.0)
    scan = Scan(0, math.pi / 2.0, -math.pi / 180.0, 0.05, 12.0, ranges)
    memory = remembered(scan, scan, pose=pose)
    assert at(memory.probability, 6.05, 1.05) > 0.8
    assert at(memory.probability, 6.05, -0.95) < 0.4
    assert at(memory.probability, 3.05, 0.05) == 0.5  # behind


def test_a_robot_off_the_map_changes_nothing_on_it():
    memory = remembered(scan_of(wall(9.0)), pose=Pose2(-40.0, 0.0, 0.0))
    assert (memory.probability == 0.5).all()


def test_beams_start_where_the_lidar_sits():
    lidar = Pose2(0.3, 0.1, math.pi)  # it looks backwards
    scan = replace(scan_of(box(6.27, 0.0), wall(9.03), pose=POSE @ lidar), robot_from_lidar=lidar)
    memory = remembered(scan, scan, scan)
    assert at(memory.probability, 6.05, 0.05) > 0.9
    assert all(at(memory.probability, x, 0.35) < 0.25 for x in np.arange(4.25, 5.85, 0.1))
