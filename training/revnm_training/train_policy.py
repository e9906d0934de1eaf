"""Trains the navigation policy on the expert's waypoints.

At run time the ego depth is imagined, so most samples show the policy an imagined one in training, too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from revnm_training.batches import add_noise, gather, mirror, signed, unit
from revnm_training.map_cache import rendered
from revnm_training.networks.act import ActPolicy, policy_loss
from revnm_training.networks.map_policy import MapPolicy
from revnm_training.preset import Preset
from revnm_training.sample_cache import SampleSet
from revnm_training.train_exo2ego import imagined_ego
from revnm_training.train_map_policy import MapPolicyTask
from revnm_training.trainer import Batch, RunSettings, Task, Trainer
from revnm_training.waypoint_errors import waypoint_errors

_COLUMNS = ("exo", "robot", "heading", "goal", "waypoints")
_IMAGINED_SHARE = 0.75
_VALIDATION_SAMPLES = 2048
_VALIDATION_BATCH = 256


class PolicyTask:
    """Exo disparity, ego depth, pose and goal in the picture → waypoints."""

    kind = "policy"

    def __init__(self, samples: SampleSet, imagined: NDArray[np.uint8] | None, *, kl_weight: float) -> None:
        """Take the data.

        Args:
            samples: Rendered samples.
            imagined: (M, e, e) imagined ego depth of the newest frame as bytes; None trains on the true one only.
            kl_weight: β.
        """
        self._samples, self._imagined, self._kl_weight = samples, imagined, kl_weight
        self.train_size = len(samples.train)
        self.data = samples.describe() | {"imagined_ego_share": 0.0 if imagined is None else _IMAGINED_SHARE}

    def batch(self, index: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Gather observations and labels; three quarters see imagined ego depth, where there is any."""
        return self._gather(self._samples.train[index], rng.random(len(index)) < _IMAGINED_SHARE)

    def loss(self, network: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the loss of a batch, half of it mirrored."""
        batch = mirror(batch, generator)
        exo = add_noise(unit(batch["exo"]), generator)[:, :, None]
        ego, target = signed(batch["ego"])[:, :, None], batch["waypoints"]
        output = network(exo, ego, batch["robot"], batch["heading"], batch["goal"], target)
        return policy_loss(output, target, kl_weight=self._kl_weight)

    def validate(self, network: nn.Module, device: torch.device) -> dict[str, float]:
        """Return waypoint errors, metres, and errors of the direction to the first and the last waypoint, degrees.

        Measured as at run time: imagined ego depth where there is any, z = 0.
        """
        chosen = self._samples.validation
        chosen = chosen[:: max(1, len(chosen) // _VALIDATION_SAMPLES)]
        predicted, true = [], []
        for start in range(0, len(chosen), _VALIDATION_BATCH):
            index = chosen[start : start + _VALIDATION_BATCH]
            batch = {name: x.to(device) for name, x in self._gather(index, np.full(len(index), True)).items()}
            exo, ego = unit(batch["exo"])[:, :, None], signed(batch["ego"])[:, :, None]
            output = network(exo, ego, batch["robot"], batch["heading"], batch["goal"], None)
            predicted.append(output.waypoints.float().cpu().numpy())
            true.append(batch["waypoints"].cpu().numpy())
        return waypoint_errors(np.concatenate(predicted), np.concatenate(true))

    def _gather(self, index: NDArray[np.int64], is_imagined: NDArray[np.bool_]) -> Batch:
        index = np.sort(index)
        batch = gather(self._samples.columns, (*_COLUMNS, "ego"), index)
        if self._imagined is not None:
            # An imagined past would need the past's crops: the newest picture stands for all frames.
            chosen = torch.from_numpy(is_imagined).view(-1, 1, 1, 1)
            batch["ego"] = torch.where(chosen, torch.from_numpy(self._imagined[index])[:, None], batch["ego"])
        return batch


def train_policy(
    preset: Preset, settings: RunSettings, *, data: Path, cache: Path, exo2ego: Path | None, jobs: int
) -> bool:
    """Render the samples that miss, imagine their ego depth where a denoiser is given, and train.

    Returns:
        Whether the end was reached.

    Raises:
        ConfigError: Cache, data or run folder hold something else.
        FileError: The denoiser's checkpoint is missing or of another kind.
    """
    samples = rendered(preset, data, cache, jobs=jobs)
    imagined = None if exo2ego is None else imagined_ego(samples, preset, exo2ego)
    torch.manual_seed(settings.seed)
    kl_weight = preset.train_policy.kl_weight
    task: Task
    if preset.map_policy is not None:
        task = MapPolicyTask(samples, imagined, preset.map_policy, kl_weight=kl_weight)
    else:
        task = PolicyTask(samples, imagined, kl_weight=kl_weight)
    return Trainer(task, policy_network(preset), preset.train_policy, settings).run()


def policy_network(preset: Preset) -> nn.Module:
    """Return a preset's policy with random weights: a :class:`MapPolicy` or an :class:`ActPolicy`."""
    if preset.map_policy is not None:
        return MapPolicy(preset.map_policy, preset.observation)
    assert preset.policy is not None  # the preset's loader has checked that there is one
    return ActPolicy(preset.policy, preset.observation)
