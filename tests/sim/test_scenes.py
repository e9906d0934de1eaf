"""The scenes that come with the simulator: they load, are passable, and stay cheap to cast."""

from __future__ import annotations

import math

import numpy as np
import pytest

from revnm_sim.expert.planner import Expert
from revnm_sim.generation.placement import sample_camera
from revnm_sim.rays.raycast import visible
from revnm_sim.scenario import sample_pair
from revnm_sim.site import Site
from revnm_sim.world import primitive_arrays
from revnm_sim.worlds import named_site


@pytest.fixture(scope="module", params=["bookstore", "warehouse"])
def site(request: pytest.FixtureRequest) -> Site:
    return named_site(request.param, 0)


def test_a_scene_is_small_and_colourful(site: Site) -> None:
    world = site.world
    assert site.goal_radius_m == {"bookstore": 0.5, "warehouse": 1.0}[world.name]
    assert (site.cameras, site.pairs) == ((), ())
    assert 100 < len(world.primitives) < 350
    assert len({primitive.colour for primitive in world.primitives}) > 25
    assert len(world.obstacles) < len(world.primitives)  # mats and painted lines
    assert all(primitive.bottom_m > -1e-9 for primitive in world.primitives)


def test_nearly_all_floor_is_one_region(site: Site) -> None:
    expert = Expert(site.world)
    roomy = np.argwhere(expert.grid.distance_m > 0.35)[::53, ::-1]
    points = (roomy + 0.5) * expert.grid.resolution_m + np.array(expert.grid.origin_m)
    goal = {"bookstore": (-3.0, 6.0), "warehouse": (0.0, 0.0)}[site.world.name]
    # Only the floor behind the information desk is cut off.
    assert expert.field(goal).reachable(points).mean() > 0.97


def test_a_camera_and_a_pair_are_found(site: Site) -> None:
    rng = np.random.default_rng(1)
    camera = sample_camera(site.world, rng, width_px=640, height_px=480, hfov_rad=math.radians(120.0))
    pair = sample_pair(site.world, Expert(site.world), rng, detour_m=1.0, cameras=[camera])
    assert pair is not None
    goal = np.array([[*pair[1], 0.0]])
    assert visible(primitive_arrays(site.world.obstacles), camera, goal).all()


def test_the_missing_corner_of_the_bookstore_is_closed() -> None:
    site = named_site("bookstore", 0)
    expert = Expert(site.world)
    xs, ys = np.meshgrid(np.arange(2.5, 7.7, 0.1), np.arange(2.3, 7.2, 0.1))
    assert (expert.grid.clearance_m(np.stack([xs, ys], axis=-1)) == 0.0).all()
