"""Which trials a benchmark has: the rules of the pairs and cameras, repeatable, apart from training."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ConfigError, ContractError
from revnm_sim.bench.protocol import (
    PROTOCOLS,
    Protocol,
    Setting,
    draw_setting,
    fit_protocol,
    parse_protocol,
    trial_seed,
)
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.rays.raycast import visible
from revnm_sim.robot import RobotSpec
from revnm_sim.world import primitive_arrays
from revnm_sim.worlds import named_site

ROOM = """
format: 1
name: two-halls
goal_radius_m: 0.7
bounds: {x_min_m: -4.0, y_min_m: -4.0, x_max_m: 4.0, y_max_m: 4.0}
floor: {colour: [190, 185, 175]}
prefabs:
  wall:
    - {shape: box, centre_m: [0.0, 0.0, 0.4], size_m: [0.2, %s, 0.8], colour: [90, 90, 90]}
placements:
  - {prefab: wall, x_m: 0.0, y_m: 0.0}
"""


def draw(world: str, pair: int, *, seed: int = 5, cameras: int = 2, rule: str = "blocked") -> Setting:
    return draw_setting(world, seed=seed, pair=pair, cameras=cameras, rule=rule)


def write(tmp_path: Path, text: str) -> str:
    path = tmp_path / "halls.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("world", ["random_pillar", "bookstore", "warehouse", "aisles", "rooms"])
def test_drawn_pairs_keep_the_rules(world: str) -> None:
    for number in range(2):
        setting = draw(world, number)
        start, goal = np.array(setting.pair.start[:2]), np.array(setting.pair.goal_m)
        straight_m = math.dist(start, goal)
        assert 5.0 <= straight_m <= 10.0
        assert setting.route.blocked
        assert setting.route.geodesic_m >= straight_m + setting.site.detour_m
        assert setting.route.geodesic_m <= setting.route.expert_m + 0.05
        assert setting.route.field.grid.clearance_m(np.stack([start, goal])).min() >= 0.35
        arrays = primitive_arrays(setting.site.world.primitives)
        assert len(setting.cameras) == 2
        for camera in setting.cameras:
            assert (camera.width_px, camera.height_px) == (640, 480)
            assert math.degrees(camera.hfov_rad) == pytest.approx(120.0)
            assert 2.0 <= camera.position_m[2] <= 3.5
            assert visible(arrays, camera, np.array([[*goal, 0.0], [*start, RobotSpec().top_m]])).all()


def test_generated_worlds_are_never_training_worlds_and_never_twice_the_same() -> None:
    names = {draw("random_pillar", pair, seed=seed).site.world.name for seed in (5, 6) for pair in (0, 1)}
    assert len(names) == 4
    assert all(int(name.rsplit("-", 1)[1]) < TRAINING_SEED_BASE for name in names)


def test_a_setting_is_the_same_every_time() -> None:
    first = draw("random_pillar", 3)
    draw_setting.cache_clear()
    again = draw("random_pillar", 3)
    assert (first.site, first.pair, first.cameras) == (again.site, again.pair, again.cameras)
    assert first.cameras[0] != first.cameras[1]


def test_pairs_as_they_come_include_free_ways(tmp_path: Path) -> None:
    path = write(tmp_path, ROOM % 3.0)
    blocked = [draw(path, pair, rule="any", cameras=1).route.blocked for pair in range(12)]
    assert 0 < sum(blocked) < 12


def test_trials_differ_in_noise_by_pair_camera_and_repeat() -> None:
    seeds = {trial_seed(1, pair=p, camera=c, repeat=r) for p in range(3) for c in range(3) for r in range(3)}
    assert len(seeds) == 27
    assert trial_seed(1, pair=0, camera=0, repeat=0) == trial_seed(1, pair=0, camera=0, repeat=0)


def test_protocols_by_name_and_by_numbers() -> None:
    assert parse_protocol("default") == Protocol(50, 5, 1)
    assert parse_protocol("paper") == Protocol(10, 5, 5)
    assert parse_protocol("20x2x3") == Protocol(20, 2, 3)
    for wrong in ("", "20", "0x1x1", "20x2", "20x2x3x4", "-1x2x3", "axbxc"):
        with pytest.raises(ConfigError, match="expected one of default, paper, or PAIRSxCAMERASxREPEATS"):
            parse_protocol(wrong)


def test_a_site_keeps_its_own_pairs_and_cameras(tmp_path: Path) -> None:
    own = """
cameras:
  - {x_m: -3.5, y_m: 0.0, z_m: 3.0, yaw_deg: 0.0, pitch_deg: 30.0, hfov_deg: 100.0}
pairs:
  - {start: {x_m: -2.0, y_m: 0.5, yaw_deg: 90.0}, goal: {x_m: 2.0, y_m: 0.5}}
  - {start: {x_m: -2.0, y_m: 3.0, yaw_deg: 0.0}, goal: {x_m: 2.0, y_m: 3.0}}
"""
    path = write(tmp_path, ROOM % 4.0 + own)
    site = named_site(path, 0)
    assert fit_protocol(PROTOCOLS["paper"], site) == Protocol(pairs=2, cameras=1, repeats=5)
    first, second = (draw(path, pair, cameras=1) for pair in (0, 1))
    assert (first.route.blocked, second.route.blocked) == (True, False)
    assert first.cameras == site.cameras
    scenario = first.scenario(camera=0, seed=9)
    assert (scenario.goal_m, scenario.goal_radius_m, scenario.seed) == ((2.0, 0.5), 0.7, 9)


def test_a_world_without_a_pair_is_told_with_its_file_line_and_key(tmp_path: Path) -> None:
    path = write(tmp_path, ROOM % 8.0)  # the wall leaves no way, so the halls have no blocked pair that is reachable
    with pytest.raises(ContractError, match=r"halls\.yaml:5: bounds: no start and goal 5 to 10 m apart"):
        draw(path, 0)
