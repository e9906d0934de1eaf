"""On floors that are wholly known, the planner's ways are those of the simulator's expert."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from revnm_client.geometry import FloatArray
from revnm_server.planning.map_planner import MapPlanner, PlannerSettings
from revnm_server.planning.way import length_m
from revnm_sim.expert.planner import Expert, travel_cost
from revnm_sim.occupancy import occupancy
from revnm_sim.scenario import sample_pair
from revnm_sim.worlds import named_site

from .floor_scenes import with_obstacles

WORLDS = ("random_pillar", "rooms", "aisles")
SEEDS = range(5000, 5006)


class Pair(NamedTuple):
    length: float  # all: the planner's by the expert's
    cost: float
    clearance_m: float  # the planner's, less the expert's


def expert_cost(expert: Expert, way_m: FloatArray) -> float:
    middles = 0.5 * (way_m[1:] + way_m[:-1])
    return float(travel_cost(expert.grid.clearance_m(middles)) @ np.hypot(*np.diff(way_m, axis=0).T))


def compare(world_name: str, seed: int, cell_m: float) -> Pair:
    world = named_site(world_name, seed).world
    expert = Expert(world)
    pair = sample_pair(world, expert, np.random.default_rng(seed), detour_m=0.3)
    assert pair is not None
    truth = occupancy(world, resolution_m=cell_m)
    grid = with_obstacles(np.where(truth.occupied, 0.99, 0.01), cell_m=cell_m, corner_m=truth.origin_m)
    goal = np.array(pair.goal_m)
    ours = MapPlanner(PlannerSettings()).plan(grid, pair.start, goal, goal_id="a", stamp_ns=0)
    assert ours.reason == ""
    assert ours.way_m is not None
    theirs = expert.field(goal).path(pair.start[:2])
    clearance = [float(expert.grid.clearance_m(way).min()) for way in (ours.way_m, theirs)]
    lengths, costs = [
        [measure(way) for way in (ours.way_m, theirs)] for measure in (length_m, lambda way: expert_cost(expert, way))
    ]
    return Pair(lengths[0] / lengths[1], costs[0] / costs[1], clearance[0] - clearance[1])


@pytest.mark.parametrize("world", WORLDS)
def test_on_cells_of_the_experts_size_the_ways_are_the_experts(world: str) -> None:
    for seed in SEEDS[:3]:
        ours = compare(world, seed, 0.05)
        assert 0.95 < ours.length < 1.01, seed
        assert ours.cost < 1.02, seed
        assert ours.clearance_m > -0.06, seed


@pytest.mark.parametrize("world", WORLDS)
def test_on_coarser_cells_they_are_hardly_worse(world: str) -> None:
    pairs = [compare(world, seed, 0.1) for seed in SEEDS]
    lengths, costs, clearances = (np.array(column) for column in zip(*pairs, strict=True))
    assert np.abs(lengths - 1.0).max() < 0.05
    assert np.median(costs) < 1.06
    assert costs.max() < 1.15
    assert np.median(clearances) > -0.05
    assert clearances.min() > -0.15
