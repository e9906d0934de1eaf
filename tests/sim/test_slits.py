"""Halls cut by walls: every part can be reached, and there are gaps that only rays pass."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import label

from revnm_sim.expert.planner import INSCRIBED_M
from revnm_sim.generation.rooms import wall_with_openings
from revnm_sim.generation.slits import slits
from revnm_sim.occupancy import occupancy


@pytest.mark.parametrize("seed", range(20))
def test_every_part_that_the_robot_fits_into_can_be_reached(seed):
    grid = occupancy(slits(seed))
    parts, _ = label(grid.distance_m > INSCRIBED_M, structure=np.ones((3, 3)))
    sizes = np.bincount(parts.ravel())[1:]
    assert sizes.max() > 0.995 * sizes.sum()


@pytest.mark.parametrize("seed", range(10))
def test_a_wall_has_the_doors_asked_for_and_slits_that_the_robot_does_not_fit_through(seed):
    rng = np.random.default_rng(seed)
    pieces, middles = wall_with_openings(rng, 9.0, doors=2, slits=5, door_m=(0.8, 1.2))
    ends = sorted((piece.x_m - piece.length_m / 2.0, piece.x_m + piece.length_m / 2.0) for piece in pieces)
    gaps = [(before[1], after[0]) for before, after in pairwise(ends)]
    doors = [(low + high) / 2.0 for low, high in gaps if high - low > 0.5]
    assert ends[0][0] == pytest.approx(0.0)
    assert ends[-1][1] == pytest.approx(9.0)
    np.testing.assert_allclose(doors, sorted(middles))
    assert len(doors) == 2
    assert all(0.14 < high - low < 0.31 or 0.79 < high - low < 1.21 for low, high in gaps)


def test_a_seed_gives_the_same_hall():
    assert slits(3) == slits(3)
    assert slits(3) != slits(4)
