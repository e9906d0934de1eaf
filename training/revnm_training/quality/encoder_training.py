"""Trains the encoder of :mod:`revnm_training.quality.encoder`: ego depth → how far it is free in 16 sectors.

Seen are true ego depths of random places in training worlds; the labels are computed from the same images. What the
last layer but one needs for that answer, the features keep.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from revnm_client.geometry import Pose2
from revnm_server.observation import Image32, ObservationSpec, normalise_ego_depth
from revnm_sim.expert.planner import INSCRIBED_M
from revnm_sim.generation.generator import TRAINING_SEED_BASE, random_pillar
from revnm_sim.occupancy import occupancy
from revnm_sim.rays.raycast import cast_depth, ego_camera
from revnm_sim.world import World, primitive_arrays
from revnm_training.checkpoint import load_checkpoint
from revnm_training.export import Graph, export_onnx
from revnm_training.preset import TrainConfig, load_preset
from revnm_training.quality.encoder import ENCODER_PX, FEATURES
from revnm_training.quality.sectors import SECTORS, metres, sector_distances
from revnm_training.run_settings import CHECKPOINT, RunSettings
from revnm_training.synth import WORLDS_PER_SEED
from revnm_training.trainer import Batch, Trainer

_WORLDS = 600
_VIEWS_PER_WORLD = 64
_VALIDATION_WORLDS = 20
_RECIPE = TrainConfig(learning_rate=2e-3, weight_decay=0.01, batch=256, warmup_steps=100, ema=0.99, kl_weight=0.0)


class EncoderNetwork(nn.Module):
    """Three convolutions of stride 2, 128 features, 16 distances."""

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            nn.Conv2d(1, 16, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(16, 32, 3, 2, 1),
            nn.ReLU(),
            nn.Conv2d(32, 32, 3, 2, 1),
            nn.ReLU(),
        )
        self.project = nn.Linear(32 * (ENCODER_PX // 8) ** 2, FEATURES)
        self.normalise = nn.BatchNorm1d(FEATURES, affine=False)  # so that distances of features have a scale
        self.answer = nn.Linear(FEATURES, SECTORS)

    def features(self, depth: Tensor) -> Tensor:
        """Map ego depth (B, 1, 32, 32) in [−1, 1] to features (B, 128)."""
        features: Tensor = self.normalise(self.project(self.convolutions(depth).flatten(1)))
        return features

    def forward(self, depth: Tensor) -> Tensor:
        """Map ego depth (B, 1, 32, 32) to the sectors' distances (B, 16), shares of ``ego_range_m``."""
        distances: Tensor = self.answer(torch.relu(self.features(depth)))
        return distances


class FeatureGraph(nn.Module):
    """The encoder as it is used: features only."""

    def __init__(self, network: EncoderNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, depth: Tensor) -> Tensor:
        """Return features (B, 128)."""
        return self.network.features(depth)


class EncoderTask:
    """True ego depth → distances of the sectors."""

    kind = "depth_encoder"

    def __init__(self, ego: Image32, held_out: int, spec: ObservationSpec) -> None:
        """Take ego depths (M, 32, 32) in [−1, 1], the last ``held_out`` of them for validation."""
        self._depth = torch.from_numpy(ego[:, None])
        free = sector_distances(metres(ego, spec), spec) / spec.ego_range_m
        self._free = torch.from_numpy(free.astype(np.float32))
        self._range_m = spec.ego_range_m
        self.train_size = len(ego) - held_out
        self.data: dict[str, Any] = {"train_views": self.train_size, "validation_views": held_out}

    def batch(self, index: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Gather views."""
        del rng
        return {"depth": self._depth[index], "free": self._free[index]}

    def loss(self, network: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the mean absolute error, shares of the range."""
        del generator
        return {"loss": (network(batch["depth"]) - batch["free"]).abs().mean()}

    def validate(self, network: nn.Module, device: torch.device) -> dict[str, float]:
        """Return the mean absolute error on held-out worlds, metres."""
        depth, free = self._depth[self.train_size :].to(device), self._free[self.train_size :].to(device)
        return {"sector_error_m": float((network(depth) - free).abs().mean()) * self._range_m}


def train_encoder(out: Path, *, steps: int, seed: int) -> float | None:
    """Train an encoder and write it as ONNX.

    Args:
        out: The file.
        steps: Length of the run.
        seed: Of everything random, 0 to 999.

    Returns:
        The largest difference between ONNX and PyTorch; None where the run was stopped, which leaves no file.
    """
    spec = load_preset("edge").observation
    ego = true_views(spec, seed=seed)
    torch.manual_seed(seed)
    network = EncoderNetwork()
    with tempfile.TemporaryDirectory() as scratch:
        settings = RunSettings(Path(scratch), "edge", steps, seed, precision="32-true")
        task = EncoderTask(ego, _VALIDATION_WORLDS * _VIEWS_PER_WORLD, spec)
        if not Trainer(task, network, _RECIPE, settings).run():
            return None
        network.load_state_dict(load_checkpoint(settings.out / CHECKPOINT, task.kind).averaged)
    network.cpu().to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    out.parent.mkdir(parents=True, exist_ok=True)
    graph = Graph(FeatureGraph(network), {"depth": (1, ENCODER_PX, ENCODER_PX)}, ("features",), batched=True)
    return export_onnx(graph, out)


def true_views(spec: ObservationSpec, *, seed: int) -> Image32:
    """Return ego depths (M, 32, 32) in [−1, 1] from random places and headings in training worlds of random pillars.

    Worlds follow each other: held-out views at the end are of other worlds.
    """
    parts = []
    for number in tqdm(range(_WORLDS), desc="render", unit=" worlds"):
        world = random_pillar(TRAINING_SEED_BASE + seed * WORLDS_PER_SEED + number)
        parts.append(_world_views(world, spec, np.random.default_rng((seed, number))))
    return np.concatenate(parts)


def _world_views(world: World, spec: ObservationSpec, rng: np.random.Generator) -> Image32:
    grid, arrays = occupancy(world), primitive_arrays(world.primitives)
    low, high = np.array(world.bounds[:2]), np.array(world.bounds[2:])
    points = low + (high - low) * rng.random((16 * _VIEWS_PER_WORLD, 2))
    points = points[grid.clearance_m(points) > INSCRIBED_M][:_VIEWS_PER_WORLD]
    poses = [Pose2(x, y, rng.uniform(-math.pi, math.pi)) for x, y in points]
    size = (spec.ego_px, spec.ego_px)
    return np.stack([normalise_ego_depth(cast_depth(arrays, ego_camera(pose, spec), size), spec) for pose in poses])
