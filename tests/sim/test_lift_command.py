"""``revnm-sim lift``: the truth it compares with, by hand, and the report."""

from __future__ import annotations

import json
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from revnm_client.geometry import Pose2
from revnm_server.mapping.floor_view import floor_view
from revnm_server.mapping.lift import FloorLifter, Lifted
from revnm_server.mapping.map_window import WindowSpec
from revnm_sim.bench.protocol import draw_setting
from revnm_sim.camera import Camera
from revnm_sim.cli import main
from revnm_sim.measures.lift_faults import CALIBRATIONS, DEPTHS
from revnm_sim.measures.lift_trial import HW
from revnm_sim.measures.lift_truth import exact_calibration, score, true_window
from revnm_sim.occupancy import occupancy
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth
from revnm_sim.world import Bounds, Primitive, Shape, World, primitive_arrays

SPEC = WindowSpec()
EYE = Camera(640, 480, math.radians(90.0), (0.0, 0.0, 2.5), 0.0, math.radians(32.0))
CABINET = Primitive(Shape.BOX, (4.0, 0.0, 0.5), (0.36, 0.36, 1.0), 0.0, (90, 90, 90))
WORLD = World("w", Bounds(-1.0, -5.0, 9.0, 5.0), (200, 200, 200), (CABINET,))


def truth():
    fine = occupancy(WORLD, resolution_m=0.02)
    return true_window(primitive_arrays(WORLD.obstacles), fine, EYE, Pose2(3.0, 0.0, 0.0), (96, 128), SPEC)


def cell(x: float, y: float) -> tuple[int, int]:
    """Of a place in the robot's frame."""
    return round(47.5 - x / 0.1), round(47.5 - y / 0.1)


def test_a_cabinet_is_occupied_where_it_stands_and_hides_what_is_behind():
    # Robot at x = 3: the cabinet is 0.82 to 1.18 m ahead; its near face and its lid are seen. It hides the floor from
    # 4.18 m to 4.18 · 2.5 / 1.5 = 6.97 m before the eye: up to 4 m ahead of the robot.
    found = truth()
    inside, behind, beside = cell(1.05, 0.05), cell(2.05, 0.05), cell(1.05, 1.05)
    assert [bool(found.occupied[c]) for c in (inside, behind, beside)] == [True, False, False]
    assert [bool(found.visible[c]) for c in (inside, behind, beside)] == [True, False, True]
    assert not found.near[cell(4.05, 0.05)]
    ahead = found.occupied[:48]  # what lies outside the world is occupied, too: it begins 4 m behind
    assert ahead.sum() == 16  # 0.82 to 1.18 m ahead: four cells each way


def test_a_perfect_map_scores_full_and_an_error_of_two_cells_does_not():
    found = truth()
    obstacle = np.where(found.occupied, 0.9, 0.1).astype(np.float32)
    floor = found.visible.astype(np.float32)
    full = score(found, obstacle, floor)
    assert full.wanted == full.found > 0
    assert full.claimed == full.right > 0
    assert full.floor == full.open > 0
    near = score(found, np.roll(obstacle, 1, axis=1), floor)
    assert near.wanted == near.found
    far = score(found, np.roll(obstacle, 6, axis=1), floor)
    assert far.found < 0.5 * far.wanted
    assert far.right < 0.5 * far.claimed
    blind = score(found, np.full_like(obstacle, 0.5), floor)
    assert (blind.found, blind.claimed, blind.open) == (0, 0, 0)


def test_faults_have_the_sizes_that_they_say():
    exact, none = CALIBRATIONS["exact"].apply(EYE, np.random.default_rng(0))
    assert none is None
    wrong, told = CALIBRATIONS["all"].apply(EYE, np.random.default_rng(0))
    assert told is not None
    np.testing.assert_allclose(np.abs(wrong.vector - exact.vector), np.sqrt(np.diag(told)))
    rng, picture = np.random.default_rng(1), np.linspace(0.0, 1.0, 96 * 128, dtype=np.float32).reshape(96, 128)
    flat = DEPTHS["exact"].apply(picture, DEPTHS["exact"].field((96, 128), rng), rng)
    residual = flat - np.polyval(np.polyfit(picture.ravel(), flat.ravel(), 1), picture)
    assert np.abs(residual).max() < 1e-5


def test_the_command_writes_rows_that_meet_the_bars(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["lift", "--world", "random_pillar", "--case", "exact/exact,exact/noise_only", "--pairs", "1"]
    assert main([*words, "--out", str(tmp_path)]) == 0
    exact, noise = json.loads((tmp_path / "report.json").read_text())["rows"]
    assert exact["obstacle_recall"] >= 0.95
    assert exact["obstacle_precision"] >= 0.90
    assert exact["refused"] == 0
    assert noise["maps"] == 0
    assert noise["refused"] == exact["maps"] > 0
    assert "obstacle_recall" in capsys.readouterr().out
    picture = cv2.imread(str(tmp_path / "maps.png"))
    assert picture.shape[1] > picture.shape[0]  # disparity, truth and two cases, one row


def test_an_unknown_case_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["lift", "--case", "exact/perfect", "--out", str(tmp_path)]) == 2
    assert "exact/perfect" in capsys.readouterr().err


def test_floor_is_found_where_a_quarter_of_what_lies_below_the_horizon_is_floor() -> None:
    """Seen with a wide look, the furniture of this hall and its floor are one scattered plane."""
    setting = draw_setting("aisles", seed=7200, pair=7, cameras=1, rule="blocked")
    camera = setting.cameras[0]
    depth = cast_depth(primitive_arrays(setting.site.world.primitives), camera, HW)
    view = floor_view(exact_calibration(camera), HW)
    lifted = FloorLifter(view).lift(disparity_from_depth(depth), np.ones(HW, dtype=np.bool_))
    assert isinstance(lifted, Lifted)
    assert lifted.line.share < 0.35
    assert lifted.line.scale == pytest.approx(1.0, abs=1e-3)
    assert lifted.line.shift == pytest.approx(0.0, abs=1e-3)
