"""The controller's courses: geometry as it says, a walker with a little caution, rows by hand, the command."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from revnm_client.braking import rectangle_distance
from revnm_client.geometry import Pose2
from revnm_client.messages import Velocity
from revnm_client.mppi import Footprint
from revnm_sim.bench.suites.controller import (
    CourseKey,
    CourseResult,
    course_bar,
    course_keys,
    course_note,
    course_rows,
    roughness,
    run_course,
)
from revnm_sim.bench.suites.courses import SLIT_M, Course, draw_course
from revnm_sim.bench.suites.walker import Walk, Walker
from revnm_sim.cli import main
from revnm_sim.expert.planner import Expert
from revnm_sim.occupancy import occupancy
from revnm_sim.rays.raycast import cast_scan
from revnm_sim.scenario import segment_blocked
from revnm_sim.world import primitive_arrays

ARRIVED = CourseResult(
    arrived=True,
    contact=False,
    hit_while_standing=False,
    duration_s=20.0,
    path_m=8.0,
    way_m=8.2,
    closest_m=0.2,
    dv_mps2=0.1,
    dw_radps2=0.5,
    tick_p50_ms=3.0,
    end_m=[1.0, 2.0, 0.5],
    reason=None,
)
FAR = Pose2(100.0, 0.0, 0.0)


def way(course: Course) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return Expert(course.world).field(course.pair.goal_m).path(course.pair.start[:2])


def crossing_of(course: Course) -> tuple[float, float]:
    """Return when a walker whom nobody disturbs crosses the straight way of the robot, and how far along that is."""
    assert course.walk is not None
    walker, (start, goal) = Walker(course.walk), course.pair
    side = None
    for step in range(4000):
        walker.advance(0.01, FAR, Footprint())
        to_goal, to_walker = np.subtract(goal, start[:2]), walker.place_m - start[:2]
        now = to_goal[0] * to_walker[1] - to_goal[1] * to_walker[0] > 0.0
        if side is not None and now != side:
            return step * 0.01, math.dist(start[:2], walker.place_m)
        side = now
    raise AssertionError("the walker never crossed")


# Geometry.


@pytest.mark.parametrize("number", range(6))
def test_the_slit_is_as_wide_as_it_says_and_the_only_way(number: int) -> None:
    course = draw_course("slit", seed=3, number=number)
    middle = np.zeros(2)
    width_m = 2.0 * float(occupancy(course.world, resolution_m=0.01).clearance_m(middle))
    assert width_m == pytest.approx(SLIT_M, abs=0.03)  # cells of 1 cm that a wall touches anywhere are occupied
    assert np.hypot(*way(course).T).min() < 0.1


@pytest.mark.parametrize("number", range(3))
def test_the_slalom_leads_from_side_to_side(number: int) -> None:
    course = draw_course("slalom", seed=3, number=number)
    barriers = course.world.primitives[4:]
    assert len(barriers) == 4
    path = way(course)
    sides = [path[np.abs(path[:, 0] - barrier.centre_m[0]).argmin(), 1] for barrier in barriers]
    assert [np.sign(side) for side in sides] == [-np.sign(barrier.centre_m[1]) for barrier in barriers]
    assert np.all(np.diff(np.sign(sides)) != 0.0)


@pytest.mark.parametrize("number", range(3))
def test_the_dead_end_is_before_the_robot_and_the_goal_beyond(number: int) -> None:
    course = draw_course("dead_end", seed=3, number=number)
    (start, goal), arrays = course.pair, primitive_arrays(course.world.primitives)
    ahead = cast_scan(arrays, start, height_m=0.2, angles_rad=np.zeros(1), max_range_m=9.0)
    assert 0.4 < ahead[0] < 0.8
    assert goal[0] > 0.6
    assert segment_blocked(occupancy(course.world), np.array([start[:2]]), np.array(goal))[0]
    assert way(course)[:, 0].min() < start.x_m - 0.2  # out by the open end


@pytest.mark.parametrize("number", range(6))
def test_the_walker_crosses_when_the_robot_would(number: int) -> None:
    course = draw_course("crossing", seed=3, number=number)
    assert course.walk is not None
    assert 0.3 <= course.walk.speed_mps <= 0.8
    assert course.walk.begin_s >= -1e-9
    time_s, along_m = crossing_of(course)
    assert time_s == pytest.approx(along_m / 0.5 + 0.9, abs=1.0 + 0.05)  # at 0.5 m/s, and 0.9 s to set out
    for x, y in (course.walk.from_m, course.walk.to_m):
        assert float(occupancy(course.world).clearance_m(np.array([x, y]))) > course.walk.radius_m


def test_numbers_give_other_scenes_and_equal_ones_the_same() -> None:
    first, second = (draw_course("random", seed=3, number=number) for number in range(2))
    assert first != second
    assert draw_course("random", seed=3, number=0) == first


# The walker.


def test_a_walker_stops_before_a_standing_robot_and_turns_back() -> None:
    walker = Walker(Walk((0.0, -2.0), (0.0, 2.0), speed_mps=0.8, begin_s=1.0))
    robot, footprint, nearest, farthest = Pose2(0.0, 0.0, 0.0), Footprint(), math.inf, -2.0
    for step in range(800):
        walker.advance(0.0125, robot, footprint)
        assert step > 78 or walker.place_m[1] == -2.0  # begins after 1 s
        gap_m = float(rectangle_distance(walker.place_m[None], np.array([robot]), footprint)[0, 0]) - 0.2
        nearest, farthest = min(nearest, gap_m), max(farthest, walker.place_m[1])
    # 0.18 m of robot, 0.1 m of caution and 0.2 m of radius: up to −0.48 m, or 0.2 s of 0.8 m/s and a tick before that.
    assert 0.1 <= nearest <= 0.1 + 0.16 + 0.01 + 1e-9
    assert farthest <= -0.48
    assert walker.place_m[1] == pytest.approx(-2.0, abs=1e-9)  # back where it came from


def test_a_walker_goes_on_when_the_robot_has_gone() -> None:
    walker = Walker(Walk((0.0, -1.0), (0.0, 1.0), speed_mps=0.5, begin_s=0.0))
    for step in range(700):
        walker.advance(0.0125, Pose2(0.0, 0.0, 0.0) if step < 80 else FAR, Footprint())
    assert walker.place_m == pytest.approx([0.0, 1.0])


# Rows.


def test_rows_by_hand() -> None:
    touched = replace(ARRIVED, arrived=False, contact=True, duration_s=10.0, path_m=4.0, closest_m=-0.01, dv_mps2=0.3)
    hit = replace(ARRIVED, arrived=False, hit_while_standing=True, reason="an obstacle")
    results = {
        CourseKey("random", 1, 0): ARRIVED,
        CourseKey("random", 1, 1): touched,
        CourseKey("crossing", 1, 0): hit,
        CourseKey("crossing", 1, 1): replace(ARRIVED, duration_s=40.0),
    }
    random, crossing, total = course_rows(results)
    by_hand = {
        "course": "random",
        "trials": 2,
        "contacts": 1,
        "hit_while_standing": 0,
        "arrivals": 1,
        "arrival_rate": 0.5,
        "mean_speed_mps": 0.4,  # 12 m in 30 s
        "mean_dv_mps2": 0.2,
        "mean_dw_radps2": 0.5,
        "least_clearance_m": -0.01,
        "p50_time_s": 20.0,
        "p50_mppi_ms": 3.0,
    }
    assert random == by_hand
    assert (crossing["contacts"], crossing["hit_while_standing"], crossing["p50_time_s"]) == (0, 1, 40.0)
    assert (total["course"], total["trials"], total["contacts"], total["arrival_rate"]) == ("all", 4, 1, 0.5)
    assert "missed (1 contacts, 50.0% arrivals)" in course_bar([random, crossing, total])
    assert "contact after 10.0 s and 4.00 m at (1.00, 2.00) m" in course_note(CourseKey("random", 1, 1), touched)
    assert course_note(CourseKey("random", 1, 0), ARRIVED) == ""


@pytest.mark.parametrize(("contacts", "rate", "word"), [(0, 0.97, "met"), (0, 0.969, "missed"), (1, 1.0, "missed")])
def test_the_bar_is_no_contact_and_97_percent(contacts: int, rate: float, word: str) -> None:
    assert f"arrivals: {word} (" in course_bar([{"contacts": contacts, "arrival_rate": rate}])


def test_roughness_by_hand() -> None:
    # 0 → 0.1 → 0.3 m/s and 0 → 0.2 → −0.2 rad/s in steps of 0.05 s: (0.1 + 0.2) / 2 / 0.05 and (0.2 + 0.4) / 2 / 0.05.
    assert roughness([Velocity(0.1, 0.2), Velocity(0.3, -0.2)]) == pytest.approx((3.0, 6.0))


def test_a_tenth_as_many_of_each_other_course() -> None:
    courses = [key.course for key in course_keys(scenes=200, seed=1)]
    assert {name: courses.count(name) for name in courses} == {
        "random": 200,
        "slalom": 20,
        "slit": 20,
        "dead_end": 20,
        "crossing": 20,
    }


# Trials and the command.


def test_the_slit_is_driven_and_equal_keys_give_equal_trials() -> None:
    result = run_course(CourseKey("slit", 1000, 1))
    assert (result.arrived, result.contact) == (True, False)
    assert 0.0 < result.closest_m < (SLIT_M - 0.36) / 2.0 + 0.01
    assert replace(run_course(CourseKey("slit", 1000, 1)), tick_p50_ms=0.0) == replace(result, tick_p50_ms=0.0)


def test_the_command_drives_every_course_and_goes_on(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "--suite", "controller", "--scenes", "1", "--jobs", "1", "--out", str(tmp_path)]
    assert main(words) == 0
    journal = (tmp_path / "controller.jsonl").read_text()
    assert main(words) == 0
    assert (tmp_path / "controller.jsonl").read_text() == journal  # nothing was run again
    report = json.loads((tmp_path / "report.json").read_text())
    assert [row["course"] for row in report["rows"]] == ["random", "slalom", "slit", "dead_end", "crossing", "all"]
    assert report["command"].startswith("revnm-sim bench --suite controller")
    assert report["rows"][-1]["trials"] == 5
    assert "bar: 0 contacts" in capsys.readouterr().out


def test_a_suite_of_nothing_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--suite", "controller", "--scenes", "0", "--out", str(tmp_path / "out")]) == 2
    assert "--scenes" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
