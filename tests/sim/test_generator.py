from __future__ import annotations

import numpy as np
import pytest

from revnm_client.errors import ConfigError
from revnm_sim.expert import Expert
from revnm_sim.generator import TRAINING_SEED_BASE, demo_room, is_training_seed, random_pillar


def test_one_seed_makes_one_world() -> None:
    assert random_pillar(7) == random_pillar(7)
    assert demo_room(7) == demo_room(7)
    assert random_pillar(7).primitives != random_pillar(8).primitives


def test_training_and_evaluation_seeds_are_two_sides_of_the_base() -> None:
    assert is_training_seed(TRAINING_SEED_BASE)
    assert not is_training_seed(TRAINING_SEED_BASE - 1)
    assert random_pillar(TRAINING_SEED_BASE).primitives != random_pillar(0).primitives


@pytest.mark.parametrize("make", [random_pillar, demo_room])
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
    expert = Expert(random_pillar(seed))
    roomy = np.argwhere(expert.grid.distance_m > 0.35)[::37, ::-1]
    points = (roomy + 0.5) * expert.grid.resolution_m + np.array(expert.grid.origin_m)
    assert expert.field(points[0]).reachable(points).mean() > 0.97


@pytest.mark.parametrize("seed", range(8))
def test_demo_room_is_small_and_low(seed: int) -> None:
    world = demo_room(seed)
    assert 5.5 < world.bounds.x_max_m - world.bounds.x_min_m < 6.5
    assert 4.5 < world.bounds.y_max_m - world.bounds.y_min_m < 5.5
    assert 4 <= len(world.primitives) - 4 <= 8
    assert max(primitive.size_m[2] for primitive in world.primitives[4:]) < 1.0
