"""Samples of the map policy: exact errors give what one would measure in the world, labels are the expert's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.mapping.map_window import LAYERS, WindowSpec, window_points_m
from revnm_sim.expert.planner import Expert
from revnm_training.episodes import layout_of, write_episodes
from revnm_training.map_cache import UNREACHED, render_map_samples
from revnm_training.map_samples import MapEpisodeRenderer
from revnm_training.map_scene import MapFaults
from revnm_training.preset import load_preset
from revnm_training.samples import build_world
from revnm_training.synth import SynthConfig, make_episode

SPEC = load_preset("edge").observation
NONE = MapFaults(
    exact=1.0, network=0.0, focal=0.0, pitch_rad=0.0, roll_rad=0.0, height=0.0, place_m=0.0, heading_rad=0.0
)
POINTS_M = window_points_m(WindowSpec())


@pytest.fixture(scope="module")
def episode():
    config = SynthConfig(Path(), episodes=9, goals=2, states=6, seed=4, hidden=True, layout=layout_of(SPEC))
    made = make_episode(config, 2)
    assert made is not None
    return made


@pytest.fixture(scope="module")
def samples(episode):
    return MapEpisodeRenderer(episode, SPEC, NONE, np.random.default_rng(0)).samples()


def test_every_state_gives_a_sample_in_the_episodes_order(episode, samples):
    assert len(samples) == len(episode.goal)
    for state, sample in enumerate(samples):
        np.testing.assert_allclose(sample.waypoints, episode.waypoints_m[state])
        goal = Pose2(*episode.poses[state, -1]).inverse().apply(episode.goals_m[episode.goal[state]])
        np.testing.assert_allclose(sample.goal, goal, atol=1e-6)


def test_without_errors_the_map_agrees_with_what_truly_stands_there(samples):
    wrong = known = 0
    for sample in samples:
        obstacle, _, unseen, _ = sample.layers
        sure = (unseen < 0.5) & (np.abs(obstacle - 0.5) > 0.4) & (np.hypot(*POINTS_M.T) < 3.0).T
        wrong += int(((obstacle > 0.5) != sample.occupied)[sure].sum())
        known += int(sure.sum())
    assert known > 1000 * len(samples)
    assert wrong < 0.05 * known  # rims of obstacles, half a cell off


def test_costs_fall_along_the_experts_way_and_the_robot_has_none(episode, samples):
    world = build_world(episode.family, episode.world_seed)
    expert, middles = Expert(world), []
    for state, sample in enumerate(samples):
        middles.append(sample.cost[23:25, 23:25].mean())
        field = expert.field(episode.goals_m[episode.goal[state]])
        pose = Pose2(*episode.poses[state, -1])
        ahead = field.length_m(pose.apply(sample.waypoints[2])) if np.hypot(*sample.waypoints[2]) > 0.8 else None
        assert ahead is None or ahead < field.length_m(np.array(pose[:2]))
    assert np.abs(np.median(middles)) < 0.3


def test_the_planners_way_leads_to_the_goal_or_on_towards_it(samples):
    for sample in samples:
        steps = np.hypot(*np.diff(np.vstack([[0.0, 0.0], sample.way]), axis=0).T)
        assert (steps < 0.45).all()
        near = np.hypot(*sample.goal) < 2.0
        assert not near or np.hypot(*(sample.way[-1] - sample.goal)) < max(0.15, np.hypot(*sample.goal))


def test_scans_stay_in_the_map(samples):
    lidar = LAYERS.index("lidar")
    told = [int((np.abs(sample.layers[lidar] - 0.5) > 0.1).sum()) for sample in samples]
    assert min(told) > 300


def test_errors_move_the_map_and_not_the_labels(episode, samples):
    wrong = MapEpisodeRenderer(episode, SPEC, MapFaults(network=0.0, exact=0.0), np.random.default_rng(3)).samples()
    for one, other in zip(samples, wrong, strict=True):
        np.testing.assert_array_equal(one.occupied, other.occupied)
        np.testing.assert_allclose(one.waypoints, other.waypoints)
    assert np.mean([np.abs(a.layers - b.layers).mean() for a, b in zip(samples, wrong, strict=True)]) > 0.01


def test_the_cache_keeps_what_was_rendered(episode, tmp_path):
    data = tmp_path / "data"
    data.mkdir()
    write_episodes(data / "a.parquet", [episode, replace(episode)], layout_of(SPEC))
    first = render_map_samples(data, tmp_path / "a", SPEC, jobs=1, faults=NONE)
    again = render_map_samples(data, tmp_path / "b", SPEC, jobs=1, faults=NONE)
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, again.columns[name])
    cost = first.columns["cost"]
    assert (cost == UNREACHED).any()
    assert np.median(cost[:, 23, 23]) == pytest.approx(127, abs=10)
    bits = np.unpackbits(first.columns["occupied"], axis=1)
    assert 0.05 < bits.mean() < 0.95
    assert set(first.columns["episode"][first.train]).isdisjoint(first.columns["episode"][first.validation])
