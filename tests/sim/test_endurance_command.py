"""A real server whose camera fails, as ``revnm-sim endurance`` runs it; and what its table makes of the rows."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from revnm_sim import cli
from revnm_sim.endurance_command import verdict_of


def row(rss_mb: float, threads: int, *, recovery_s: float = 0.5) -> dict[str, float]:
    return {"rss_mb": rss_mb, "threads": threads, "faults": 3, "slowest_recovery_s": recovery_s, "arrivals": 1}


def test_growth_is_of_the_last_third_against_the_first_after_warm_up() -> None:
    rows = [row(100.0, 9), row(200.0, 20), row(201.0, 21, recovery_s=2.5), *[row(200.0, 22)] * 5, *[row(210.0, 20)] * 3]
    verdict = verdict_of(rows, 3.21, contact=False)
    assert verdict["rss_growth_percent"] == 5.0
    assert (verdict["threads_first"], verdict["threads_most"], verdict["threads_last"]) == (21, 22, 20)
    assert (verdict["faults"], verdict["slowest_recovery_s"], verdict["arrivals"]) == (33, 2.5, 11)


@pytest.mark.parametrize("options", [["--minutes", "0"], ["--every", "2"], ["--seed", "-1"]])
def test_what_makes_no_sense_is_refused(options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert cli.main(["endurance", *options, "--out", str(tmp_path)]) == 2
    assert "expected --minutes over 0" in capsys.readouterr().err


@pytest.mark.slow
def test_a_server_outlives_its_camera_s_faults(tmp_path: Path) -> None:
    assert cli.main(["endurance", "--minutes", "1", "--every", "8", "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    verdict = report["rows"][-1]
    assert verdict["faults"] >= 8
    assert not verdict["contact"]
    assert verdict["threads_last"] <= verdict["threads_most"]
    assert verdict["slowest_recovery_s"] < 5.0
