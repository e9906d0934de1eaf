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


@pytest.fixture
def clock_s():
    times = iter((10.0, 22.5, 25.0))
    return lambda: next(times)


def test_a_change_is_one_line_with_commands_ages_and_counters(caplog, clock_s):
    caplog.set_level(logging.INFO)
    log = ReasonLog(clock_s)
    log.write(None, Velocity(0.1, 0.0), STATE | {"plan_age_ms": 90.0, "odometry_age_ms": 12.0})
    log.keep(Velocity(0.42, -0.1))
    log.write("plan is 0.6 s old", STANDSTILL, STATE)
    assert [record.getMessage() for record in caplog.records] == [
        "driving; commanded 0.10 m/s +0.00 rad/s after 0.00 m/s +0.00 rad/s; stood 12.5 s before; "
        "ages plan 90.0 ms, scan 43.0 ms, odometry 12.0 ms; refused 2, malformed 1, failures 0",
        "stopped: plan is 0.6 s old; commanded 0.00 m/s +0.00 rad/s after 0.42 m/s -0.10 rad/s; drove 2.5 s before; "
        "ages plan 612.0 ms, scan 43.0 ms, odometry none; refused 2, malformed 1, failures 0",
    ]


def test_a_robot_that_gets_itself_out_is_not_called_stopped(caplog, clock_s):
    caplog.set_level(logging.INFO)
    log = ReasonLog(clock_s)
    log.write("stuck: backing off", Velocity(-0.15, 0.0), STATE)
    log.write("scan is 0.4 s old", STANDSTILL, STATE)
    first, second = (record.getMessage() for record in caplog.records)
    assert first.startswith("stuck: backing off; commanded -0.15 m/s")
    assert "; drove 2.5 s before; " in second


def test_as_json_the_parts_are_fields(caplog, clock_s):
    caplog.set_level(logging.INFO)
    ReasonLog(clock_s).write("scan is 0.4 s old", STANDSTILL, STATE)
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
