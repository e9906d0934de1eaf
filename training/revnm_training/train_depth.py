"""Trains the small monocular depth network on pictures rendered here, so that everything runs without downloads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from revnm_client.errors import ConfigError
from revnm_server.observation import normalise_disparity
from revnm_training.batches import gather, mirror
from revnm_training.depth_metrics import depth_errors
from revnm_training.networks.depth_net import DepthNet, depth_loss
from revnm_training.pictures import PictureSet, render_pictures
from revnm_training.preset import DepthConfig, Preset
from revnm_training.run_settings import RunSettings
from revnm_training.trainer import Batch, Trainer

_VALIDATION_BATCH = 32


class DepthTask:
    """RGB → disparity, normalised per picture."""

    kind = "depth"

    def __init__(self, pictures: PictureSet, config: DepthConfig) -> None:
        self._pictures = pictures
        self._mean = torch.tensor(config.mean)
        self._std = torch.tensor(config.std)
        self.train_size = len(pictures.train)
        self.data: dict[str, Any] = {"train_pictures": self.train_size, "validation_pictures": len(pictures.validation)}

    def batch(self, index: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Gather pictures."""
        del rng
        return gather(self._pictures.columns, ("rgb", "disparity"), self._pictures.train[index])

    def loss(self, network: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the loss of a batch, half of it mirrored, its disparity normalised."""
        batch = mirror(batch, generator)
        return depth_loss(network(self._input(batch["rgb"])), normalised(batch["disparity"].float()))

    def validate(self, network: nn.Module, device: torch.device) -> dict[str, float]:
        """Return AbsRel and δ1 after aligning scale and shift, and the L1 error of the normalised disparity."""
        errors, l1 = [], []
        for start in range(0, len(self._pictures.validation), _VALIDATION_BATCH):
            index = self._pictures.validation[start : start + _VALIDATION_BATCH]
            batch = gather(self._pictures.columns, ("rgb", "disparity"), index)
            predicted = network(self._input(batch["rgb"].to(device))).float().cpu().numpy()
            for guess, true in zip(predicted, batch["disparity"].float().numpy(), strict=True):
                errors.append(depth_errors(guess, true))
                l1.append(float(np.abs(normalise_disparity(guess) - normalise_disparity(true)).mean()))
        abs_rel, delta1 = np.mean(errors, axis=0)
        return {"abs_rel": float(abs_rel), "delta1": float(delta1), "l1": float(np.mean(l1))}

    def _input(self, rgb: Tensor) -> Tensor:
        scaled = (rgb.float() / 255.0 - self._mean.to(rgb.device)) / self._std.to(rgb.device)
        return scaled.permute(0, 3, 1, 2)


def normalised(disparity: Tensor) -> Tensor:
    """Apply :func:`revnm_server.observation.normalise_disparity` to a batch (B, h, w), on its device."""
    flat = disparity.flatten(1).sort(dim=1).values
    ends = torch.tensor([0.02, 0.98], device=disparity.device) * (flat.shape[1] - 1)
    below = ends.long()
    low_high = torch.lerp(flat[:, below], flat[:, below + 1], ends - below)[:, :, None, None]  # (B, 2, 1, 1)
    span = (low_high[:, 1] - low_high[:, 0]).clamp(min=1e-6)
    return ((disparity - low_high[:, 0]) / span).clamp(0.0, 1.0)


def train_depth(preset: Preset, settings: RunSettings, *, cache: Path, pictures: int, jobs: int) -> bool:
    """Render the pictures that miss and train.

    Returns:
        Whether the end was reached.

    Raises:
        ConfigError: The preset has no depth network, or cache or run folder hold something else.
    """
    if preset.depth is None or preset.train_depth is None:
        raise ConfigError(f"preset {preset.name} has no depth network of its own")
    fabric = settings.open_fabric()
    settings.begun(DepthTask.kind)
    with fabric.rank_zero_first():
        rendered = render_pictures(cache, preset.observation.disparity_hw, pictures=pictures, jobs=jobs)
    torch.manual_seed(settings.seed)
    task = DepthTask(rendered, preset.depth)
    return Trainer(task, DepthNet(preset.depth), preset.train_depth, settings, fabric).run()
