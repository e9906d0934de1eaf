"""Sites by name and by path, and what is wrong with the cameras and pairs of a world file."""

from __future__ import annotations

import hashlib
import math
import re
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ConfigError, FileError
from revnm_client.geometry import Pose2
from revnm_sim.generation.generator import random_pillar
from revnm_sim.robot import RobotSpec
from revnm_sim.site import Pair
from revnm_sim.site_checks import robot_touches
from revnm_sim.world import Primitive, Shape
from revnm_sim.world_file import load_site
from revnm_sim.worlds import WORLDS, is_generated, named_site

# A room of 6 × 4 m; a block of 1 × 1 m and 1 m high in the middle; a closed pen around (2, 1); a mat in the west.
ROOM = """\
format: 1
name: room
goal_radius_m: 0.7
bounds: {x_min_m: -3.0, y_min_m: -2.0, x_max_m: 3.0, y_max_m: 2.0}
floor: {colour: [190, 185, 175]}
prefabs:
  block:
    - {shape: box, centre_m: [0.0, 0.0, 0.5], size_m: [1.0, 1.0, 1.0], colour: [150, 110, 70]}
  post:
    - {shape: cylinder, centre_m: [0.0, 0.0, 0.5], diameter_m: 0.2, height_m: 1.0, colour: [150, 110, 70]}
  bar:
    - {shape: box, centre_m: [0.0, 0.0, 0.9], size_m: [0.2, 4.0, 0.1], colour: [150, 110, 70]}
  mat:
    - {shape: box, centre_m: [0.0, 0.0, 0.002], size_m: [1.0, 1.0, 0.004], colour: [150, 110, 70]}
  pen:
    - {shape: box, centre_m: [0.0, 0.5, 0.5], size_m: [1.1, 0.1, 1.0], colour: [150, 110, 70]}
    - {shape: box, centre_m: [0.0, -0.5, 0.5], size_m: [1.1, 0.1, 1.0], colour: [150, 110, 70]}
    - {shape: box, centre_m: [0.5, 0.0, 0.5], size_m: [0.1, 1.1, 1.0], colour: [150, 110, 70]}
    - {shape: box, centre_m: [-0.5, 0.0, 0.5], size_m: [0.1, 1.1, 1.0], colour: [150, 110, 70]}
placements:
  - {prefab: block, x_m: 0.0, y_m: 0.0}
  - {prefab: pen, x_m: 2.0, y_m: 1.0}
  - {prefab: mat, x_m: -2.0, y_m: 0.0}
  - {prefab: bar, x_m: 1.2, y_m: 0.0}
  - {prefab: post, x_m: -1.0, y_m: 1.5}
cameras:
  - {x_m: -2.5, y_m: -1.5, z_m: 2.0, yaw_deg: 30.0, pitch_deg: 20.0}
  - {x_m: -1.0, y_m: -1.9, z_m: 3.0, yaw_deg: 90.0, pitch_deg: 60.0, roll_deg: 5.0, width_px: 64, height_px: 48}
pairs:
  - {start: {x_m: -2.0, y_m: 0.0, yaw_deg: 180.0}, goal: {x_m: 2.5, y_m: -1.0}}
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "room.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_with_cameras_and_pairs_loads(tmp_path: Path) -> None:
    path = write(tmp_path, ROOM)
    site = named_site(str(path), 0)
    assert site.where == f"{path}:4: bounds"
    assert site.goal_radius_m == 0.7
    longer = ROOM.replace("goal_radius_m: 0.7\n", "goal_radius_m: 0.7\ndetour_m: 0.6\n")
    assert (site.detour_m, load_site(write(tmp_path, longer)).detour_m) == (0.1, 0.6)
    assert site.file_sha256 == hashlib.sha256(ROOM.encode()).hexdigest()
    first, second = site.cameras
    assert (first.width_px, first.height_px, first.roll_rad) == (640, 480, 0.0)
    assert first.hfov_rad == pytest.approx(math.radians(120.0))
    assert (second.width_px, second.height_px, second.position_m) == (64, 48, (-1.0, -1.9, 3.0))
    assert second.pitch_rad == pytest.approx(math.pi / 3.0)
    assert site.pairs == (Pair(Pose2(-2.0, 0.0, math.pi), (2.5, -1.0)),)


def test_what_a_file_leaves_out_is_drawn(tmp_path: Path) -> None:
    site = load_site(write(tmp_path, ROOM[: ROOM.index("cameras:")].replace("goal_radius_m: 0.7\n", "")))
    assert (site.goal_radius_m, site.cameras, site.pairs) == (0.5, (), ())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("z_m: 2.0", "z_m: 0.0", r":27: cameras\[0\]: .*over the floor.*-1\.5, 0\) m$"),
        ("x_m: -2.5, y_m: -1.5", "x_m: -3.5, y_m: -1.5", r":27: cameras\[0\]: .*within the bounds, got \(-3\.5,"),
        ("pitch_deg: 60.0", "pitch_deg: -60.0", r":30: pairs\[0\]\.start: is not seen by cameras\[1\]"),
        (
            "x_m: -2.5, y_m: -1.5, z_m: 2.0, yaw_deg: 30.0",
            "x_m: -2.5, y_m: -1.5, z_m: 2.0, yaw_deg: 110.0",
            r":30: .*goal",
        ),
        (
            "x_m: 2.5, y_m: -1.0",
            "x_m: -2.0, y_m: 0.5",
            r":30: pairs\[0\]: the start lies within the goal's radius of 0.7",
        ),
        ("x_max_m: 3.0, y_max_m: 2.0", "x_max_m: 900.0, y_max_m: 900.0", r":4: bounds: expected at most 10000 m²"),
        (
            "x_m: -2.5, y_m: -1.5, z_m: 2.0",
            "x_m: 0.4, y_m: 0.4, z_m: 0.5",
            r":27: cameras\[0\]: .*inside the box around \(0\.00",
        ),
        (
            "x_m: -1.0, y_m: -1.9, z_m: 3.0",
            "x_m: 0.0, y_m: 0.0, z_m: 1.05",
            r":28: cameras\[1\]: .*0\.1 m clear of everything, it is 0\.050 m from the box",
        ),
        ("pitch_deg: 20.0", "pitch_deg: 91.0", r":27: cameras\[0\]\.pitch_deg: .*got 91"),
        ("roll_deg: 5.0", "tilt_deg: 5.0", r":28: cameras\[1\]\.tilt_deg: is no key"),
        ("width_px: 64", "width_px: 0", r":28: cameras\[1\]\.width_px: .*16, got 0"),
        # The block begins at x = −0.5; the robot's front is 0.215 m before its middle.
        (
            "x_m: -2.0, y_m: 0.0, yaw_deg: 180.0",
            "x_m: -0.71, y_m: 0.0, yaw_deg: 0.0",
            r":30: pairs\[0\]\.start: .*overlap",
        ),
        (
            "x_m: -2.0, y_m: 0.0, yaw_deg: 180.0",
            "x_m: -2.8, y_m: 0.0, yaw_deg: 0.0",
            r":30: pairs\[0\]\.start: .*bounds",
        ),
        ("x_m: 2.5, y_m: -1.0", "x_m: 0.4, y_m: 0.4", r":30: pairs\[0\]\.goal: lies in an obstacle"),
        ("x_m: 2.5, y_m: -1.0", "x_m: 3.5, y_m: -1.0", r":30: pairs\[0\]\.goal: lies outside"),
        ("x_m: 2.5, y_m: -1.0", "x_m: 2.0, y_m: 1.0", r":30: pairs\[0\]: there is no way"),
        ("goal: {x_m: 2.5, y_m: -1.0}", "goal: {x_m: 2.5}", r":30: pairs\[0\]\.goal\.y_m: is missing"),
        ("goal_radius_m: 0.7", "goal_radius_m: 0.0", r":3: goal_radius_m: .*greater than 0"),
    ],
)
def test_what_no_trial_could_run_with_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in ROOM
    path = write(tmp_path, ROOM.replace(old, new, 1))
    with pytest.raises(FileError) as raised:
        load_site(path)
    assert re.match(re.escape(str(path)) + message, str(raised.value)), raised.value


def test_a_start_that_just_fits_is_taken(tmp_path: Path) -> None:
    text = ROOM.replace("x_m: -2.0, y_m: 0.0, yaw_deg: 180.0", "x_m: -0.72, y_m: 0.0, yaw_deg: 0.0")
    assert load_site(write(tmp_path, text)).pairs[0].start.x_m == -0.72


def test_robot_touches_what_its_rectangle_overlaps() -> None:
    spec, rng = RobotSpec(), np.random.default_rng(3)
    local = np.stack(np.meshgrid(np.linspace(-0.215, 0.215, 87), np.linspace(-0.18, 0.18, 73)), axis=-1).reshape(-1, 2)
    seen = set()
    for _ in range(400):
        shape = Shape(int(rng.integers(2)))
        x, y, yaw = rng.uniform(-0.5, 0.5, 3)
        wide = rng.uniform(0.05, 0.6)
        size = (wide, wide if shape is Shape.CYLINDER else rng.uniform(0.05, 0.6), 1.0)
        thing = Primitive(shape, (x, y, 0.5), size, yaw, (0, 0, 0))
        pose = Pose2(*rng.uniform(-0.3, 0.3, 2), rng.uniform(-3.0, 3.0))
        # By points 5 mm apart on the robot: how deep the deepest lies within the thing, negative outside.
        there = (Pose2(x, y, yaw).inverse() @ pose).apply(local)
        depth = (
            wide / 2.0 - np.hypot(*there.T) if shape is Shape.CYLINDER else (np.array(size[:2]) / 2 - abs(there)).min(1)
        )
        if abs(depth.max()) > 0.008:
            assert robot_touches((thing,), pose, spec) == (depth.max() > 0.0)
            seen.add((shape, bool(depth.max() > 0.0)))
    assert len(seen) == 4


def test_worlds_have_names() -> None:
    site = named_site("random_pillar", 3)
    assert site.world == random_pillar(3)
    assert (site.where, site.file_sha256) == ("world random_pillar, seed 3", "")
    assert is_generated("demo_room")
    assert not is_generated("bookstore")
    assert set(WORLDS) == {"aisles", "bookstore", "demo_room", "random_pillar", "rooms", "slits", "warehouse"}


def test_unknown_names_and_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"'moon'.*aisles, bookstore, demo_room, .*or a path to a \.yaml file"):
        named_site("moon", 0)
    with pytest.raises(FileError, match=r"moon\.yaml: cannot be read"):
        named_site("moon.yaml", 0)
    with pytest.raises(FileError, match="cannot be read"):
        named_site(str(tmp_path / "moon"), 0)
