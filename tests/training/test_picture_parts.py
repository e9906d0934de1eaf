"""The paper's policy in two parts: with features kept, a drive gets the plans of the whole network, uncached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from revnm_client.errors import ConfigError
from revnm_client.geometry import FloatArray
from revnm_server.assembly import build_pipeline
from revnm_server.frame import Frame, RobotSighting
from revnm_server.networks.bundle import Bundle, load_bundle
from revnm_server.observation import Image32, ImagePose
from revnm_server.ports import EgoRequest, PlanRequest
from revnm_server.settings import PerceptionSettings
from revnm_server.stages.policy import OnnxPolicy
from revnm_server.tick.pipeline import Pipeline
from revnm_training.checkpoint import Checkpoint, save_checkpoint
from revnm_training.export import export_bundle
from revnm_training.networks.act import ActPolicy
from revnm_training.preset import BackboneConfig, Preset, load_preset

MS = 1_000_000
SMALL_HW = (192, 256)  # of the shipped depth network
# The paper's networks, everything about them but smaller.
_PAPER = load_preset("paper")
assert _PAPER.policy is not None
SMALL: Preset = replace(
    _PAPER,
    observation=replace(_PAPER.observation, exo_hw=(64, 64), history_interval_s=0.2),
    policy=replace(
        _PAPER.policy,
        exo_backbone=BackboneConfig(8, (1, 1, 1, 1)),
        ego_px=64,
        width=32,
        heads=4,
        feedforward=64,
        vae_layers=1,
        encoder_layers=1,
        decoder_layers=2,
    ),
    exo2ego=replace(_PAPER.exo2ego, width=32, depth=2, heads=4, patch=8, steps=2),
)


@pytest.fixture(scope="module")
def network() -> ActPolicy:
    torch.manual_seed(0)
    assert SMALL.policy is not None
    network = ActPolicy(SMALL.policy, SMALL.observation).eval()
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))  # as they begin, waypoints hardly depend on images
    return network


@pytest.fixture(scope="module")
def bundle(network: ActPolicy, tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    folder = tmp_path_factory.mktemp("parts")
    checkpoint = Checkpoint("policy", SMALL.name, 1, 1, 0, {}, network.state_dict(), {}, {"validation": {}})
    save_checkpoint(folder / "policy.pt", checkpoint)
    differences = export_bundle(SMALL, {"policy": folder / "policy.pt"}, folder / "bundle", random_weights=True)
    assert set(differences) == {"encoder", "policy", "exo2ego"}
    return load_bundle(folder / "bundle", threads=1)


class Scene:
    """Depth, sightings and ego depth that are drawn by the stamp; notes what the cached policy and the network say."""

    def __init__(self, bundle: Bundle, network: ActPolicy) -> None:
        self.cached, self._network = OnnxPolicy(bundle), network
        self.visible: list[str] = []
        self.asked: list[tuple[str, ...]] = []
        self.worst = 0.0

    def disparity(self, frame: Frame) -> Image32:
        return np.random.default_rng(frame.seq).random(SMALL_HW, dtype=np.float32)

    def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> list[RobotSighting]:
        heading = np.array([0.6, 0.8])
        return [
            RobotSighting(robot, frame.stamp_ns, np.array([20.0 + 3 * k, 30.0]), heading, np.zeros((4, 2)))
            for k, robot in enumerate(self.visible)
        ]

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        shape = (SMALL.observation.ego_px, SMALL.observation.ego_px)
        drawn = [
            np.random.default_rng([request.stamp_ns, ord(request.robot)]).random(shape, dtype=np.float32)
            for request in requests
        ]
        return np.array(drawn, dtype=np.float32).reshape(-1, *shape)

    def waypoints(self, requests: Sequence[PlanRequest]) -> FloatArray:
        kept = self.cached.waypoints(requests)
        self.asked.append(tuple(request.robot for request in requests))
        for waypoints, request in zip(kept, requests, strict=True):
            parts = request.exo[:, None], request.ego[:, None], request.pose.p_rob, request.pose.q_rel, request.goal
            with torch.inference_mode():
                whole = self._network(*(torch.tensor(np.asarray(part))[None].float() for part in parts)).waypoints
            self.worst = max(self.worst, float(np.abs(waypoints - whole[0].numpy()).max()))
        return kept


class Click:
    id = "g"
    normalised = (0.7, 0.4)


def test_plans_with_kept_features_are_those_of_the_whole_network(bundle: Bundle, network: ActPolicy) -> None:
    scene = Scene(bundle, network)
    pipeline = Pipeline(bundle.spec, depth=scene, tags=scene, exo2ego=scene, planner=scene)
    # Frames at 10 Hz, then lost ones, a break that begins the history anew, and a robot that appears late and vanishes.
    stamps_ms = [*range(0, 1000, 100), 1400, 1450, 1700, *range(3200, 3800, 100)]
    for seq, stamp_ms in enumerate(stamps_ms):
        scene.visible = ["a", "b"] if seq < 4 else ["a", "b", "c"] if seq < 12 else ["c"]
        goals = {robot: Click() for robot in ("a", "b", "c")} if seq != 2 else {}
        pipeline.step(Frame(np.zeros((48, 64, 3), np.uint8), stamp_ms * MS, seq), goals)
    assert scene.asked[3] == ("a", "b")
    assert {len(asked) for asked in scene.asked} == {0, 1, 2, 3}
    assert scene.worst < 1e-4


def test_the_order_of_images_matters(bundle: Bundle, network: ActPolicy) -> None:
    """Else the comparison above would not show an older image in the place of a newer one."""
    scene = Scene(bundle, network)
    spec = bundle.spec
    rng = np.random.default_rng(0)
    exo = rng.random((spec.history, *spec.exo_hw), dtype=np.float32)
    ego = rng.random((spec.history, spec.ego_px, spec.ego_px), dtype=np.float32)
    sighting = RobotSighting("a", 0, np.zeros(2), np.array([0.6, 0.8]), np.zeros((4, 2)))
    pose = ImagePose(np.array([0.2, 0.3]), sighting.heading)
    request = PlanRequest("a", 0, sighting, pose, np.array([0.7, 0.4]), "g", exo, ego)
    waypoints = scene.cached.waypoints([request])
    for swapped in (replace(request, exo=exo[[1, 0, 2, 3, 4]]), replace(request, ego=ego[[0, 1, 2, 4, 3]])):
        assert np.abs(scene.cached.waypoints([swapped]) - waypoints).max() > 1e-3


def test_the_bundle_drives_the_servers_pipeline_and_another_bundle_takes_its_networks(
    bundle: Bundle, tmp_path: Path
) -> None:
    assert bundle.encoder is not None
    assert bundle.spec.disparity_hw == SMALL_HW  # of the depth network that it took over
    pipeline = build_pipeline(bundle, PerceptionSettings(bundle=bundle.folder, threads=1), {"rover": 0})
    assert pipeline.step(Frame(np.zeros((48, 64, 3), np.uint8), 0, 0), {}).plans == ()
    export_bundle(replace(SMALL, observation=bundle.spec), {}, tmp_path / "copy", base=bundle.folder)
    copy = load_bundle(tmp_path / "copy", threads=1)
    assert copy.manifest["models"] == bundle.manifest["models"]


def test_a_preset_without_a_depth_network_says_that_it_needs_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no checkpoint or base for depth, exo2ego, policy"):
        export_bundle(SMALL, {}, tmp_path / "bundle")
