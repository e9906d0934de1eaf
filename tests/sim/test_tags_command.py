from __future__ import annotations

import json

import numpy as np

from revnm_server.tag import open_tag_library
from revnm_server.tag.library import whole_picture
from revnm_sim.cli import main
from revnm_sim.measures.tag_bench import detection_rows
from revnm_sim.measures.tag_scene import DIFFICULTIES, Difficulty, tag_scene
from revnm_sim.tag_picture import TagPicture

CLEAR = Difficulty(max_tilt_deg=45.0, blur_px=0.4, noise=1.0, ink=20.0, paper=230.0)


def test_every_measure_has_rows(tmp_path, capsys) -> None:
    options = ["--trials", "0", "--timed", "1", "--pictures", "5", "--library", "apriltag", "--out", str(tmp_path)]
    assert main(["tags", *options]) == 0
    rows = json.loads((tmp_path / "report.json").read_text())["rows"]
    times = [row for row in rows if row["measure"] == "time"]
    assert {(row["width_px"], row["mode"]) for row in times} >= {(640, "search_enlarged"), (1920, "follow_20_px")}
    assert all(row["p95_cpu_ms"] >= row["p50_cpu_ms"] > 0.0 for row in times)
    free = [row for row in rows if row["measure"] == "wrong_ids"]
    assert sum(row["pictures"] for row in free) == 5
    assert all(row["wrong_ids"] == 0 for row in free)
    assert "wrong_ids" in capsys.readouterr().out


def test_large_tags_are_found_and_tiny_ones_are_not() -> None:
    rows = {
        (row["mode"], row["side_px"], row["difficulty"]): row
        for row in detection_rows([open_tag_library("apriltag").library], trials=3, seed=1, sides_px=(6, 40))
    }
    for mode in ("search_full", "search_enlarged", "first_sighting", "follow"):
        assert rows[mode, 40, "easy"]["detection_rate"] == 1.0
        assert rows[mode, 6, "hard"]["detection_rate"] == 0.0
        assert rows[mode, 6, "hard"]["p50_corner_error_px"] is None
    assert rows["search_full", 40, "easy"]["p95_corner_error_px"] < 0.5


def test_the_drawn_tag_is_where_the_scene_says() -> None:
    # Oracle: the AprilTag library, in pictures with hardly any blur and noise.
    rng = np.random.default_rng(2)
    library = open_tag_library("apriltag").library
    errors = []
    for _ in range(6):
        scene = tag_scene(TagPicture(3), side_px=40, size_px=(160, 140), difficulty=CLEAR, rng=rng)
        (found,) = library.detect(whole_picture(scene.taken(CLEAR, rng), decimation=1.0))
        assert np.linalg.norm(found.pixel - scene.pixel) < 0.3
        errors.append(found.corners - scene.corners)
    assert np.abs(errors).max() < 0.5
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.1
    assert set(DIFFICULTIES) == {"easy", "medium", "hard"}


def test_an_unknown_library_is_told(tmp_path, capsys) -> None:
    assert main(["tags", "--library", "aruco", "--out", str(tmp_path / "out")]) == 2
    assert "--library aruco: expected apriltag or opencv" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
