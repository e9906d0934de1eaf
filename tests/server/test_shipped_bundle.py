"""The bundle that comes with the package: whole, small, documented, and usable on any picture."""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_server.bundle import default_bundle_path, load_bundle
from revnm_server.depth import OnnxDepth
from revnm_server.exo2ego import OnnxExo2Ego
from revnm_server.frame import Frame, RobotSighting
from revnm_server.pipeline import Pipeline
from revnm_server.policy import OnnxPolicy

MEGABYTE = 1_000_000


class Goal:
    id = "goal"
    normalised = (0.8, 0.7)


class Seen:
    def sightings(self, frame: Frame) -> list[RobotSighting]:
        corners: FloatArray = np.array([[290.0, 230], [350, 230], [350, 250], [290, 250]])
        return [RobotSighting("rover", frame.stamp_ns, np.array([320.0, 240.0]), np.array([0.0, -1.0]), corners)]


def test_it_is_small_enough_to_be_committed() -> None:
    assert sum(file.stat().st_size for file in default_bundle_path().iterdir()) <= 40 * MEGABYTE


def test_its_manifest_says_how_it_was_made_and_how_good_it_is() -> None:
    manifest = load_bundle(default_bundle_path(), threads=1).manifest
    for kind in ("policy", "exo2ego", "depth"):
        run = manifest["recipe"]["runs"][kind]
        assert run["steps"] > 0
        assert run["seconds"] > 0
        assert manifest["data"][kind]
        assert manifest["results"]["validation"][kind]
    methods = {(row["method"], row["perception"]) for row in manifest["results"]["benchmark"]}
    assert {("revnm", "truth"), ("revnm", "models"), ("straight", "truth"), ("expert", "truth")} <= methods


def test_it_plans_from_any_picture() -> None:
    bundle = load_bundle(default_bundle_path(), threads=1)
    pipeline = Pipeline(
        bundle.spec, depth=OnnxDepth(bundle), tags=Seen(), exo2ego=OnnxExo2Ego(bundle), planner=OnnxPolicy(bundle)
    )
    rng = np.random.default_rng(0)
    for seq, size in enumerate([(480, 640), (720, 1280), (960, 1280)]):
        image = rng.integers(0, 256, (*size, 3), dtype=np.uint8)
        plans = pipeline.step(Frame(image, 10**9 * (seq + 1), seq), {"rover": Goal()}).plans
        assert plans[0].waypoints_m.shape == (5, 2)
        assert np.abs(plans[0].waypoints_m).max() < 5.0
