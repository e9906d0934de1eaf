"""What a benchmark leaves: a report for people, and pictures of its trials."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.server.tiny_bundle import write_tiny_bundle

from revnm_sim.bench.figures import most_telling
from revnm_sim.bench.markdown import markdown, summary
from revnm_sim.bench.metrics import comparisons, rows
from revnm_sim.bench.protocol import draw_setting
from revnm_sim.bench.publish import publish
from revnm_sim.bench.trial import TrialKey, TrialResult

KEY = TrialKey("random_pillar", "straight", "truth", 4, 0, 0, 0, 1, "blocked", "", "", "")


def result(success: bool) -> TrialResult:
    setting = draw_setting(KEY.world, seed=KEY.seed, pair=0, cameras=1, rule="blocked")
    start, goal = setting.pair.start[:2], setting.pair.goal_m
    return TrialResult(
        success=success,
        collision=False,
        timeout=not success,
        duration_s=20.0,
        path_m=9.0,
        expert_m=setting.route.expert_m,
        geodesic_m=setting.route.geodesic_m,
        closest_m=0.2,
        blocked=True,
        hidden_m=0.0,
        tick_p50_ms=1.0,
        robot_tick_p50_ms=2.0,
        track_m=[list(start), list(np.mean([start, goal], axis=0)), *([list(goal)] if success else [])],
    )


@pytest.fixture
def results(tmp_path: Path) -> dict[TrialKey, TrialResult]:
    bundle = str(write_tiny_bundle(tmp_path / "tiny", steer="goal"))
    revnm = replace(KEY, method="revnm", bundle=bundle)
    return {revnm: result(True), KEY: result(False), replace(KEY, method="expert"): result(True)}


def test_everything_is_written(tmp_path: Path, results: dict[TrialKey, TrialResult]) -> None:
    printed = publish(results, tmp_path, "revnm-sim bench --out here")
    assert len(json.loads((tmp_path / "report.json").read_text())["comparisons"]) == 3
    text = (tmp_path / "report.md").read_text()
    assert text.startswith("# Benchmark\n\n```sh\nrevnm-sim bench --out here\n```\n")
    assert all(line in text for line in ("![trajectories.png](trajectories.png)", "![ego_depth.png](ego_depth.png)"))
    assert "| revnm " in printed
    for name in ("trajectories.png", "ego_depth.png"):
        picture = cv2.imread(str(tmp_path / name))
        assert picture is not None
        assert picture.std() > 20.0  # something is drawn


def test_a_bundle_that_reprojects_the_exo_depth_is_drawn_too(tmp_path: Path) -> None:
    bundle = str(write_tiny_bundle(tmp_path / "tiny", sees="map"))
    publish({replace(KEY, method="revnm", bundle=bundle): result(True)}, tmp_path, "revnm-sim bench --out here")
    picture = cv2.imread(str(tmp_path / "ego_depth.png"))
    assert picture is not None
    assert picture.std() > 20.0


def test_without_models_there_is_no_ego_depth_to_draw(tmp_path: Path, results: dict[TrialKey, TrialResult]) -> None:
    publish({key: value for key, value in results.items() if not key.bundle}, tmp_path, "revnm-sim bench")
    assert not (tmp_path / "ego_depth.png").exists()
    assert "ego_depth" not in (tmp_path / "report.md").read_text()


def test_the_paper_stands_beside_its_worlds_only(results: dict[TrialKey, TrialResult]) -> None:
    ours = markdown(rows(results), comparisons(results), [], "revnm-sim bench")
    assert "0.88 ± 0.03 / 0.78 ± 0.03" in ours  # table I, Random Pillar, Ours
    assert "The paper's trials are not ours" in ours
    moved = {replace(key, world="aisles"): value for key, value in results.items()}
    other = markdown(rows(moved), comparisons(moved), [], "revnm-sim bench")
    assert "paper" not in other.replace("the paper trains a policy without it", "")


def test_the_summary_reads_rates_with_their_intervals(results: dict[TrialKey, TrialResult]) -> None:
    lines = summary(rows(results)).splitlines()
    assert "1.00 [1.00, 1.00]" in lines[2]
    assert "0.00 [0.00, 0.00]" in lines[3]


def test_the_trial_in_which_methods_differ_is_drawn() -> None:
    agreed, differ = replace(KEY, pair=0), replace(KEY, pair=1)
    results = {
        agreed: result(True),
        replace(agreed, method="expert"): result(True),
        differ: result(False),
        replace(differ, method="expert"): result(True),
    }
    key, tracks = most_telling(results, "random_pillar")
    assert key.pair == 1
    assert [tracks[method].success for method in ("straight", "expert")] == [False, True]
