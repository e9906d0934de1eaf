"""The benchmark: rows by hand, a journal that survives a power cut, trials that repeat, the command end to end."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.server.tiny_bundle import write_tiny_bundle

from revnm_client.errors import ConfigError, FileError
from revnm_client.geometry import Pose2
from revnm_client.messages import Velocity
from revnm_sim.bench.journal import Journal
from revnm_sim.bench.methods import Perception
from revnm_sim.bench.methods.pose import KeptSightings
from revnm_sim.bench.metrics import comparisons, rows, spl
from revnm_sim.bench.report import table
from revnm_sim.bench.trial import Trial, TrialKey, TrialResult, run_trial
from revnm_sim.camera import Camera
from revnm_sim.cli import main
from revnm_sim.expert.route import plan_route
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation
from revnm_sim.site import GOAL_RADIUS_M, Pair
from revnm_sim.world import Bounds, Primitive, Shape, World

GREY = (150, 150, 150)
KEY = TrialKey("random_pillar", "straight", "truth", 1000, 0, 0, 0, 2, "blocked", "", "", "")
ARRIVED = TrialResult(
    success=True,
    collision=False,
    timeout=False,
    duration_s=20.0,
    path_m=10.0,
    expert_m=8.0,
    geodesic_m=7.5,
    closest_m=0.2,
    blocked=True,
    hidden_m=1.2,
    tick_p50_ms=4.0,
    robot_tick_p50_ms=2.0,
    track_m=[[0.0, 0.0], [6.0, 8.0]],
)
TOUCHED = replace(ARRIVED, success=False, collision=True, duration_s=5.0, path_m=2.0)
LATE = replace(ARRIVED, success=False, timeout=True, duration_s=60.0, blocked=False, hidden_m=0.9, tick_p50_ms=10.0)


def scenario(*primitives: Primitive, yaw_rad: float = 0.0) -> Scenario:
    """A room of 8 × 6 m seen from straight above, from (−1, 0) to (1, 0.5)."""
    above = Camera(640, 480, math.radians(90.0), (0.0, 0.0, 4.0), 0.0, math.pi / 2.0)
    world = World("room", Bounds(-4.0, -3.0, 4.0, 3.0), GREY, primitives)
    return Scenario(world, above, Pose2(-1.0, 0.0, yaw_rad), (1.0, 0.5), seed=7)


def drive(place: Scenario, key: TrialKey) -> TrialResult:
    return Trial(place, plan_route(place.world, Pair(place.start, place.goal_m)), key).run()


def without_times(result: TrialResult) -> TrialResult:
    return replace(result, tick_p50_ms=0.0, robot_tick_p50_ms=0.0)


# Rows.


def test_spl_by_hand() -> None:
    # Success 8 / 10; contact and timeout 0; a path that is shorter than the reference counts as 1.
    short = replace(ARRIVED, path_m=7.0)
    expert = spl([ARRIVED, TOUCHED, LATE, short], length=lambda r: r.expert_m)
    assert expert == pytest.approx([0.8, 0.0, 0.0, 1.0])
    assert spl([ARRIVED], length=lambda r: r.geodesic_m) == pytest.approx([0.75])


def test_rows_by_hand_one_for_each_world_method_and_perception() -> None:
    expert = replace(KEY, method="expert")
    results = {
        KEY: ARRIVED,
        replace(KEY, camera=1): TOUCHED,
        replace(KEY, pair=1): LATE,
        expert: LATE,
        replace(KEY, perception="models"): ARRIVED,
    }
    first, second, third = rows(results)
    by_hand = {
        "world": "random_pillar",
        "method": "straight",
        "perception": "truth",
        "trials": 3,
        "success_rate": 0.3333,
        "spl": 0.2667,  # 0.8 / 3
        "spl_geodesic": 0.25,  # 7.5 / 10 / 3
        "collisions": 1,
        "timeouts": 1,
        "collision_rate": 0.3333,
        "timeout_rate": 0.3333,
        "blocked_rate": 0.6667,
        "hidden_trials": 2,
        "hidden_success_rate": 0.5,
        "hidden_spl": 0.4,  # 0.8 / 2
        "least_clearance_m": 0.2,
        "median_clearance_m": 0.2,
        "mean_success_s": 20.0,
        "p50_tick_ms": 4.0,  # of 4, 4 and 10
        "p50_robot_tick_ms": 2.0,
    }
    assert by_hand.items() <= first.items()
    # Three conditions, one of them with a success: draws of three give 0 to 3 of them. Two pairs: the first has 1 / 2.
    assert (first["success_low"], first["success_high"]) == (0.0, 1.0)
    assert (first["success_by_pair_low"], first["success_by_pair_high"]) == (0.0, 0.5)
    assert (second["method"], second["trials"], second["mean_success_s"]) == ("expert", 1, None)
    assert (third["perception"], third["success_rate"]) == ("models", 1.0)


def test_comparisons_are_of_the_trials_that_both_methods_have() -> None:
    outcomes = [(ARRIVED, ARRIVED), (ARRIVED, LATE), (ARRIVED, TOUCHED), (LATE, ARRIVED), (LATE, LATE)]
    results = {}
    for pair, (straight, expert) in enumerate(outcomes):
        results[replace(KEY, pair=pair)] = straight
        results[replace(KEY, pair=pair, method="expert")] = expert
    results[replace(KEY, pair=9)] = ARRIVED  # the expert has none
    results[replace(KEY, world="bookstore")] = ARRIVED
    (found,) = comparisons(results)
    assert (found["method"], found["other"], found["trials"]) == ("straight", "expert", 5)
    assert (found["only_method"], found["only_other"]) == (2, 1)
    assert found["difference"] == 0.2
    assert found["difference_low"] < 0.2 < found["difference_high"]
    assert found["mcnemar_p"] == 1.0  # 2 of 3 heads or worse, both sides
    assert (found["hidden_trials"], found["hidden_difference"]) == (3, 0.6667)  # 0, 1 and 1


def test_table_has_a_line_for_every_row_and_nothing_for_none() -> None:
    lines = table([{"world": "w", "method": m, "s": s} for m, s in (("straight", 1.0), ("expert", None))]).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[0].split()[1:6] == ["world", "|", "method", "|", "s"]
    assert [line.split("|")[2].strip() for line in lines[2:]] == ["straight", "expert"]
    assert lines[3].split("|")[3].strip() == ""
    assert table([]) == ""


# Journal.


def journal_at(path: Path) -> Journal[TrialKey, TrialResult]:
    return Journal(path, TrialKey, TrialResult)


def test_a_journal_gives_back_what_was_added(tmp_path: Path) -> None:
    journal = journal_at(tmp_path / "trials.jsonl")
    journal.add(KEY, ARRIVED)
    journal.add(replace(KEY, pair=1), TOUCHED)
    assert journal_at(tmp_path / "trials.jsonl").results == {KEY: ARRIVED, replace(KEY, pair=1): TOUCHED}


def test_a_line_that_was_cut_short_is_dropped_and_the_file_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "trials.jsonl"
    journal = journal_at(path)
    journal.add(KEY, ARRIVED)
    journal.add(replace(KEY, pair=1), TOUCHED)
    path.write_bytes(path.read_bytes()[:-9])
    again = journal_at(path)
    assert again.results == {KEY: ARRIVED}
    again.add(replace(KEY, pair=2), LATE)
    assert journal_at(path).results == {KEY: ARRIVED, replace(KEY, pair=2): LATE}


@pytest.mark.parametrize("line", ["hello", "3", "{}", '{"key": {"moon": 1}, "result": {}}', '{"key": [], "result": 1}'])
def test_a_foreign_line_is_refused_by_its_number(tmp_path: Path, line: str) -> None:
    path = tmp_path / "trials.jsonl"
    journal_at(path).add(KEY, ARRIVED)
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(FileError, match=r"trials\.jsonl: line 2: no finished trial"):
        journal_at(path)
    assert path.read_text().splitlines()[1] == line  # nothing was changed


# Trials.


@pytest.mark.parametrize("method", ["straight", "expert"])
def test_a_free_way_is_driven_straight_and_the_same_every_time(method: str) -> None:
    key = replace(KEY, method=method)
    result = drive(scenario(yaw_rad=0.5), key)
    assert (result.success, result.collision, result.timeout, result.blocked) == (True, False, False, False)
    straight_m = math.hypot(2.0, 0.5)
    assert result.expert_m == pytest.approx(straight_m, abs=0.02)
    assert straight_m - GOAL_RADIUS_M - 0.05 < result.path_m < straight_m
    assert straight_m / 0.5 - 1.5 < result.duration_s < 8.0  # 0.5 m/s, some of it to speed up and turn
    assert without_times(drive(scenario(yaw_rad=0.5), key)) == without_times(result)


def test_a_way_under_a_shelf_is_hidden_from_above() -> None:
    shelf = Primitive(Shape.BOX, (0.0, 0.0, 1.5), (1.0, 5.0, 0.05), 0.0, GREY)  # its shadow is 1.6 m wide
    seen, hidden = (drive(place, replace(KEY, method="expert")) for place in (scenario(), scenario(shelf)))
    assert seen.hidden_m == 0.0
    assert hidden.hidden_m == pytest.approx(1.6 * math.hypot(2.0, 0.5) / 2.0, abs=0.1)
    assert hidden.success


def test_equal_keys_give_equal_trials_of_a_world_and_methods_share_it() -> None:
    first, again = run_trial(KEY), run_trial(KEY)
    assert without_times(first) == without_times(again)
    expert = run_trial(replace(KEY, method="expert"))
    assert (expert.expert_m, expert.blocked) == (first.expert_m, first.blocked) == (first.expert_m, True)
    assert expert.success


def test_a_touch_ends_the_trial_as_a_collision() -> None:
    # A beam under the LiDAR and not seen by it, across the way, its face 0.5 m ahead of the start: the body's
    # front (0.215 m) meets it after 0.285 m.
    beam = Primitive(Shape.BOX, (-0.4, 0.0, 0.05), (0.2, 4.0, 0.1), 0.0, GREY)
    result = drive(scenario(beam), KEY)
    assert (result.success, result.collision, result.timeout, result.blocked) == (False, True, False, True)
    assert result.path_m == pytest.approx(0.285, abs=0.05)
    assert result.closest_m <= 0.02
    assert result.duration_s < 5.0


# ReVNM in a trial.


@pytest.mark.parametrize("perception", ["truth", "models"])
def test_revnm_drives_where_the_policy_of_the_bundle_points(tmp_path: Path, perception: Perception) -> None:
    bundle = write_tiny_bundle(tmp_path / "tiny", steer="goal")
    key = replace(KEY, method="revnm", perception=perception, bundle=str(bundle))
    result = drive(scenario(yaw_rad=0.5), key)
    assert result.success
    assert result.path_m < math.hypot(2.0, 0.5)
    assert without_times(drive(scenario(yaw_rad=0.5), key)) == without_times(result)


def test_a_policy_that_sees_the_map_and_changes_nothing_drives_as_the_planner(tmp_path: Path) -> None:
    bundle = write_tiny_bundle(tmp_path / "tiny", sees="map")
    by_planner = run_trial(replace(KEY, method="bev"))
    by_policy = run_trial(replace(KEY, method="revnm", bundle=str(bundle)))
    assert by_planner.success
    assert by_policy.success
    assert by_policy.path_m == pytest.approx(by_planner.path_m, rel=0.05)
    assert by_policy.path_m < 1.2 * by_policy.expert_m


def test_a_robot_that_was_never_seen_gets_no_plan_and_is_late(tmp_path: Path) -> None:
    roof = Primitive(Shape.BOX, (-1.0, 0.0, 1.5), (1.0, 1.0, 0.1), 0.0, GREY)
    bundle = write_tiny_bundle(tmp_path / "tiny", steer="ahead")
    result = drive(scenario(roof), replace(KEY, method="revnm", bundle=str(bundle)))
    assert (result.success, result.collision, result.timeout) == (False, False, True)
    assert result.duration_s == 60.0
    assert result.path_m < 0.01


def test_a_hidden_robot_keeps_its_last_pose_as_if_seen_now() -> None:
    # Seen at x = −1, then it drives under the roof.
    roof = Primitive(Shape.BOX, (0.5, 0.0, 1.5), (1.6, 1.6, 0.1), 0.0, GREY)
    place = scenario(roof)
    with Simulation(place, place.seed) as simulation:
        source = KeptSightings(place, simulation)
        first = source.sighting(1)
        assert first is not None
        for _ in range(60):  # 3 s, about 1.2 m, without a look on the way
            simulation.command(Velocity(0.5, 0.0))
            simulation.advance(0.05)
        assert 0.0 < simulation.true_pose.x_m < 0.5
        kept = source.sighting(2)
        assert kept is not None
        assert kept.stamp_ns == 2
        assert np.array_equal(kept.corners, first.corners)
        assert np.array_equal(kept.pixel, first.pixel)


# The command.


def bench(out: Path, *words: str) -> int:
    return main(["bench", "--out", str(out), "--jobs", "1", *words])


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--world", "moon"], "no world is named 'moon': expected one of"),
        (["--world", "moon.yaml"], "moon.yaml: cannot be read"),
        (["--jobs", "0"], "--jobs 0: expected 1 or more"),
        (["--seed", "-1"], "--seed -1: expected 0 or more"),
        (["--address", "tcp://127.0.0.1:1"], "expected --engine ray or dask"),
        (["--method", "no_dagger"], "--method no_dagger: expected --bundle no_dagger=FOLDER"),
        (["--bundle", "fly=nowhere"], "--bundle fly=nowhere: fly is none of the methods"),
        (["--method", "straight,fly"], "--method fly: expected one of"),
        (["--method", "straight", "--protocol", "0x1x1"], "--protocol 0x1x1: expected one of default, paper"),
        (["--method", "revnm", "--bundle", "nowhere"], "manifest.json: missing"),
    ],
)
def test_wrong_options_are_told_and_nothing_is_run(
    tmp_path: Path, words: list[str], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert bench(tmp_path / "out", *words) == 2
    assert complaint in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_unknown_world_is_a_config_error() -> None:
    with pytest.raises(ConfigError, match="'moon'"):
        run_trial(replace(KEY, world="moon"))


def test_the_command_reports_prints_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--world", "random_pillar", "--method", "straight,expert", "--seed", "4")
    assert bench(tmp_path, *words, "--protocol", "1x1x1") == 0
    first = (tmp_path / "trials.jsonl").read_text()
    assert len(first.splitlines()) == 2

    assert bench(tmp_path, *words, "--protocol", "2x1x1") == 0
    journal = (tmp_path / "trials.jsonl").read_text()
    assert journal.startswith(first)  # the finished trials were not run again
    assert len(journal.splitlines()) == 4
    report = json.loads((tmp_path / "report.json").read_text())
    assert {"rows", "comparisons", "command", "versions", "machine"} == set(report)
    assert report["command"].startswith("revnm-sim bench --world random_pillar --method straight,expert")
    fixed = {"world", "method", "trials", "success_rate", "spl", "collisions", "timeouts", "p50_tick_ms"}
    straight, expert = report["rows"]
    for row, method in ((straight, "straight"), (expert, "expert")):
        assert fixed <= set(row)
        assert (row["world"], row["method"], row["trials"], row["blocked_rate"]) == ("random_pillar", method, 2, 1.0)
        assert 0.0 <= row["spl"] <= row["success_rate"] <= 1.0
    assert expert["success_rate"] == 1.0
    printed = capsys.readouterr().out
    assert "| random_pillar | expert" in printed


def test_the_same_trials_give_the_same_report_whatever_runs_them(tmp_path: Path) -> None:
    words = (
        "--world",
        "demo_room",
        "--pairs",
        "any",
        "--method",
        "straight,expert",
        "--protocol",
        "2x2x1",
        "--seed",
        "7",
    )

    def report(name: str, jobs: str) -> dict[str, object]:
        assert main(["bench", *words, "--jobs", jobs, "--out", str(tmp_path / name)]) == 0
        found = json.loads((tmp_path / name / "report.json").read_text())
        rows = [{key: value for key, value in row.items() if not key.endswith("_ms")} for row in found["rows"]]
        return {**found, "rows": rows, "command": found["command"].replace(name, "")}

    assert report("one", "1") == report("two", "2") == report("again", "2")
