from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster

from revnm_client.errors import ConfigError, ContractError, FileError
from revnm_client.geometry import Pose2
from revnm_sim.engine import Engine
from revnm_sim.expert.planner import INSCRIBED_M, Expert
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.rays.raycast import visible
from revnm_sim.world import primitive_arrays
from revnm_training import synth
from revnm_training.episodes import EpisodeLayout, StateKind, read_episodes, read_layout, write_episodes
from revnm_training.samples import build_world
from revnm_training.states import NEAR_M, SHARES, draw_history, make_scene
from revnm_training.synth import RobotSpec, SynthConfig, make_episode, shard_path, synthesise

ONE = Engine("local", 1)
LAYOUT = EpisodeLayout(history=2, history_interval_s=0.5, waypoints=5, spacing_m=0.4)


def config(out: Path = Path(), **changes) -> SynthConfig:
    return replace(SynthConfig(out, episodes=3, goals=2, states=8, seed=7, hidden=False, layout=LAYOUT), **changes)


@pytest.fixture(scope="module")
def episode():
    made = make_episode(config(), 0)
    assert made is not None
    return made


@pytest.fixture
def path(tmp_path, episode):
    write_episodes(tmp_path / "a.parquet", [episode, episode], LAYOUT)
    return tmp_path / "a.parquet"


def test_reading_gives_back_what_was_written(path, episode) -> None:
    layout, episodes = read_episodes(path)
    assert layout == read_layout(path) == LAYOUT
    assert len(episodes) == 2
    for read in episodes:
        assert (read.family, read.world_seed, read.camera) == (
            episode.family,
            episode.world_seed,
            episode.camera,
        )
        for name, kept_to in (("goals_m", 0.0), ("goal", 0.0), ("kind", 0.0), ("poses", 5e-4), ("waypoints_m", 5e-4)):
            np.testing.assert_allclose(getattr(read, name), getattr(episode, name), rtol=0.0, atol=kept_to + 1e-6)
            assert getattr(read, name).dtype == getattr(episode, name).dtype


def test_an_episode_takes_less_than_a_kilobyte(tmp_path) -> None:
    made = [make_episode(config(states=10, layout=replace(LAYOUT, history=1)), number) for number in range(20)]
    kept = [episode for episode in made if episode is not None]
    write_episodes(tmp_path / "c.parquet", kept, replace(LAYOUT, history=1))
    assert sum(len(episode.goal) for episode in kept) > 19 * len(kept)
    assert (tmp_path / "c.parquet").stat().st_size < 1000 * len(kept)


def test_headings_are_kept_over_the_jump_of_the_circle_and_far_places_are_refused(tmp_path, episode) -> None:
    turning = episode.poses.copy()
    turning[:, :, 2] = np.array([3.13, -3.13])  # through π, and not the long way round
    write_episodes(tmp_path / "t.parquet", [replace(episode, poses=turning)], LAYOUT)
    yaw = read_episodes(tmp_path / "t.parquet")[1][0].poses[..., 2]
    np.testing.assert_allclose(np.cos(yaw), np.cos(turning[..., 2]), atol=1e-6)
    assert np.abs(np.diff(yaw, axis=1)).max() < 0.03
    with pytest.raises(ContractError, match="too far"):
        write_episodes(tmp_path / "f.parquet", [replace(episode, poses=turning + 40.0)], LAYOUT)


def test_a_truncated_file_is_refused_by_name(path) -> None:
    content = path.read_bytes()
    for length in (0, 3, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        with pytest.raises(FileError, match=r"a\.parquet"):
            read_episodes(path)


def test_a_damaged_page_is_refused_by_name(path) -> None:
    content = bytearray(path.read_bytes())
    content[4 : len(content) // 2] = bytes(len(content) // 2 - 4)
    path.write_bytes(bytes(content))
    with pytest.raises(FileError, match=r"a\.parquet"):
        read_episodes(path)


def test_a_missing_file_is_refused_by_name(tmp_path) -> None:
    with pytest.raises(FileError, match=r"none\.parquet"):
        read_episodes(tmp_path / "none.parquet")


@pytest.mark.parametrize(
    ("metadata", "complaint"),
    [
        (b'{"format": 1}', "format 2 expected, got 1"),
        (b"{}", "got None"),
        (b"[]", "malformed"),
        (b'{"format": 2, "history": 1}', "malformed"),
        (b"{", "malformed"),
    ],
)
def test_other_formats_and_versions_are_refused(path, metadata, complaint) -> None:
    table = pq.read_table(path).replace_schema_metadata({b"revnm_episodes": metadata})
    pq.write_table(table, path)
    with pytest.raises(FileError, match=complaint):
        read_episodes(path)


def test_foreign_parquet_is_refused(tmp_path) -> None:
    pq.write_table(pa.table({"x": [1]}), tmp_path / "x.parquet")
    with pytest.raises(FileError, match="format 2 expected, got None"):
        read_episodes(tmp_path / "x.parquet")


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"poses": lambda e: e.poses[:-1]}, "row 0: poses: 90 numbers do not fill"),
        ({"goals_m": lambda e: np.full_like(e.goals_m, np.nan)}, "goals_m: a number is not finite"),
        ({"goal": lambda e: e.goal + np.uint8(9)}, "goal: 10 of only 2 goals"),
        ({"goal": lambda e: e.goal[:0]}, "without states"),
        ({"camera": lambda e: replace(e.camera, hfov_rad=4.0)}, "impossible size or field of view"),
        ({"camera": lambda e: replace(e.camera, yaw_rad=float("inf"))}, "camera: finite numbers"),
    ],
)
def test_absurd_rows_are_refused_with_file_and_row(tmp_path, episode, change, complaint) -> None:
    assert episode.poses.shape == (16, 2, 3)  # 15 states of 2 × 3 numbers are 90
    bad = replace(episode, **{name: make(episode) for name, make in change.items()})
    write_episodes(tmp_path / "b.parquet", [bad], LAYOUT)
    with pytest.raises(FileError, match=complaint) as caught:
        read_episodes(tmp_path / "b.parquet")
    assert "b.parquet" in str(caught.value)


def test_states_fit_are_seen_and_are_labelled_by_the_expert(episode) -> None:
    world = build_world(episode.family, episode.world_seed)
    expert = Expert(world)
    newest = episode.poses[:, -1]
    clearance = expert.grid.clearance_m(newest[:, :2])
    assert (clearance > INSCRIBED_M).all()
    assert (clearance[episode.kind == StateKind.NEAR] < INSCRIBED_M + NEAR_M).all()
    assert set(episode.kind) == set(SHARES)
    tags = np.column_stack([newest[:, :2], np.full(len(newest), RobotSpec().top_m)])
    arrays = primitive_arrays(world.primitives)
    assert visible(arrays, episode.camera, tags).all()
    assert visible(arrays, episode.camera, np.pad(episode.goals_m, ((0, 0), (0, 1)))).all()
    for state in (0, 7, 15):
        field = expert.field(episode.goals_m[episode.goal[state]])
        expected = field.waypoints(Pose2(*newest[state]), count=5, spacing_m=0.4)
        np.testing.assert_allclose(episode.waypoints_m[state], expected, atol=1e-5)


def test_worlds_are_training_worlds_and_differ_by_seed() -> None:
    first, second = make_episode(config(), 0), make_episode(config(seed=8), 0)
    assert first is not None
    assert second is not None
    assert min(first.world_seed, second.world_seed) >= TRAINING_SEED_BASE
    assert first.world_seed != second.world_seed


def test_a_past_is_a_drive_that_ends_in_the_present() -> None:
    made = make_episode(config(), 0)
    assert made is not None
    rng = np.random.default_rng(0)
    world = build_world(made.family, made.world_seed)
    grid = Expert(world).grid
    scene = make_scene(world, made.camera, grid, RobotSpec(), rng)
    for pose in made.poses[:, -1]:
        past = draw_history(scene, Pose2(*pose), frames=5, interval_s=0.5, rng=rng)
        np.testing.assert_allclose(past[-1], pose)
        assert (np.linalg.norm(np.diff(past[:, :2], axis=0), axis=1) <= 0.25 + 1e-9).all()  # 0.5 m/s · 0.5 s
        assert (grid.clearance_m(past[:, :2]) > INSCRIBED_M).all()


def test_synthesis_is_repeatable_and_goes_on_where_it_stopped(tmp_path) -> None:
    labelled, _ = synthesise(config(tmp_path), ONE)
    path = shard_path(tmp_path, 7, 0)
    _, episodes = read_episodes(path)
    assert labelled == sum(len(episode.goal) for episode in episodes)
    before = path.read_bytes()
    assert synthesise(config(tmp_path), ONE)[0] == 0
    path.unlink()
    synthesise(config(tmp_path), ONE)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_dask_cluster_makes_the_same_episodes(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(synth, "SHARD_EPISODES", 1)
    synthesise(config(tmp_path / "here"), ONE)
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        synthesise(config(tmp_path / "there"), Engine("dask", 2, cluster.scheduler_address))
    here, there = (sorted((tmp_path / name).iterdir()) for name in ("here", "there"))
    assert [path.name for path in here] == [path.name for path in there]
    assert len(here) == 3
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(here, there, strict=True))


def test_a_folder_of_another_layout_is_refused(tmp_path) -> None:
    synthesise(config(tmp_path, episodes=1), ONE)
    with pytest.raises(ConfigError, match="now asked for"):
        synthesise(config(tmp_path, episodes=1, layout=replace(LAYOUT, history=1)), ONE)
    with pytest.raises(ConfigError, match="seed 1000"):
        synthesise(config(tmp_path, seed=1000), ONE)
