"""A minute of the whole: real processes, real faults."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from revnm_sim import cli


@pytest.mark.parametrize("options", [["--minutes", "0"], ["--every", "2"], ["--seed", "-1"]])
def test_what_makes_no_sense_is_refused(options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert cli.main(["soak", *options, "--out", str(tmp_path)]) == 2
    assert "expected --minutes over 0" in capsys.readouterr().err


@pytest.mark.slow
def test_a_minute_of_goals_and_faults(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    status = cli.main(["soak", "--minutes", "1", "--every", "8", "--out", str(tmp_path)])
    report, said = json.loads((tmp_path / "report.json").read_text()), capsys.readouterr().out
    verdict = report["rows"][-1]
    assert len(report["rows"]) == 11
    assert verdict["contacts"] == 0
    assert verdict["faults"] == sum(row["count"] for row in report["faults"]) >= 1
    assert verdict["server_growth_percent"] is None  # too short a time
    assert "slowest_recovery_s" in said
    assert (status == 0) == said.endswith("\nall bars hold\n")  # a minute may be too short for a goal
