from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from revnm_client.errors import ConfigError, FileError
from revnm_server.robots.mission import MAX_EPOCH, GoalError, Mission, StoppedError, UnknownRobotError

SIZE = (640, 480)


@pytest.fixture
def mission(tmp_path: Path) -> Mission:
    return Mission(["rover", "cart"], state_file=tmp_path / "state.json")


def restarted(tmp_path: Path, *robots: str) -> Mission:
    return Mission(robots or ["rover", "cart"], state_file=tmp_path / "state.json")


def test_a_goal_is_normalised_by_the_picture(mission: Mission) -> None:
    goal = mission.set_goal("rover", 160, 360, size_px=SIZE)
    assert goal.normalised == (0.25, 0.75)
    assert mission.driving_goals() == {"rover": goal}


@pytest.mark.parametrize(
    ("u", "v"), [(-0.1, 5), (640, 5), (5, 480), (5, -1), (math.nan, 5), (5, math.inf), (-math.inf, math.nan)]
)
def test_goals_outside_the_picture_change_nothing(mission: Mission, u: float, v: float) -> None:
    before = mission.set_goal("rover", 1, 2, size_px=SIZE)
    with pytest.raises(GoalError, match="outside the picture"):
        mission.set_goal("rover", u, v, size_px=SIZE)
    assert mission.of("rover").goal == before


def test_unknown_robots_are_refused(mission: Mission) -> None:
    for call in (mission.of, mission.stop, mission.resume, mission.drop_goal):
        with pytest.raises(UnknownRobotError, match="configured are rover, cart"):
            call("nobody")
    with pytest.raises(UnknownRobotError):
        mission.set_goal("nobody", 1, 1, size_px=SIZE)


def test_names_must_fit_into_keys() -> None:
    with pytest.raises(ConfigError):
        Mission(["a/b"])


def test_a_stop_latches_drops_the_goal_and_raises_the_epoch(mission: Mission) -> None:
    goal = mission.set_goal("rover", 1, 2, size_px=SIZE)
    first = mission.number_plan("rover", goal.id)
    assert first is not None
    stopped = mission.stop("rover")
    assert (stopped.epoch, stopped.goal, stopped.stopped) == (first.epoch + 1, None, True)
    assert mission.number_plan("rover", goal.id) is None
    with pytest.raises(StoppedError):
        mission.set_goal("rover", 1, 2, size_px=SIZE)
    mission.resume("rover")
    assert mission.of("rover").goal is None
    again = mission.set_goal("rover", 1, 2, size_px=SIZE)
    assert mission.number_plan("rover", again.id) == (first.epoch + 1, 1)


def test_plans_are_numbered_for_the_newest_goal_only(mission: Mission) -> None:
    old = mission.set_goal("rover", 1, 2, size_px=SIZE)
    new = mission.set_goal("rover", 3, 4, size_px=SIZE)
    assert mission.number_plan("rover", old.id) is None
    numbers = [mission.number_plan("rover", new.id) for _ in range(3)]
    assert [number.seq for number in numbers if number] == [1, 2, 3]


@pytest.mark.parametrize(
    ("size", "offset_px", "arrives"), [((640, 480), 20.0, True), ((640, 480), 20.1, False), ((1280, 720), 39.9, True)]
)
def test_arrival_is_20_px_in_a_picture_640_wide(
    mission: Mission, size: tuple[int, int], offset_px: float, arrives: bool
) -> None:
    goal = mission.set_goal("rover", 300, 200, size_px=size)
    assert mission.note_position("rover", (300 + offset_px, 200), size_px=size) is arrives
    assert mission.of("rover").arrived is arrives
    assert (mission.number_plan("rover", goal.id) is None) is arrives
    assert ("rover" not in mission.driving_goals()) is arrives


def test_everything_survives_a_restart_and_epochs_rise(mission: Mission, tmp_path: Path) -> None:
    goal = mission.set_goal("rover", 160.5, 360, size_px=SIZE)
    mission.stop("cart")
    after = restarted(tmp_path)
    assert after.of("rover").goal == goal
    assert after.of("cart").stopped
    assert after.of("cart").order == "stop"
    for robot in ("rover", "cart"):
        assert after.of(robot).epoch == mission.of(robot).epoch + 1
    # A start without the robot in between does not lose it.
    restarted(tmp_path, "cart")
    assert restarted(tmp_path).of("rover").goal == goal


def test_a_halted_robot_is_owed_a_resume_after_the_restart(mission: Mission, tmp_path: Path) -> None:
    goal = mission.set_goal("rover", 1, 2, size_px=SIZE)
    halted = mission.halt("rover")
    after = restarted(tmp_path).of("rover")
    assert (after.goal, after.order, after.stopped) == (goal, "resume", False)
    assert after.epoch > halted.epoch


def test_a_confirmation_counts_for_its_own_order_only(mission: Mission) -> None:
    stop = mission.stop("rover")
    resume = mission.resume("rover")
    mission.confirm("rover", stop)
    assert mission.of("rover").order == "resume"
    mission.confirm("rover", resume)
    assert mission.of("rover").order is None


def test_a_robot_ahead_is_believed_within_reason(mission: Mission) -> None:
    mission.catch_up("rover", 41)
    assert mission.of("rover").epoch == 42
    for epoch in (7, 41, 42, 2**60, -1):
        mission.catch_up("rover", epoch)
        assert mission.of("rover").epoch == 42


def test_a_robot_that_obeyed_another_server_in_this_epoch_gets_a_newer_one(mission: Mission) -> None:
    epoch = mission.of("rover").epoch
    mission.catch_up("rover", epoch)  # whose plans it knows nobody can say: it is heard for the first time
    assert mission.of("rover").epoch == epoch + 1
    mission.catch_up("rover", epoch + 1)
    assert mission.of("rover").epoch == epoch + 1


def test_the_highest_epoch_that_is_believed_survives_restarts(mission: Mission, tmp_path: Path) -> None:
    mission.catch_up("rover", MAX_EPOCH - 1)
    for _ in range(3):
        assert restarted(tmp_path).of("rover").epoch > MAX_EPOCH - 1


@pytest.mark.parametrize(
    "text", ["", "{", "[]", '{"format":2,"robots":{}}', '{"format":1,"robots":{"rover":{"epoch":-1}}}']
)
def test_a_malformed_state_file_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "state.json"
    path.write_text(text)
    with pytest.raises(FileError, match=r"state\.json"):
        Mission(["rover"], state_file=path)
    assert path.read_text() == text


def test_a_stop_holds_though_it_cannot_be_written(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    mission = Mission(["rover"], state_file=folder / "state.json")
    (folder / "state.json").unlink()
    folder.rmdir()
    folder.write_text("a file stands in the way")
    mission.stop("rover")
    assert mission.of("rover").stopped
    assert mission.save_error is not None
    folder.unlink()
    mission.resume("rover")
    assert mission.save_error is None
    assert json.loads((folder / "state.json").read_text())["robots"]["rover"]["stopped"] is False


def test_no_partial_files_are_left(mission: Mission, tmp_path: Path) -> None:
    for u in range(20):
        mission.set_goal("rover", u, 2, size_px=SIZE)
    assert [path.name for path in tmp_path.iterdir()] == ["state.json"]


def test_a_resume_that_was_never_confirmed_does_not_release_a_stop_of_another_server(mission: Mission) -> None:
    mission.catch_up("rover", 1)
    mission.stop("rover")
    mission.resume("rover")
    assert mission.of("rover").order == "resume"
    mission.catch_up("rover", 40)
    assert (mission.of("rover").order, mission.of("rover").epoch) == (None, 41)
    mission.stop("rover")
    mission.catch_up("rover", 50)
    assert (mission.of("rover").order, mission.of("rover").stopped) == ("stop", True)


def test_an_equal_epoch_of_a_robot_that_another_led_meanwhile_may_be_the_others(mission: Mission) -> None:
    mission.catch_up("rover", 0)
    epoch = mission.of("rover").epoch
    mission.catch_up("rover", epoch)
    assert mission.of("rover").epoch == epoch
    mission.leave_to_another("rover")
    mission.catch_up("rover", epoch)
    assert mission.of("rover").epoch == epoch + 1
