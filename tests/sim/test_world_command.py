from __future__ import annotations

from pathlib import Path

import cv2
import pytest
from matplotlib.figure import Figure

from revnm_sim.cli import main
from revnm_sim.top_view import draw_top_view
from revnm_sim.world import Bounds, Primitive, Shape, World

SITE = """\
format: 1
name: yard
bounds: {x_min_m: -3.0, y_min_m: -2.0, x_max_m: 3.0, y_max_m: 2.0}
floor: {colour: [190, 185, 175]}
prefabs:
  bin:
    - {shape: cylinder, centre_m: [0.0, 0.0, 0.25], diameter_m: 0.35, height_m: 0.5, colour: [60, 90, 160]}
placements:
  - {prefab: bin, x_m: 0.0, y_m: 0.0}
cameras:
  - {x_m: -2.8, y_m: -1.8, z_m: 2.4, yaw_deg: 35.0, pitch_deg: 30.0}
pairs:
  - {start: {x_m: -2.0, y_m: -1.0, yaw_deg: 90.0}, goal: {x_m: 2.2, y_m: 1.0}}
"""


def test_show_writes_a_picture_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("site.yaml").write_text(SITE, encoding="utf-8")
    assert main(["world", "show", "site.yaml"]) == 0
    picture = cv2.imread("yard.png")
    assert picture is not None
    assert picture.shape == (700, 1500, 3)
    assert picture[:, 750:].std() > 10.0  # the camera's half is not empty


def test_show_draws_a_camera_where_the_file_has_none(tmp_path: Path) -> None:
    out = tmp_path / "drawn.png"
    assert main(["world", "show", "demo_room", "--seed", "3", "--out", str(out)]) == 0
    picture = cv2.imread(str(out))
    assert picture is not None
    assert picture[:, 750:].std() > 10.0


def test_what_cannot_be_shown_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["world", "show", "moon"]) == 2
    assert "'moon'" in capsys.readouterr().err
    (tmp_path / "site.yaml").write_text(SITE.replace("z_m: 2.4", "z_m: -2.4"), encoding="utf-8")
    assert main(["world", "show", str(tmp_path / "site.yaml")]) == 2
    assert "site.yaml:11: cameras[0]" in capsys.readouterr().err
    assert main(["world", "show", "demo_room", "--out", str(tmp_path / "none" / "a.png")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_the_top_view_draws_what_stands_highest_last() -> None:
    tall = Primitive(Shape.BOX, (1.0, 0.0, 1.5), (0.5, 1.0, 3.0), 0.5, (200, 0, 0))
    hanging = Primitive(Shape.CYLINDER, (0.0, 0.0, 1.0), (0.4, 0.4, 0.1), 0.0, (0, 200, 0))
    mat = Primitive(Shape.BOX, (0.0, 0.0, 0.002), (1.0, 1.0, 0.004), 0.0, (0, 0, 200))
    axes = Figure().subplots()
    draw_top_view(axes, World("w", Bounds(-2.0, -1.0, 2.0, 1.0), (100, 100, 100), (tall, hanging, mat)))
    floor, first, second, third = axes.patches
    assert [patch.get_facecolor()[3] for patch in (floor, first, second, third)] == [1.0, 1.0, 0.45, 1.0]
    assert [max(range(3), key=patch.get_facecolor().__getitem__) for patch in (first, second, third)] == [2, 1, 0]
    assert axes.get_xlim() == (-2.4, 2.4)
