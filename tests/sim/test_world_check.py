"""Worlds against measured layouts: agreement counted by hand, and malformed layouts refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from revnm_client.errors import FileError
from revnm_sim.cli import main
from revnm_sim.world import Bounds, Primitive, Shape, World
from revnm_sim.world_check import Layout, compare, load_layout
from revnm_sim.worlds import named_site

MEASURED = Path(__file__).parents[2].parent / "shared" / "worlds"
GREY = (128, 128, 128)
FLOOR_Z_M = 0.1


def document() -> dict[str, Any]:
    """A floor of 4 × 2 m whose east half is missing above y = 1, with a box of 1 × 1 m and 0.3 m, and a lamp."""
    return {
        "name": "small",
        "bounds": {"x": [0.0, 4.0], "y": [0.0, 2.0]},
        "floor_polygon": [[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [2.0, 1.0], [2.0, 2.0], [0.0, 2.0]],
        "floor_z": FLOOR_Z_M,
        "objects": [
            {"name": "b", "category": "crate", "shape": "box", "center": [0.5, 0.5, FLOOR_Z_M + 0.15]}
            | {"size": [0.98, 0.98, 0.3], "yaw": 0.0, "color": [1, 2, 3]}
        ],
        "overhead": [
            {"name": "l", "category": "lamp", "shape": "cylinder", "center": [1.5, 1.5, FLOOR_Z_M + 3.0]}
            | {"size": [0.4, 0.4, 0.2], "yaw": 0.0, "color": [1, 2, 3]}
        ],
    }


def write(tmp_path: Path, content: object) -> Path:
    path = tmp_path / "small.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def box(x: float, y: float, length: float, width: float, height: float = 0.3) -> Primitive:
    # 2 cm less than whole cells, so that it touches none of the next.
    return Primitive(Shape.BOX, (x, y, height / 2.0), (length - 0.02, width - 0.02, height), 0.0, GREY)


@pytest.fixture
def layout(tmp_path: Path) -> Layout:
    return load_layout(write(tmp_path, document()))


def test_heights_count_from_the_floor(layout: Layout) -> None:
    crate, lamp = layout.world.primitives
    assert crate.bottom_m == pytest.approx(0.0)
    assert lamp.centre_m[2] == pytest.approx(3.0)
    assert layout.categories == ("crate", "lamp")


def test_agreement_is_what_one_counts_by_hand(layout: Layout) -> None:
    # Ours: the same crate, the notch closed by a block, and one more box of 1 × 0.5 m, at x 3 to 4.
    world = World(
        "ours", Bounds(0.0, 0.0, 4.0, 2.0), GREY, (box(0.5, 0.5, 1, 1), box(3, 1.5, 2, 1), box(3.5, 0.25, 1, 0.5))
    )
    agreement = compare(world, layout)
    # Measured: 4 · 2 − 2 · 1 (notch) − 1 (crate) = 5 m² free; ours 0.5 m² less, all of it within.
    assert agreement.free_m2 == pytest.approx((4.5, 5.0))
    assert agreement.iou == pytest.approx(4.5 / 5.0)
    assert 0.5 < agreement.iou_inflated < 0.95
    assert agreement.covered["crate"] == (1.0, 1.0)
    assert agreement.covered["lamp"] == (0.0, 0.0)


def test_a_lower_crate_covers_the_footprint_but_not_the_volume(layout: Layout) -> None:
    world = World("ours", Bounds(0.0, 0.0, 4.0, 2.0), GREY, (box(0.5, 0.5, 1, 1, height=0.15),))
    footprint, volume = compare(world, layout).covered["crate"]
    # The crate reaches into the layers 0.05–0.20 and 0.20–0.35 m, ours into the first alone.
    assert (footprint, volume) == (1.0, 0.5)


def test_floor_beyond_our_bounds_is_not_free(layout: Layout) -> None:
    world = World("ours", Bounds(0.0, 0.0, 3.0, 2.0), GREY, (box(0.5, 0.5, 1, 1), box(3, 1.5, 2, 1)))
    assert compare(world, layout).free_m2[0] == pytest.approx(4.0)


def test_a_layout_agrees_with_itself_within_its_outline(layout: Layout) -> None:
    world = replace(layout.world, primitives=(*layout.world.primitives, box(3, 1.5, 2, 1)))
    agreement = compare(world, layout)
    assert (agreement.iou, agreement.iou_inflated) == (1.0, 1.0)
    assert set(agreement.covered.values()) == {(1.0, 1.0)}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("floor_z", None, r"floor_z: .*number, got None"),
        ("bounds", {"x": [1.0, 1.0], "y": [0.0, 1.0]}, "bounds: expected ranges"),
        ("floor_polygon", [[0.0, 0.0]], "floor_polygon: .*at least 3"),
        ("objects", [{"shape": "cone"}], r"objects\.0\.shape: .*'cone'"),
        ("objects", 3, "objects: .*got 3"),
    ],
)
def test_malformed_layouts_are_refused(tmp_path: Path, key: str, value: object, message: str) -> None:
    with pytest.raises(FileError, match=r"small\.json: " + message):
        load_layout(write(tmp_path, document() | {key: value}))


@pytest.mark.parametrize("text", ["{", "[" * 100_000, "[]", "7", '{"name": NaN}'])
def test_what_is_no_layout_at_all_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(FileError, match=r"small\.json"):
        load_layout(write(tmp_path, text))


def test_the_command_tells_agreement_by_its_exit_status(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured = write(tmp_path, document())
    assert main(["world", "check", "bookstore", "--against", str(measured)]) == 1
    assert "expected at least 0.97" in capsys.readouterr().out
    assert main(["world", "check", "bookstore", "--against", str(tmp_path / "none.json")]) == 2
    assert "cannot be read" in capsys.readouterr().err


@pytest.mark.skipif(not MEASURED.exists(), reason="the measured layouts are not here")
@pytest.mark.parametrize(("name", "measured"), [("bookstore", "bookstore"), ("warehouse", "small-warehouse")])
def test_the_scenes_agree_with_the_measurements(name: str, measured: str) -> None:
    agreement = compare(named_site(name, 0).world, load_layout(MEASURED / f"{measured}.json"))
    assert agreement.iou >= 0.985
    assert agreement.iou_inflated >= 0.97
    for category, (footprint, volume) in agreement.covered.items():
        assert footprint > 0.85, category
        assert volume > 0.8, category
