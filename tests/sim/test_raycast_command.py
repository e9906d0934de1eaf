from __future__ import annotations

import json

from revnm_sim.cli import main


def test_it_compares_the_renderers_in_one_run(tmp_path, capsys) -> None:
    options = ["--world", "demo_room", "--size", "64x48", "--images", "3", "--out", str(tmp_path)]
    assert main(["raycast", *options]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    rows = {row["renderer"]: row for row in report["rows"]}
    assert {"raycast", "pybullet"} <= set(rows)
    assert all(row["images"] == 3 and row["p95_ms"] >= row["p50_ms"] > 0.0 for row in rows.values())
    assert rows["pybullet"]["times_pybullet"] == 1.0
    assert rows["raycast"]["times_pybullet"] > 1.0
    assert "images_per_s" in capsys.readouterr().out


def test_an_impossible_size_is_told(tmp_path, capsys) -> None:
    assert main(["raycast", "--size", "64", "--out", str(tmp_path / "out")]) == 2
    assert "--size 64: expected WIDTHxHEIGHT" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
