from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import FileError
from revnm_sim.generation.generator import random_pillar
from revnm_sim.world import Shape, primitive_arrays
from revnm_sim.world_file import load_site, save_world

DOCS = Path(__file__).parents[2] / "docs" / "world-format.md"


@pytest.fixture
def example() -> str:
    found = re.search(r"```yaml\n(.*?)```", DOCS.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    return found[1]


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "site.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_documented_example_loads(tmp_path: Path, example: str) -> None:
    world = load_site(write(tmp_path, example)).world
    assert world.name == "two-shelves"
    assert world.bounds == (-3.0, -2.0, 3.0, 2.0)
    assert world.floor_colour == (190, 185, 175)
    assert len(world.primitives) == 2 + 2 + 1 + 1 + 1
    # The second shelf stands at (1.2, −0.4), turned by 90°: its small box at (0, 0.3) comes to (0.9, −0.4).
    small = world.primitives[3]
    assert small.shape is Shape.BOX
    assert small.centre_m == pytest.approx((0.9, -0.4, 0.1))
    assert small.yaw_rad == pytest.approx(math.radians(105.0))
    bin_ = world.primitives[4]
    assert bin_.shape is Shape.CYLINDER
    assert bin_.size_m == (0.35, 0.35, 0.5)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_saved_world_loads_again(tmp_path: Path, seed: int) -> None:
    world = random_pillar(seed)
    save_world(world, tmp_path / "world.yaml")
    again = load_site(tmp_path / "world.yaml").world
    assert (again.name, again.bounds, again.floor_colour) == (world.name, world.bounds, world.floor_colour)
    assert [p.colour for p in again.primitives] == [p.colour for p in world.primitives]
    for ours, theirs in zip(primitive_arrays(world.primitives), primitive_arrays(again.primitives), strict=True):
        is_circle = np.array([p.shape is Shape.CYLINDER for p in world.primitives])
        assert ours[~is_circle] == pytest.approx(theirs[~is_circle], abs=1e-12)
    for ours, theirs in zip(world.primitives, again.primitives, strict=True):
        assert ours.centre_m == pytest.approx(theirs.centre_m, abs=1e-12)
        assert ours.size_m == theirs.size_m


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("size_m: [1.2, 0.4, 1.2]", "size_m: [1.2, -0.4, 1.2]"), ":7: prefabs.shelf[0].size_m[1]: .*greater than 0"),
        (("size_m: [1.2, 0.4, 1.2]", "size_m: [1.2, .nan, 1.2]"), r":7: prefabs.shelf[0].size_m[1]: .*got nan"),
        (("size_m: [1.2, 0.4, 1.2]", "size_m: [1.2, 1.2]"), r":7: prefabs.shelf[0].size_m[2]: is missing"),
        (("diameter_m: 0.35", "radius: 0.35"), r":10: prefabs.bin[0].diameter_m: is missing"),
        (("yaw_deg: 90.0", "yaw: 90.0"), r":15: placements[1].yaw: is no key"),
        (("yaw_deg: 90.0", "yaw_deg: east"), r":15: placements[1].yaw_deg: .*valid number, got 'east'"),
        (("prefab: bin", "prefab: barrel"), r":16: placements[2].prefab: .*bin, long-wall, shelf.*'barrel'"),
        (("shape: cylinder", "shape: sphere"), r":10: prefabs.bin[0]: .*'sphere'.*'box', 'cylinder'"),
        (("format: 1", "format: 2"), r":1: format: .*should be 1, got 2"),
        (("190, 185", "190, 300"), r":4: floor.colour[1]: .*255, got 300"),
        (("x_max_m: 3.0", "x_max_m: -4.0"), r":3: bounds: expected x_min_m < x_max_m"),
        (("x_max_m: 3.0, ", ""), r":3: bounds.x_max_m: is missing"),
        (("name: two-shelves", "name: two-shelves\nname: three"), r":3: name: .*second time"),
        (("name: two-shelves", "name: two shelves"), r":2: name: .*pattern"),
        (("floor: {colour: [190, 185, 175]}", "floor: 3"), r":4: floor: expected keys with values, got 3"),
        (("colour: [190, 185, 175]", "colour: &a [1, 2, 3], x: *a"), r":4: *a: expected the value itself"),
        (("format: 1", "format: [1"), r":2: is no YAML"),
        (("format: 1", "format: !!python/object:os.system 1"), r":1: is no YAML"),
    ],
)
def test_what_is_wrong_is_said_with_line_and_key(
    tmp_path: Path, example: str, change: tuple[str, str], message: str
) -> None:
    assert change[0] in example
    path = write(tmp_path, example.replace(*change, 1))
    with pytest.raises(FileError) as raised:
        load_site(path)
    pattern = re.escape(str(path)) + re.escape(message).replace(r"\.\*", ".*")
    assert re.match(pattern, str(raised.value)), raised.value


@pytest.mark.parametrize("text", ["", "- 1\n- 2\n", "7", "[" * 3000, "a: {b: " * 3000])
def test_what_is_no_world_at_all_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(FileError, match=r"site\.yaml"):
        load_site(write(tmp_path, text))


def test_a_file_that_is_no_text_or_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"nowhere\.yaml: cannot be read"):
        load_site(tmp_path / "nowhere.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(FileError, match=r"binary\.yaml"):
        load_site(tmp_path / "binary.yaml")


def test_too_many_primitives_are_refused(tmp_path: Path, example: str) -> None:
    part = next(line for line in example.splitlines() if "cylinder" in line) + "\n"
    heavy = example.replace(part, part * 200).replace(
        "cameras:", "  - {prefab: bin, x_m: 0.0, y_m: 0.0}\n" * 50 + "cameras:"
    )
    with pytest.raises(FileError, match=r"placements\[\d+\]: expected at most 10000"):
        load_site(write(tmp_path, heavy))
