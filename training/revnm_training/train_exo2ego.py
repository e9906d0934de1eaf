"""Trains the denoiser that imagines a robot's ego depth, and lets a trained one imagine a whole data set."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from tqdm import tqdm

from revnm_server.observation import Image32
from revnm_server.stages.exo2ego import ddim_sample, ddim_schedule, start_image
from revnm_training.batches import add_noise, gather, mirror, signed, unit
from revnm_training.checkpoint import fill, load_trained
from revnm_training.map_cache import rendered
from revnm_training.networks.dit import Denoiser, diffusion_loss
from revnm_training.precision import autocast
from revnm_training.preset import Exo2EgoConfig, Preset
from revnm_training.render_device import RenderDevice
from revnm_training.run_settings import RunSettings
from revnm_training.sample_cache import to_bytes
from revnm_training.sample_set import SampleSet
from revnm_training.trainer import Batch, Trainer

_VALIDATION_SAMPLES = 1024
_SAMPLING_BATCH = 128  # fits the processor caches


class Exo2EgoTask:
    """Crop of the exo disparity and pose in the picture → ego depth of the newest frame."""

    kind = "exo2ego"

    def __init__(self, samples: SampleSet, config: Exo2EgoConfig) -> None:
        self._samples, self._config = samples, config
        self.train_size = len(samples.train)
        self.data = samples.describe()

    def batch(self, index: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Gather crops, poses and ego depths."""
        del rng
        return gather(self._samples.columns, (*_condition(self._config), "ego"), self._samples.train[index])

    def loss(self, network: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return the diffusion loss of a batch, half of it mirrored."""
        batch = mirror(batch, generator)
        seen = _seen(batch)
        seen["crop"] = add_noise(seen["crop"], generator)
        clean = signed(batch["ego"][:, -1:])
        return diffusion_loss(network, clean, seen, generator, noise=self._config.noise)

    def validate(self, network: nn.Module, device: torch.device) -> dict[str, float]:
        """Return the PSNR at one step and at the preset's, decibels: range 1, mean over pictures, 32 × 32."""
        chosen = self._samples.validation
        chosen = chosen[:: max(1, len(chosen) // _VALIDATION_SAMPLES)]
        batch = gather(self._samples.columns, (*_condition(self._config), "ego"), chosen)
        true = unit(batch["ego"][:, -1]).numpy()
        measured = {}
        for steps in sorted({1, 8, self._config.steps}) if self._config.noise else [1]:
            imagined = (imagine(network, batch, steps=steps, noise=self._config.noise, device=device) + 1.0) / 2.0
            error = ((imagined - true) ** 2).mean(axis=(1, 2))
            measured[f"psnr_{steps}_steps_db"] = float(np.mean(-10.0 * np.log10(np.maximum(error, 1e-9))))
        return measured


def _condition(config: Exo2EgoConfig) -> tuple[str, ...]:
    """Return the columns that the network sees."""
    return ("crop", "robot", "heading", "prior") if config.prior else ("crop", "robot", "heading")


def _seen(batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return what the network sees of a batch of columns, scaled."""
    seen = {"crop": unit(batch["crop"]), "robot": batch["robot"], "heading": batch["heading"]}
    if "prior" in batch:
        depth, known = unit(batch["prior"]).split(1, dim=1)
        seen["prior"] = torch.cat([2.0 * depth - 1.0, known], dim=1)
    return seen


@torch.no_grad()
def imagine(network: nn.Module, batch: Batch, *, steps: int, noise: bool, device: torch.device) -> Image32:
    """Sample ego depth (B, e, e) in [−1, 1] exactly as the server does.

    Args:
        network: A :class:`Denoiser`.
        batch: ``crop`` (B, N, c, c) and perhaps ``prior`` (B, 2, e, e) bytes, ``robot`` and ``heading`` (B, 2);
            ``ego`` gives the size.
        steps: DDIM steps.
        noise: Whether it diffuses.
        device: Where the network is.
    """
    schedule, pictures = ddim_schedule(steps), []
    for start in range(0, len(batch["crop"]), _SAMPLING_BATCH):
        part = {name: x[start : start + _SAMPLING_BATCH].to(device) for name, x in batch.items()}
        seen, count = _seen(part), len(part["crop"])
        begin = np.tile(start_image(part["ego"].shape[-1], noise=noise), (count, 1, 1, 1))

        def denoise(noisy: Image32, step: int, seen: Batch = seen) -> Image32:
            at = torch.full((len(noisy),), step, dtype=torch.int64, device=device)
            clean = network(noisy=torch.from_numpy(noisy).to(device), step=at, **seen)
            return np.asarray(clean.float().cpu().numpy())

        pictures.append(ddim_sample(denoise, begin.reshape(count, 1, *begin.shape[-2:]), schedule)[:, 0])
    return np.concatenate(pictures)


@dataclass(frozen=True, slots=True)
class TrainedDenoiser:
    """A denoiser that imagines.

    Attributes:
        network: In evaluation mode, on the fastest device.
        config: Its part of the preset.
        mark: Tells it from others: the beginning of its checkpoint's hash.
    """

    network: Denoiser
    config: Exo2EgoConfig
    mark: str


def load_denoiser(preset: Preset, checkpoint: Path) -> TrainedDenoiser:
    """Load a trained denoiser.

    Raises:
        FileError: The checkpoint is missing, of another kind or of another preset.
    """
    network = Denoiser(preset.exo2ego, preset.observation)
    fill(network, load_trained(checkpoint, Exo2EgoTask.kind, preset.name), checkpoint)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    mark = hashlib.sha256(checkpoint.read_bytes()).hexdigest()[:12]
    return TrainedDenoiser(network.eval().to(device), preset.exo2ego, mark)


def imagined_ego(samples: SampleSet, denoiser: TrainedDenoiser) -> NDArray[np.uint8]:
    """Return the ego depth (M, e, e) that a denoiser imagines for every sample, as bytes.

    Kept beside the rendered samples; an interrupted run goes on.
    """
    name = f"imagined_{denoiser.mark}_{denoiser.config.steps}"
    path, progress = samples.folder / f"{name}.npy", samples.folder / f"{name}.json"
    ego = samples.columns["ego"]
    shape = (len(ego), *ego.shape[2:])
    if not progress.exists():
        np.lib.format.open_memmap(path, mode="w+", dtype=np.uint8, shape=shape).flush()
        progress.write_text(json.dumps({"done": 0}), encoding="utf-8")
    _imagine_missing(samples, denoiser, path, progress)
    return np.asarray(np.load(path, mmap_mode="r"))


def _imagine_missing(samples: SampleSet, denoiser: TrainedDenoiser, path: Path, progress: Path) -> None:
    config, device = denoiser.config, next(denoiser.network.parameters()).device
    imagined: np.memmap[Any, np.dtype[np.uint8]] = np.lib.format.open_memmap(path, mode="r+")
    done = json.loads(progress.read_text(encoding="utf-8"))["done"]
    chunk = 32 * _SAMPLING_BATCH
    with tqdm(total=len(imagined), initial=done, desc="imagine ego depth", unit=" samples") as bar:
        for start in range(done, len(imagined), chunk):
            index = np.arange(start, min(start + chunk, len(imagined)))
            batch = gather(samples.columns, (*_condition(config), "ego"), index)
            with autocast(device):
                pictures = imagine(denoiser.network, batch, steps=config.steps, noise=config.noise, device=device)
            imagined[index] = to_bytes((pictures + 1.0) / 2.0)
            imagined.flush()
            progress.write_text(json.dumps({"done": int(index[-1]) + 1}), encoding="utf-8")
            bar.update(len(index))


def train_exo2ego(
    preset: Preset, settings: RunSettings, *, data: Path, cache: Path, jobs: int, render: RenderDevice = "cpu"
) -> bool:
    """Render the samples that miss and train.

    Returns:
        Whether the end was reached.

    Raises:
        ConfigError: Cache, data or run folder hold something else.
    """
    fabric = settings.open_fabric()
    settings.begun(Exo2EgoTask.kind)
    with fabric.rank_zero_first():
        samples = rendered(preset, data, cache, jobs=jobs, device=render)
    torch.manual_seed(settings.seed)
    network = Denoiser(preset.exo2ego, preset.observation)
    task = Exo2EgoTask(samples, preset.exo2ego)
    return Trainer(task, network, preset.train_exo2ego, settings, fabric).run()
