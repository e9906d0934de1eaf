from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from revnm_client.errors import ConfigError
from revnm_sim.expert.planner import Expert
from revnm_sim.generation.aisles import aisles
from revnm_sim.generation.generator import TRAINING_SEED_BASE, demo_room, is_training_seed, random_pillar
from revnm_sim.generation.placement import sample_camera
from revnm_sim.generation.rooms import rooms
from revnm_sim.scenario import sample_pair
from revnm_sim.world import Shape, World

FAMILIES = [random_pillar, demo_room, aisles, rooms]


@pytest.mark.parametrize("make", FAMILIES)
def test_one_seed_makes_one_world(make: Callable[[int], World]) -> None:
    assert make(7) == make(7)
    assert make(7).primitives != make(8).primitives


def test_training_and_evaluation_seeds_are_two_sides_of_the_base() -> None:
    assert is_training_seed(TRAINING_SEED_BASE)
    assert not is_training_seed(TRAINING_SEED_BASE - 1)
    assert random_pillar(TRAINING_SEED_BASE).primitives != random_pillar(0).primitives
    assert aisles(TRAINING_SEED_BASE).name == "aisles-training-1000000000"
    assert rooms(TRAINING_SEED_BASE - 1).name == "rooms-evaluation-999999999"


@pytest.mark.parametrize("make", FAMILIES)
def test_negative_seed_is_refused(make) -> None:
    with pytest.raises(ConfigError, match="-1 is negative"):
        make(-1)


@pytest.mark.parametrize("seed", range(8))
def test_room_has_the_promised_sizes(seed: int) -> None:
    world = random_pillar(seed)
    bounds = world.bounds
    assert bounds.x_min_m == -bounds.x_max_m
    assert bounds.y_min_m == -bounds.y_max_m
    assert 8.0 <= 2 * bounds.x_max_m <= 12.0
    assert 8.0 <= 2 * bounds.y_max_m <= 12.0
    for wall in world.primitives[:4]:
        assert 2.5 <= wall.size_m[2] <= 4.0
        assert 0.1 <= min(wall.size_m[:2]) <= 0.2
        gap_x = abs(wall.centre_m[0]) - wall.size_m[0] / 2 - bounds.x_max_m
        gap_y = abs(wall.centre_m[1]) - wall.size_m[1] / 2 - bounds.y_max_m
        assert max(gap_x, gap_y) == pytest.approx(0.0, abs=1e-9)
    for primitive in world.primitives:
        assert primitive.centre_m[2] == pytest.approx(primitive.size_m[2] / 2)
        assert all(0 <= channel <= 255 for channel in primitive.colour)
    for primitive in world.primitives[4:]:
        assert 0.3 <= primitive.size_m[2] <= 2.0


@pytest.mark.parametrize("seed", range(8))
def test_nearly_all_floor_is_one_region(seed: int) -> None:
    assert reachable_share(random_pillar(seed)) > 0.97


@pytest.mark.parametrize("seed", range(8))
def test_demo_room_is_small_and_low(seed: int) -> None:
    world = demo_room(seed)
    assert 5.5 < world.bounds.x_max_m - world.bounds.x_min_m < 6.5
    assert 4.5 < world.bounds.y_max_m - world.bounds.y_min_m < 5.5
    assert 4 <= len(world.primitives) - 4 <= 8
    assert max(primitive.size_m[2] for primitive in world.primitives[4:]) < 1.0


def reachable_share(world: World) -> float:
    """Return how much of the floor where the robot may stand is one region: from a place in the middle of the list."""
    expert = Expert(world)
    roomy = np.argwhere(expert.grid.distance_m > 0.35)[::37, ::-1]
    points = (roomy + 0.5) * expert.grid.resolution_m + np.array(expert.grid.origin_m)
    return float(expert.field(points[len(points) // 2]).reachable(points).mean())


@pytest.mark.parametrize("make", [aisles, rooms])
@pytest.mark.parametrize("seed", range(12))
def test_every_aisle_and_every_room_can_be_reached(make: Callable[[int], World], seed: int) -> None:
    assert reachable_share(make(seed)) > 0.99


@pytest.mark.parametrize("seed", range(8))
def test_aisles_are_rows_of_tall_shelves(seed: int) -> None:
    world = aisles(seed)
    x, y = world.bounds.x_max_m, world.bounds.y_max_m
    assert 9.0 <= 2 * x <= 14.0
    assert 9.0 <= 2 * y <= 14.0
    shelves = [p for p in world.primitives[4:] if p.shape is Shape.BOX and p.size_m[2] >= 1.2]
    assert len(shelves) >= 8
    for shelf in shelves:
        assert shelf.size_m[2] <= 2.2
        assert shelf.bottom_m == pytest.approx(0.0)


def test_some_aisles_are_closed_at_one_end() -> None:
    # A cap is 0.4 m long along the rows and fills the aisle between two of them: 1.2 to 2.2 m.
    capped = 0
    for seed in range(20):
        world = aisles(seed)
        capped += any(abs(p.size_m[0] - 0.4) < 1e-9 and 1.2 <= p.size_m[1] <= 2.2 for p in world.primitives[4:])
    assert 4 <= capped <= 18


def test_rooms_have_doors_and_slits() -> None:
    doors = slits = 0
    for seed in range(20):
        world = rooms(seed)
        thin = [p for p in world.primitives[4:] if min(p.size_m[:2]) <= 0.2]
        for wall in {(p.yaw_rad, p.size_m[1], p.size_m[2]) for p in thin}:
            # Pieces of one wall share thickness, height and turn; gaps between them are its openings.
            pieces = [p for p in thin if (p.yaw_rad, p.size_m[1], p.size_m[2]) == wall]
            along = int(wall[0] > 0.1)
            spans = sorted((p.centre_m[along] - p.size_m[0] / 2, p.centre_m[along] + p.size_m[0] / 2) for p in pieces)
            gaps = [after[0] - before[1] for before, after in pairwise(spans)]
            assert sum(0.9 <= gap <= 1.2 for gap in gaps) in (1, 2)
            assert all(0.9 <= gap <= 1.2 or 0.15 <= gap <= 0.3 for gap in gaps)
            assert 0.5 <= wall[2] <= 1.6
            doors += sum(gap > 0.5 for gap in gaps)
            slits += sum(gap < 0.5 for gap in gaps)
    assert doors >= 40
    assert slits >= 30


@pytest.mark.parametrize("make", [aisles, rooms])
def test_trials_are_found_in_nearly_every_world(make: Callable[[int], World]) -> None:
    found = 0
    for seed in range(20):
        world, rng = make(seed), np.random.default_rng(seed)
        camera = sample_camera(world, rng, width_px=640, height_px=480, hfov_rad=math.radians(120.0))
        found += sample_pair(world, Expert(world), rng, detour_m=0.5, cameras=[camera]) is not None
    assert found >= 18
