"""Trains the navigation policy on the expert's waypoints.

At run time the ego depth is imagined, so most samples show the policy an imagined one in training, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from revnm_training.batches import add_noise, gather, mirror, signed, unit
from revnm_training.checkpoint import fill, load_trained
from revnm_training.map_cache import rendered
from revnm_training.networks.act import ActPolicy, policy_loss
from revnm_training.networks.map_policy import MapPolicy
from revnm_training.preset import Preset
from revnm_training.render_device import RenderDevice
from revnm_training.run_settings import RunSettings
from revnm_training.sample_set import DataSource, JoinedColumn, Rows, SampleSet, join
from revnm_training.train_exo2ego import imagined_ego, load_denoiser
from revnm_training.train_map_policy import MapPolicyTask
from revnm_training.trainer import Batch, Task, Trainer
from revnm_training.waypoint_errors import waypoint_errors

_COLUMNS = ("exo", "robot", "heading", "goal", "waypoints")
_IMAGINED_SHARE = 0.75
_VALIDATION_SAMPLES = 2048
_VALIDATION_BATCH = 256


class PolicyTask:
    """Exo disparity, ego depth, pose and goal in the picture → waypoints."""

    kind = "policy"

    def __init__(self, samples: SampleSet, imagined: Rows | None, *, kl_weight: float) -> None:
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
    preset: Preset,
    settings: RunSettings,
    *,
    sources: Sequence[DataSource],
    exo2ego: Path | None,
    jobs: int,
    render: RenderDevice = "cpu",
    begin: Path | None = None,
) -> bool:
    """Render the samples that miss, imagine their ego depth where a denoiser is given, and train.

    Args:
        preset: What is trained.
        settings: Of the run.
        sources: The data.
        exo2ego: Checkpoint of the denoiser; None trains on exact ego depth only.
        jobs: Processes that render.
        render: Casts ego depth.
        begin: Checkpoint whose averaged weights a new run begins with; None begins with random ones.

    Returns:
        Whether the end was reached.

    Raises:
        ConfigError: Cache, data or run folder hold something else.
        FileError: A checkpoint is missing or of another kind.
    """
    fabric = settings.open_fabric()
    settings.begun(PolicyTask.kind)
    torch.manual_seed(settings.seed)
    network = policy_network(preset)
    if begin is not None:
        fill(network, load_trained(begin, PolicyTask.kind, preset.name), begin)
    denoiser = None if exo2ego is None else load_denoiser(preset, exo2ego)
    with fabric.rank_zero_first():
        sets = [rendered(preset, source.data, source.cache, jobs=jobs, device=render) for source in sources]
        imagined = None if denoiser is None else JoinedColumn([imagined_ego(each, denoiser) for each in sets])
    task = _task(preset, join(sets, [source.repeat for source in sources]), imagined)
    return Trainer(task, network, preset.train_policy, settings, fabric).run()


def _task(preset: Preset, samples: SampleSet, imagined: Rows | None) -> Task:
    kl_weight = preset.train_policy.kl_weight
    if preset.map_policy is not None:
        return MapPolicyTask(samples, imagined, preset.map_policy, kl_weight=kl_weight)
    return PolicyTask(samples, imagined, kl_weight=kl_weight)


def policy_network(preset: Preset) -> nn.Module:
    """Return a preset's policy with random weights: a :class:`MapPolicy` or an :class:`ActPolicy`."""
    if preset.map_policy is not None:
        return MapPolicy(preset.map_policy, preset.observation)
    assert preset.policy is not None  # the preset's loader has checked that there is one
    return ActPolicy(preset.policy, preset.observation)
