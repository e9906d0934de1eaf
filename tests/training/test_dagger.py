from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import FileError
from revnm_sim.bench.trial import CONTROL_S
from revnm_sim.expert.planner import INSCRIBED_M, Expert
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.world import Bounds, Primitive, Shape, World
from revnm_training import rollouts
from revnm_training.episodes import EpisodeLayout, StateKind, read_episodes
from revnm_training.rollouts import RolloutConfig, roll_out
from revnm_training.sample_set import JoinedColumn, SampleSet, join
from revnm_training.states import NEAR_M
from revnm_training.visited import choose_visited

GOAL = (4.0, 0.0)
LAYOUT = EpisodeLayout(history=2, history_interval_s=0.5, waypoints=5, spacing_m=0.4)


@pytest.fixture(scope="module")
def field():
    pillar = Primitive(Shape.BOX, (0.0, 2.0, 0.5), (1.0, 1.0, 1.0), 0.0, (200, 200, 200))
    return Expert(World("hall", Bounds(-6.0, -4.0, 6.0, 4.0), (150, 150, 150), (pillar,))).field(GOAL)


def straight_on(count: int, x_m: float, y_m: float, yaw_rad: float = 0.0) -> np.ndarray:
    poses = np.zeros((count, 3))
    poses[:, 0] = x_m + 0.5 * CONTROL_S * np.arange(count)
    poses[:, 1], poses[:, 2] = y_m, yaw_rad
    return poses


def kinds_of(poses: np.ndarray, field, count: int = 20) -> tuple[np.ndarray, np.ndarray]:
    return choose_visited(poses, field, count, np.random.default_rng(0), interval_s=CONTROL_S)


def test_a_quiet_drive_is_sampled_evenly(field) -> None:
    numbers, kinds = kinds_of(straight_on(200, -4.0, -2.0), field)
    assert len(numbers) == 20
    assert (np.diff(numbers) > 0).all()
    assert set(kinds) == {StateKind.VISITED}
    assert numbers.min() < 50
    assert numbers.max() > 150


def test_each_kind_of_trouble_gets_its_share(field) -> None:
    cruise = straight_on(200, -4.0, -1.0)
    stands = np.tile([-2.0, -2.0, 0.0], (60, 1))
    backwards = straight_on(40, -3.0, -2.5, math.pi)
    touches = straight_on(20, -0.2, 1.5 - INSCRIBED_M - NEAR_M / 2)
    poses = np.concatenate([cruise, stands, backwards, touches])
    numbers, kinds = kinds_of(poses, field)
    counts = {kind: int((kinds == kind).sum()) for kind in StateKind}
    assert counts[StateKind.NEAR] == counts[StateKind.STUCK] == counts[StateKind.ASTRAY] == 5
    assert counts[StateKind.VISITED] == 5
    assert (field.grid.clearance_m(poses[numbers[kinds == StateKind.NEAR], :2]) < INSCRIBED_M + NEAR_M).all()
    assert ((numbers[kinds == StateKind.STUCK] >= 240) & (numbers[kinds == StateKind.STUCK] < 260)).all()
    assert (numbers[kinds == StateKind.ASTRAY] >= 260).all()  # backwards, or led away from the pillar


def test_states_that_the_expert_cannot_label_are_left_out(field) -> None:
    in_pillar = np.tile([0.0, 2.0, 0.0], (50, 1))
    at_goal = np.tile([*GOAL, 0.0], (50, 1))
    numbers, kinds = kinds_of(np.concatenate([in_pillar, at_goal]), field)
    assert len(numbers) == len(kinds) == 0


def test_a_drive_is_labelled_in_its_world_and_goes_on_after_a_stop(tmp_path: Path, monkeypatch) -> None:
    driven: list[int] = []

    class OnTheWay:
        """Stands in for the trial: drives along the expert's way, and arrives."""

        def __init__(self, scenario, route, key) -> None:
            path = route.field.path((scenario.start.x_m, scenario.start.y_m))
            heading = np.arctan2(*np.diff(path, axis=0).T[::-1])
            self.poses = np.column_stack([path[1:], heading])
            driven.append(key.pair)

        def run(self):
            return rollouts.TrialResult(
                **dict.fromkeys(("success", "blocked"), True),
                **dict.fromkeys(("collision", "timeout"), False),
                **dict.fromkeys(("duration_s", "path_m", "expert_m", "geodesic_m", "closest_m", "hidden_m"), 5.0),
                tick_p50_ms=1.0,
                robot_tick_p50_ms=1.0,
                track_m=[],
            )

    monkeypatch.setattr(rollouts, "Trial", OnTheWay)
    monkeypatch.setattr(rollouts, "SHARD_ROLLOUTS", 2)
    config = RolloutConfig(tmp_path, tmp_path, "truth", rollouts=4, states=6, seed=7, layout=LAYOUT)
    first = roll_out(config, jobs=1)
    assert len(first) >= 3
    assert all(outcome.success and outcome.spl == 1.0 and outcome.states == 6 for outcome in first)
    files = sorted(tmp_path.glob("*.parquet"))
    episode = read_episodes(files[0])[1][0]
    assert episode.world_seed >= TRAINING_SEED_BASE
    field = Expert(rollouts.build_world(episode.family, episode.world_seed)).field(episode.goals_m[0])
    again = field.waypoints_batch(episode.poses[:, -1], count=5, spacing_m=0.4)
    np.testing.assert_allclose(episode.waypoints_m, again, atol=0.02)

    files[0].with_suffix(".json").unlink()
    driven.clear()
    assert roll_out(config, jobs=1) == first
    assert len(driven) <= 2


def test_damaged_outcomes_are_named(tmp_path: Path) -> None:
    config = RolloutConfig(tmp_path, tmp_path, "truth", rollouts=1, states=6, seed=7, layout=LAYOUT)
    (tmp_path / "drives_007_0000000.json").write_text(json.dumps([{"family": "rooms"}]))
    with pytest.raises(FileError, match=r"drives_007_0000000\.json"):
        roll_out(config, jobs=1)


def test_joined_sets_give_the_items_of_all() -> None:
    rng = np.random.default_rng(0)
    parts = [rng.integers(255, size=(count, 3)) for count in (4, 7, 2)]
    joined, whole = JoinedColumn(parts), np.concatenate(parts)
    assert len(joined) == 13
    assert joined.shape == (13, 3)
    for index in (np.array([0, 3, 4, 10, 11, 12]), np.array([5, 5, 6]), np.array([12]), np.arange(13)):
        np.testing.assert_array_equal(joined[index], whole[index])

    sets = [
        SampleSet(Path("a"), {"waypoints": parts[0]}, np.array([0, 1]), np.array([2, 3]), worlds=2),
        SampleSet(Path("b"), {"waypoints": parts[1]}, np.array([0, 4]), np.array([6]), worlds=3),
    ]
    both = join(sets, [1, 2])
    assert both.train.tolist() == [0, 1, 4, 8, 4, 8]
    assert both.validation.tolist() == [2, 3, 10]
    assert both.worlds == 5
