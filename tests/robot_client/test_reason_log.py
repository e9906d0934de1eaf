"""What the log of a drive says, as text and as JSON."""

from __future__ import annotations

import json
import logging

import pytest

from revnm_client.log_output import HeldLog, JsonFormatter, start_log
from revnm_client.messages import STANDSTILL, Velocity
from revnm_client.reason_log import ReasonLog, condition
from revnm_client.settings import LogSettings

STATE = {
    "plan_age_ms": 612.0,
    "scan_age_ms": 43.0,
    "odometry_age_ms": None,
    "rejected": 2,
    "malformed": 1,
    "tick_failures": 0,
    "goal_id": "g",
    "plan_seq": 7,
    "v_mps": 0.0,
    "w_radps": 0.0,
}


REASON = "not started yet"


class Clock:
    """A clock that stands until it is moved."""

    def __init__(self):
        self.now_s = 0.0

    def __call__(self):
        return self.now_s


@pytest.fixture
def clock():
    return Clock()


def tick(log, reason, commanded, state=STATE):
    if log.due(reason):
        log.write(reason, commanded, state)
    log.keep(commanded)


def written(log, clock, reasons, caplog, period_s=0.05):
    """Return the lines of a drive with these reasons, a tick each."""
    caplog.set_level(logging.INFO)
    caplog.clear()
    for reason in reasons:
        tick(log, reason, STANDSTILL if reason else Velocity(0.1, 0.0))
        clock.now_s += period_s
    return [record.getMessage() for record in caplog.records]


def test_a_change_is_one_line_with_commands_ages_and_counters(caplog, clock):
    caplog.set_level(logging.INFO)
    log = ReasonLog(REASON, clock)
    clock.now_s = 12.5
    tick(log, None, Velocity(0.1, 0.0), STATE | {"plan_age_ms": 90.0, "odometry_age_ms": 12.0})
    tick(log, None, Velocity(0.42, -0.1))
    clock.now_s = 15.0
    tick(log, "plan is 0.6 s old", STANDSTILL)
    assert [record.getMessage() for record in caplog.records] == [
        "driving; commanded 0.10 m/s +0.00 rad/s after 0.00 m/s +0.00 rad/s; stood 12.5 s before; "
        "ages plan 90.0 ms, scan 43.0 ms, odometry 12.0 ms; refused 2, malformed 1, failures 0",
        "stopped: plan is 0.6 s old; commanded 0.00 m/s +0.00 rad/s after 0.42 m/s -0.10 rad/s; drove 2.5 s before; "
        "ages plan 612.0 ms, scan 43.0 ms, odometry none; refused 2, malformed 1, failures 0",
    ]


def test_a_robot_that_gets_itself_out_is_not_called_stopped(caplog, clock):
    caplog.set_level(logging.INFO)
    log = ReasonLog(REASON, clock)
    tick(log, "stuck: backing off", Velocity(-0.15, 0.0))
    clock.now_s = 2.5
    tick(log, "scan is 0.4 s old", STANDSTILL)
    first, second = (record.getMessage() for record in caplog.records)
    assert first.startswith("stuck: backing off; commanded -0.15 m/s")
    assert "; drove 2.5 s before; " in second


def test_every_change_of_a_usual_drive_has_its_line(caplog, clock):
    log = ReasonLog(REASON, clock)
    drive = [REASON, *["no plan yet"] * 20, *[None] * 200, "plan is 0.6 s old", "plan is 0.7 s old", *[None] * 100]
    starts = [line.split(";")[0] for line in written(log, clock, drive, caplog)]
    assert starts == ["stopped: no plan yet", "driving", "stopped: plan is 0.6 s old", "driving"]


def test_a_condition_that_comes_and_goes_does_not_fill_the_log(caplog, clock):
    log = ReasonLog(REASON, clock)
    flapping = [None, "scan is 0.3 s old"] * 600  # a minute
    lines = written(log, clock, flapping, caplog)
    assert len(lines) <= 6 + 60.0 * 0.2
    left_out = [int(line.split(" changes left out")[0].rsplit(" ", 1)[1]) for line in lines if " left out" in line]
    assert 1190 - 110 <= sum(left_out) + len(lines) <= 1200  # the last ones are told by the next line


def test_what_lasts_after_too_many_changes_is_told_late_and_with_what_was_when_it_began(caplog, clock):
    log = ReasonLog(REASON, clock)
    written(log, clock, ["scan is 0.3 s old", None] * 4, caplog, 0.1)  # more than may be written at once
    lines = written(log, clock, ["stopped until it is resumed"] * 100, caplog, 0.1)
    [line] = lines
    told, since, after, drove, left_out, *_ = line.split("; ")
    assert (told, since[:8]) == ("stopped: stopped until it is resumed", "since 4.")
    assert after.endswith(" after 0.10 m/s +0.00 rad/s")
    assert (drove, left_out) == ("drove 0.1 s before", "2 changes left out")


def test_as_json_the_parts_are_fields(caplog, clock):
    caplog.set_level(logging.INFO)
    log = ReasonLog(REASON, clock)
    clock.now_s = 12.5
    tick(log, "scan is 0.4 s old", STANDSTILL)
    fields = json.loads(JsonFormatter().format(caplog.records[0]))
    assert (fields["level"], fields["logger"]) == ("INFO", "revnm_client.reason_log")
    assert fields["message"].startswith("stopped: scan is 0.4 s old; ")
    assert (fields["reason"], fields["lasted_s"], fields["plan_age_ms"]) == ("scan is 0.4 s old", 12.5, 612.0)
    assert (fields["odometry_age_ms"], fields["malformed"], fields["goal_id"]) == (None, 1, "g")
    assert fields["time"][10] == "T"


def test_json_holds_a_traceback_and_stays_one_line(caplog):
    try:
        raise ZeroDivisionError("a\nbug")
    except ZeroDivisionError:
        logging.getLogger("x").exception("failed at %s", "noon")
    line = JsonFormatter().format(caplog.records[0])
    assert "\n" not in line
    assert "ZeroDivisionError" in json.loads(line)["exc_info"]
    assert json.loads(line)["message"] == "failed at noon"


def test_a_growing_age_is_one_condition():
    assert (
        condition("plan is 0.6 s old") == condition("plan is 10.0 s old") != condition("no plan yet") != condition(None)
    )


def test_a_held_log_is_written_when_it_is_closed(capsys, monkeypatch):
    root = logging.RootLogger(logging.WARNING)
    monkeypatch.setattr(logging, "root", root)
    held = HeldLog()
    start_log(LogSettings(level="warning"), held)
    root.info("quiet")
    for index in range(300):
        root.warning("line %d", index)
    assert capsys.readouterr().err == ""
    held.close()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 200
    assert lines[-1].endswith("line 299")
    held.close()
    assert capsys.readouterr().err == ""
