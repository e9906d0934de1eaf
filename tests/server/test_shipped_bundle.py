"""The bundle that comes with the package: whole, small, documented, and sensible on simple scenes."""

from __future__ import annotations

import numpy as np
import pytest

from revnm_server.frame import Frame
from revnm_server.mapping.map_window import WAY_POINTS, WindowSpec
from revnm_server.networks.bundle import Bundle, default_bundle_path, load_bundle
from revnm_server.observation import ImagePose, normalise_ego_depth
from revnm_server.ports import BeliefRequest, EgoRequest
from revnm_server.stages.depth import OnnxDepth
from revnm_server.stages.exo2ego import OnnxExo2Ego
from revnm_server.stages.policy import OnnxFloorPolicy

MEGABYTE = 1_000_000


@pytest.fixture(scope="module")
def bundle() -> Bundle:
    return load_bundle(default_bundle_path(), threads=1)


def test_it_is_small_enough_to_be_committed() -> None:
    assert sum(file.stat().st_size for file in default_bundle_path().iterdir()) <= 40 * MEGABYTE


def test_its_manifest_says_how_it_was_made_and_how_good_it_is(bundle: Bundle) -> None:
    manifest = bundle.manifest
    for kind in ("policy", "exo2ego", "depth"):
        run = manifest["recipe"]["runs"][kind]
        assert run["steps"] > 0
        assert run["seconds"] > 0
        assert manifest["data"][kind]
        assert manifest["results"]["validation"][kind]
    methods = {(row["method"], row["perception"]) for row in manifest["results"]["benchmark"]}
    assert {("revnm", "truth"), ("revnm", "models"), ("straight", "truth"), ("expert", "truth")} <= methods


@pytest.mark.parametrize("size", [(480, 640), (720, 1280), (960, 1280)])
def test_any_picture_has_a_disparity(bundle: Bundle, size: tuple[int, int]) -> None:
    image = np.random.default_rng(0).integers(0, 256, (*size, 3), dtype=np.uint8)
    disparity = OnnxDepth(bundle).disparity(Frame(image, 10**9, 1))
    assert disparity.shape == bundle.spec.disparity_hw
    assert np.isfinite(disparity).all()


def test_the_robots_view_begins_with_what_the_map_says_of_it(bundle: Bundle) -> None:
    """A wall 1.5 m ahead fills the upper half of the view; exo2ego may change it, but not turn it into open space."""
    side, spec = bundle.spec.ego_px, bundle.spec
    depth_m = np.full((side, side), 1.5, dtype=np.float32)
    known = np.ones((side, side), dtype=np.float32)
    place = ImagePose(np.array([0.5, 0.6]), np.array([0.0, -1.0]))
    crops = np.full((spec.history, spec.crop_px, spec.crop_px), 0.5, dtype=np.float32)
    prior = np.stack([normalise_ego_depth(depth_m, spec), known])
    view = OnnxExo2Ego(bundle).synthesise([EgoRequest("rover", 0, place, crops, prior)])[0]
    seen_m = (view[side // 4 : side // 2].mean() + 1.0) / 2.0 * spec.ego_range_m
    assert seen_m == pytest.approx(1.5, abs=0.5)


def test_free_floor_is_believed_free_and_a_wall_stands_where_it_is_seen(bundle: Bundle) -> None:
    """A wall of 2 m stands 2 m ahead; nobody sees the 2 m behind it."""
    side = WindowSpec().side
    window = np.stack([np.full((side, side), value, dtype=np.float32) for value in (0.03, 1.0, 0.0, 0.1)])
    middle, near = slice(side // 2 - 10, side // 2 + 10), slice(side // 2 - 15, side // 2 + 20)
    wall, hidden = slice(side // 2 - 22, side // 2 - 20), slice(side // 2 - 42, side // 2 - 22)
    window[:, wall, middle] = np.array([0.98, 0.0, 0.0, 0.97], dtype=np.float32)[:, None, None]
    window[:, hidden, middle] = np.array([0.5, 0.0, 1.0, 0.5], dtype=np.float32)[:, None, None]
    way = np.stack([np.zeros(WAY_POINTS), 0.4 * np.arange(1, WAY_POINTS + 1)], axis=1)
    ego = np.ones((bundle.spec.ego_px, bundle.spec.ego_px), dtype=np.float32)
    belief = OnnxFloorPolicy(bundle).believe([BeliefRequest(window, way, way[-1], ego)])[0]
    assert belief[wall, middle].max(axis=0).mean() > 0.6
    assert belief[near, middle].mean() < 0.1
    assert belief[hidden, middle].mean() < 0.5  # floor, more likely than not: it is no border of a room
