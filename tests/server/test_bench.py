"""``revnm-server bench``: its rows, what it makes of them, and what it says where something is missing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from revnm_client.geometry import FloatArray
from revnm_server.cli import main
from revnm_server.frame import Frame
from revnm_server.networks.bundle import load_bundle
from revnm_server.observation import Image32
from revnm_server.ports import EgoRequest, PlanRequest
from revnm_server.speed.baseline import Networks, run_networks
from revnm_server.speed.tables import one_after_the_other, stage_rows, summary
from revnm_server.stages.exo2ego import OnnxExo2Ego
from revnm_server.stages.policy import OnnxPolicy

from .tiny_bundle import write_tiny_bundle

KEYS = {"preset", "robots", "stage", "backend", "ticks", "p50_ms", "p95_ms"}


def test_both_kinds_of_pipelines_are_driven_and_every_stage_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = write_tiny_bundle(tmp_path / "tiny", history=5)
    options = ["--preset", "edge,tiny", "--bundle", str(tiny), "--robots", "2", "--ticks", "5", "--no-baseline"]
    assert main(["bench", *options, "--out", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert {frozenset(row) for row in report["rows"]} == {frozenset(KEYS)}
    stages = {name: [row["stage"] for row in report["rows"] if row["preset"] == name] for name in ("edge", "tiny")}
    assert stages["edge"] == ["depth", "tag", "map", "exo2ego", "policy", "learn", "tick"]
    assert stages["tiny"] == ["depth", "tag", "exo2ego", "policy", "tick"]
    assert all(row["ticks"] == 5 and 0.0 < row["p50_ms"] <= row["p95_ms"] for row in report["rows"])
    assert [row["preset"] for row in report["summary"]] == ["edge", "tiny"]
    assert set(report) == {"rows", "summary", "command", "versions", "machine"}
    assert report["command"].startswith("revnm-server bench --preset edge,tiny --bundle ")
    assert "| edge   | 2      | tick    | onnxruntime |" in capsys.readouterr().out


def test_a_preset_without_a_bundle_is_told_how_to_get_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "--preset", "paper", "--out", str(tmp_path / "out")]) == 2
    assert "revnm-train export --preset paper --random-weights --out paper" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--robots", "1,x"], "--robots 1,x: expected numbers from 1 to 64"),
        (["--robots", "0"], "--robots 0: expected"),
        (["--ticks", "0"], "--ticks 0: expected at least 1"),
        (["--longest", "nan"], "--longest nan: expected at least 1"),
    ],
)
def test_options_that_make_no_sense(
    options: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", *options, "--out", str(tmp_path)]) == 2
    assert message in capsys.readouterr().err


def test_ratios_and_bars_are_those_of_the_rows() -> None:
    ours = [
        *stage_rows("edge", 1, "onnxruntime", _ticks(depth=8.0, tag=2.0, map=10.0, exo2ego=3.0, policy=5.0, tick=24.0))
    ]
    ours += stage_rows(
        "edge", 16, "onnxruntime", _ticks(depth=8.0, tag=9.0, map=60.0, exo2ego=30.0, policy=50.0, tick=97.0)
    )
    eager = one_after_the_other(_ticks(depth=32.0, exo2ego=12.0, policy=20.0), ours[:6])
    assert eager[0]["tick"] == 32.0 + 12.0 + 20.0 + 2.0 + 10.0
    found = {
        (row["robots"], row["what"]): (row["value"], row["met"])
        for row in summary([*ours, *stage_rows("edge", 1, "torch_eager", eager)])
    }
    assert found == {
        (1, "tick p50, ms"): (24.0, "yes"),
        (1, "tick, x torch_eager"): (round(76.0 / 24.0, 2), ""),
        (1, "networks, x torch_eager"): (4.0, "yes"),  # at least 4 is wanted
        (16, "tick p50, ms"): (97.0, ""),
        (16, "x one robot"): (round(97.0 / 24.0, 2), "no"),
    }


def test_percentiles() -> None:
    (row,) = stage_rows("edge", 1, "onnxruntime", [{"tick": float(value)} for value in range(101)])
    assert (row["p50_ms"], row["p95_ms"], row["ticks"]) == (50.0, 95.0, 101)


class Counting:
    """Another runtime that counts what it is asked."""

    def __init__(self, exo2ego: OnnxExo2Ego, policy: OnnxPolicy) -> None:
        self.frames = 0
        self.egos: list[int] = []
        self._exo2ego, self._policy = exo2ego, policy

    def disparity(self, frame: Frame) -> Image32:
        self.frames += 1
        return np.zeros((1, 1), dtype=np.float32)

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        self.egos.append(len(requests))
        return self._exo2ego.synthesise(requests)

    def waypoints(self, requests: Sequence[PlanRequest]) -> FloatArray:
        return self._policy.waypoints(requests)


def test_another_runtime_gets_requests_that_the_networks_take(tmp_path: Path) -> None:
    bundle = load_bundle(write_tiny_bundle(tmp_path / "tiny", history=5), threads=1)
    other = Counting(OnnxExo2Ego(bundle), OnnxPolicy(bundle))
    found = run_networks(Networks("fake", other, other, other), bundle, robots=4, rounds=6, longest_s=60.0)
    assert (other.frames, other.egos) == (7, [4] * 7)  # the first one warms up
    assert [set(each) for each in found] == [{"depth", "exo2ego", "policy"}] * 6


def _ticks(**taken_ms: float) -> list[dict[str, float]]:
    return [dict(taken_ms)] * 3
