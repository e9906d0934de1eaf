from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ConfigError, FileError
from revnm_client.geometry import Pose2
from revnm_server.frame import Frame
from revnm_server.observation import ImagePose, ObservationSpec, crop_around, exo_view, normalise_disparity
from revnm_server.robots.mission import Goal
from revnm_server.tick.pipeline import Pipeline
from revnm_sim.bench.methods.truth import TrueDisparity, TrueSightings
from revnm_sim.engine import Engine
from revnm_sim.rays.raycast import cast_depth, robot_primitive
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.world import primitive_arrays
from revnm_training.augment import Disturbance, draw_error
from revnm_training.cache import Column, cut_blocks, fill_cache
from revnm_training.episodes import layout_of
from revnm_training.pictures import render_pictures
from revnm_training.sample_cache import render_samples
from revnm_training.sample_set import sample_set
from revnm_training.samples import EpisodeRenderer, build_world
from revnm_training.synth import SynthConfig, make_episode, synthesise

SPEC = ObservationSpec(
    history=2,
    history_interval_s=0.5,
    disparity_hw=(96, 128),
    exo_hw=(48, 64),
    crop_px=32,
    crop_span=0.4,
    crop_heading_up=True,
    ego_px=16,
    ego_hfov_rad=2.0,
    ego_height_m=0.25,
    ego_range_m=6.0,
    waypoints=5,
    spacing_m=0.4,
)

ONE = Engine("local", 1)


def config(out: Path = Path(), episodes: int = 3) -> SynthConfig:
    return SynthConfig(out, episodes=episodes, goals=2, states=4, seed=3, hidden=False, layout=layout_of(SPEC))


@pytest.fixture(scope="module")
def episode():
    made = make_episode(config(), 1)
    assert made is not None
    return made


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    synthesise(config(folder), ONE)
    return folder


def test_an_exact_sample_is_what_the_camera_would_give_the_server(episode) -> None:
    sample = EpisodeRenderer(episode, SPEC).sample(2, np.random.default_rng(0), None)
    camera, pose = episode.camera, Pose2(*episode.poses[2, -1])
    world = build_world(episode.family, episode.world_seed)
    bodies = primitive_arrays((*world.primitives, robot_primitive(pose, RobotSpec())))
    disparity = normalise_disparity(1.0 / cast_depth(bodies, camera, SPEC.disparity_hw))
    np.testing.assert_allclose(sample.exo[-1], exo_view(disparity, SPEC), atol=1e-5)

    sighting = see_robot(camera, pose, RobotSpec(), robot="r", stamp_ns=0)
    size = np.array([camera.width_px, camera.height_px])
    np.testing.assert_allclose(sample.robot, sighting.pixel / size)
    np.testing.assert_allclose(sample.heading, sighting.heading)
    image_pose = ImagePose(sample.robot, sample.heading)
    crop = crop_around(disparity, image_pose, size[0] / size[1], SPEC)
    np.testing.assert_allclose(sample.crop[-1], crop, atol=1e-4)
    goal = camera.floor_point(sample.goal * size)
    assert goal is not None
    np.testing.assert_allclose(goal, episode.goals_m[episode.goal[2]], atol=1e-6)


class Watching:
    """Stands for both networks and keeps what the pipeline shows them."""

    def synthesise(self, requests):
        (self.to_exo2ego,) = requests
        return np.zeros((1, SPEC.ego_px, SPEC.ego_px), dtype=np.float32)

    def waypoints(self, requests):
        (self.to_policy,) = requests
        return np.zeros((1, SPEC.waypoints, 2))


def test_an_exact_sample_is_what_the_pipeline_shows_the_networks() -> None:
    spec = replace(SPEC, history=1)
    episode = make_episode(replace(config(), layout=layout_of(spec)), 1)
    assert episode is not None
    camera, world = episode.camera, build_world(episode.family, episode.world_seed)
    size_px = (camera.width_px, camera.height_px)
    for state in (0, 3, 7):
        goal_m = episode.goals_m[episode.goal[state]]
        scenario = Scenario(world, camera, Pose2(*episode.poses[state, -1]), tuple(goal_m), seed=0)
        clicked, _ = camera.project(np.append(goal_m, 0.0))
        networks = Watching()
        with Simulation(scenario, 0) as simulation:
            sees = {
                "depth": TrueDisparity(scenario, simulation, spec.disparity_hw),
                "tags": TrueSightings(scenario, simulation),
            }
            pipeline = Pipeline(spec, **sees, exo2ego=networks, planner=networks)
            frame = Frame(np.zeros((*size_px[::-1], 3), dtype=np.uint8), stamp_ns=0, seq=1)
            pipeline.step(frame, {"rover": Goal("g", tuple(clicked), size_px)})
        sample = EpisodeRenderer(episode, spec).sample(state, np.random.default_rng(0), None)
        np.testing.assert_allclose(sample.robot, networks.to_policy.pose.p_rob, atol=1e-6)
        np.testing.assert_allclose(sample.heading, networks.to_policy.pose.q_rel, atol=1e-5)
        np.testing.assert_allclose(sample.goal, networks.to_policy.goal, atol=1e-6)
        # PyBullet keeps poses to about 1e-7 m: a cell on the robot's outline may change sides.
        for ours, theirs in ((sample.exo, networks.to_policy.exo), (sample.crop, networks.to_exo2ego.crops)):
            assert ours.shape == theirs.shape
            assert np.abs(ours - theirs).mean() < 1e-3


def test_a_sample_has_the_shapes_and_ranges_of_the_observation(episode) -> None:
    renderer, rng = EpisodeRenderer(episode, SPEC), np.random.default_rng(0)
    for state in range(len(episode.goal)):
        sample = renderer.sample(state, rng, Disturbance())
        assert sample.exo.shape == (2, 48, 64)
        assert sample.crop.shape == (2, 32, 32)
        assert sample.ego.shape == (2, 16, 16)
        assert sample.waypoints.shape == (5, 2)
        assert 0.0 <= sample.exo.min() <= sample.exo.max() <= 1.0
        assert 0.0 <= sample.crop.min() <= sample.crop.max() <= 1.0
        assert -1.0 <= sample.ego.min() < sample.ego.max() <= 1.0
        assert np.linalg.norm(sample.heading) == pytest.approx(1.0)
        assert ((sample.robot > -0.02) & (sample.robot < 1.02)).all()
        assert ((sample.goal > 0.0) & (sample.goal < 1.0)).all()


def test_pose_noise_has_the_size_asked_for(episode) -> None:
    renderer, rng = EpisodeRenderer(episode, SPEC), np.random.default_rng(0)
    exact = renderer.sample(0, rng, None)
    noisy = [renderer.sample(0, rng, Disturbance(clean=1.0)) for _ in range(300)]
    offset_px = np.array([s.robot[0] - exact.robot[0] for s in noisy]) * 640
    assert np.std(offset_px) == pytest.approx(2.0, rel=0.2)
    cross = np.array([exact.heading[0] * s.heading[1] - exact.heading[1] * s.heading[0] for s in noisy])
    assert math.degrees(np.std(np.arcsin(cross))) == pytest.approx(4.0, rel=0.2)


def test_disparity_errors_change_the_picture_but_keep_the_scene(episode) -> None:
    rng = np.random.default_rng(1)
    world = primitive_arrays(build_world(episode.family, episode.world_seed).primitives)
    exact = normalise_disparity(1.0 / cast_depth(world, episode.camera, SPEC.disparity_hw))
    for _ in range(20):
        error = draw_error(Disturbance(clean=0.0), rng)
        assert error is not None
        wrong = normalise_disparity(error.apply(exact, rng))
        assert np.corrcoef(wrong.ravel(), exact.ravel())[0, 1] > 0.8
        assert np.abs(wrong - exact).mean() > 1e-3
    assert draw_error(Disturbance(clean=1.0), rng) is None


def test_an_unknown_family_is_refused() -> None:
    with pytest.raises(FileError, match="'moon'"):
        build_world("moon", 1_000_000_000)


def test_the_cache_is_repeatable_and_held_out_worlds_are_others(data, tmp_path) -> None:
    first = render_samples(data, tmp_path / "a", SPEC, jobs=1)
    second = render_samples(data, tmp_path / "b", SPEC, jobs=1)
    for name, column in first.columns.items():
        np.testing.assert_array_equal(column, second.columns[name])
    owner = first.columns["episode"]
    assert set(owner[first.train]).isdisjoint(owner[first.validation])
    assert len(first.train) + len(first.validation) == len(owner)
    assert first.columns["exo"].dtype == np.uint8
    assert first.columns["exo"].max() > 200


def test_a_cache_of_another_recipe_is_refused(data, tmp_path) -> None:
    render_samples(data, tmp_path / "c", SPEC, jobs=1)
    with pytest.raises(ConfigError, match="another recipe"):
        render_samples(data, tmp_path / "c", replace(SPEC, crop_span=0.3), jobs=1)
    with pytest.raises(ConfigError, match="labelled for"):
        render_samples(data, tmp_path / "d", replace(SPEC, spacing_m=0.5), jobs=1)
    with pytest.raises(FileError, match="no episodes"):
        render_samples(tmp_path, tmp_path / "e", SPEC, jobs=1)


class Squares:
    """Renders i² and remembers which blocks were asked for."""

    def __init__(self) -> None:
        self.asked: list[int] = []

    def __call__(self, block):
        self.asked.append(block.index)
        if block.index == 2 and self.asked.count(2) == 1:
            raise KeyboardInterrupt
        return {"x": np.arange(block.start, block.stop) ** 2}


def test_an_interrupted_cache_goes_on_with_what_misses(tmp_path) -> None:
    render = Squares()
    common = {"recipe": {}, "columns": {"x": Column("int64", ())}, "blocks": cut_blocks(10, 3), "jobs": 1}
    with pytest.raises(KeyboardInterrupt):
        fill_cache(tmp_path, render=render, **common)
    arrays = fill_cache(tmp_path, render=render, **common)
    np.testing.assert_array_equal(arrays["x"], np.arange(10) ** 2)
    assert render.asked == [0, 1, 2, 2, 3]


def test_split_holds_out_whole_worlds() -> None:
    episode = np.repeat(np.arange(200, dtype=np.int32), 3)
    samples = sample_set(Path(), {"episode": episode})
    assert sorted({*episode[samples.validation]}) == list(range(194, 200))  # 3 % of 200
    assert len(samples.train) == 194 * 3
    assert samples.worlds == 200


def test_pictures_come_with_their_disparity(tmp_path) -> None:
    pictures = render_pictures(tmp_path, (48, 64), pictures=7, jobs=1)
    rgb, disparity = pictures.columns["rgb"], pictures.columns["disparity"]
    assert rgb.shape == (8, 48, 64, 3)
    assert disparity.shape == (8, 48, 64)
    assert np.isfinite(disparity).all()
    assert (disparity >= 0).all()
    assert (rgb.reshape(8, -1).std(axis=1) > 5).all()
    assert list(pictures.train) == [0, 1, 2, 3]
    assert list(pictures.validation) == [4, 5, 6, 7]
