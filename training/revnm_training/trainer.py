"""The training loop that policy, exo2ego and depth share.

AdamW, warm-up then cosine to zero, averaged weights, a checkpoint every few minutes. The order of the data and every
random number follow from seed and step alone, so a run that was stopped, in whatever way, goes on exactly.
"""

from __future__ import annotations

import dataclasses
import math
import signal
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from types import FrameType
from typing import Any, Protocol

import numpy as np
import torch
from lightning_fabric import Fabric
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel
from tqdm import tqdm

from revnm_client.errors import ConfigError, FileError, RevnmError
from revnm_training.checkpoint import Checkpoint, save_checkpoint
from revnm_training.devices import any_rank, average_over_ranks
from revnm_training.preset import TrainConfig
from revnm_training.run_settings import CHECKPOINT, RunSettings, check_kept
from revnm_training.training_log import TrainingLog
from revnm_training.training_plots import plot_losses

Batch = dict[str, Tensor]
_LOG_STEPS = 20
_LONGEST_GRADIENT = 1.0


class Task(Protocol):
    """What is trained: data, loss and validation.

    Attributes:
        kind: Its name, for the checkpoint.
        train_size: Number of training samples.
        data: What the data are, for the checkpoint's record; JSON-able.
    """

    kind: str
    train_size: int
    data: dict[str, Any]

    def batch(self, index: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Gather training samples by number, 0 to ``train_size``, on the CPU."""
        ...

    def loss(self, network: nn.Module, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Return scalars, ``loss`` among them; ``batch`` is on the network's device."""
        ...

    def validate(self, network: nn.Module, device: torch.device) -> dict[str, float]:
        """Measure a network on held-out data; it is in evaluation mode."""
        ...


class Trainer:
    """Trains one network; :meth:`run` does it all."""

    def __init__(
        self, task: Task, network: nn.Module, config: TrainConfig, settings: RunSettings, fabric: Fabric | None = None
    ) -> None:
        """Set up, and load the checkpoint where the run is to be resumed.

        Args:
            task: What is trained.
            network: With the same weights in every process.
            config: How.
            settings: Of the run.
            fabric: Its processes; None opens those of the settings.

        Raises:
            ConfigError: The folder holds a run and ``resume`` is not set, the data are fewer than a batch, or the
                processes cannot share a batch evenly.
            FileError: The checkpoint cannot be resumed.
        """
        self._task, self._config, self._settings = task, config, settings
        if task.train_size < config.batch:
            raise ConfigError(f"{task.train_size} training samples do not fill one batch of {config.batch}")
        self._fabric = fabric or settings.open_fabric()
        if config.batch % (self._fabric.world_size * settings.accumulate):
            raise ConfigError(
                f"a batch of {config.batch} cannot be shared evenly by {self._fabric.world_size} processes"
                f" in {settings.accumulate} parts each"
            )
        self._network = self._fabric.to_device(network.to(memory_format=torch.channels_last))  # type: ignore[call-overload]
        optimizer = torch.optim.AdamW(network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)
        self._optimizer: Any = self._fabric.setup_optimizers(optimizer)
        self._averaged = AveragedModel(network, multi_avg_fn=_average(config.ema), use_buffers=True)
        self._step = 0
        self._record: dict[str, Any] = {"seconds": 0.0, "samples": 0, "data": task.data, "validation": {}}
        checkpoint = settings.begun(task.kind)
        settings.out.mkdir(parents=True, exist_ok=True)
        self._path = settings.out / CHECKPOINT
        if checkpoint is not None:
            self._load(checkpoint)
        self._record["recipe"] = dataclasses.asdict(config)
        self._log = TrainingLog(settings.out, self._step) if self._fabric.is_global_zero else None
        self._order: tuple[int, NDArray[np.int64]] | None = None
        self._window = (self._step, time.monotonic())

    @property
    def step(self) -> int:
        """Steps done."""
        return self._step

    def run(self) -> bool:
        """Train to the end, or until SIGINT or SIGTERM; save either way.

        Returns:
            Whether the end was reached.
        """
        with _stop_signals() as stopped, self._progress() as bar:
            saved_s = time.monotonic()
            while self._step < self._settings.steps and not any_rank(self._fabric, bool(stopped)):
                self._train_step(bar)
                if self._is_validation_step():
                    self._validate()
                if time.monotonic() - saved_s > self._settings.checkpoint_s:
                    self.save()
                    saved_s = time.monotonic()
        self.save()
        return self._step >= self._settings.steps

    def save(self) -> None:
        """Write the checkpoint; one process does."""
        if not self._fabric.is_global_zero:
            return
        settings = self._settings
        checkpoint = Checkpoint(
            kind=self._task.kind,
            preset=settings.preset,
            step=self._step,
            steps=settings.steps,
            seed=settings.seed,
            network=self._network.state_dict(),
            averaged=self._averaged.module.state_dict(),
            optimizer=self._optimizer.state_dict(),
            record=self._record,
        )
        save_checkpoint(self._path, checkpoint)

    def _load(self, checkpoint: Checkpoint) -> None:
        check_kept(self._path, data=(checkpoint.record.get("data"), self._task.data))
        try:
            self._network.load_state_dict(checkpoint.network)
            self._averaged.module.load_state_dict(checkpoint.averaged)
            self._optimizer.load_state_dict(checkpoint.optimizer)
        except (RuntimeError, ValueError) as error:
            raise FileError(f"{self._path}: does not fit the network: {error}") from error
        self._averaged.n_averaged.fill_(checkpoint.step)
        self._step, self._record = checkpoint.step, dict(checkpoint.record)

    def _train_step(self, bar: Any) -> None:
        started_s = time.monotonic()
        rank = self._fabric.global_rank
        rng = np.random.default_rng((self._settings.seed, 1, self._step, *([rank] if rank else [])))
        seed = int(rng.integers(2**62))
        torch.manual_seed(seed)  # dropout and the CVAE's noise
        generator = torch.Generator(self._fabric.device).manual_seed(seed)
        rate = self._config.learning_rate * _schedule(self._step, self._config.warmup_steps, self._settings.steps)
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        self._optimizer.zero_grad()
        losses = self._gradients(self._task.batch(self._index(), rng), generator)
        average_over_ranks(self._fabric, self._network)
        nn.utils.clip_grad_norm_(self._network.parameters(), _LONGEST_GRADIENT)
        self._optimizer.step()
        self._averaged.update_parameters(self._network)
        self._step += 1
        self._report(bar, losses, time.monotonic() - started_s)

    def _gradients(self, batch: Batch, generator: torch.Generator) -> dict[str, Tensor]:
        """Add up the gradients of a batch's parts, each on the device in its turn; return the mean of their losses."""
        count = self._settings.accumulate
        chunks = {name: x.chunk(count) for name, x in batch.items()}
        found: list[dict[str, Tensor]] = []
        for number in range(count):
            part = self._fabric.to_device({name: parts[number] for name, parts in chunks.items()})
            # Not through Fabric's wrapper: it would round poses and waypoints to bfloat16.
            with self._fabric.autocast():
                losses = self._task.loss(self._network.train(), part, generator)
            self._fabric.backward(losses["loss"] / count)
            found.append({name: value.detach() for name, value in losses.items()})
        return {name: torch.stack([losses[name] for losses in found]).mean() for name in found[0]}

    def _index(self) -> NDArray[np.int64]:
        """Return the numbers of this process's samples of this step: every epoch is another permutation."""
        size, batch = self._task.train_size, self._config.batch
        epoch, place = divmod(self._step, size // batch)
        if self._order is None or self._order[0] != epoch:
            rng = np.random.default_rng((self._settings.seed, 2, epoch))
            self._order = (epoch, rng.permutation(size))
        share = batch // self._fabric.world_size
        start = place * batch + self._fabric.global_rank * share
        return self._order[1][start : start + share]

    def _report(self, bar: Any, losses: Mapping[str, Tensor], elapsed_s: float) -> None:
        self._record["seconds"] += elapsed_s
        self._record["samples"] += self._config.batch
        bar.update(1)
        if self._step % _LOG_STEPS and self._step != self._settings.steps:
            return
        row = {name: value.item() for name, value in losses.items()}
        if not math.isfinite(row["loss"]):
            raise RevnmError(f"{self._settings.out}: the loss became {row['loss']} at step {self._step}")
        since_step, since_s = self._window
        self._window = (self._step, time.monotonic())
        rate = (self._step - since_step) * self._config.batch / (self._window[1] - since_s)
        bar.set_postfix(loss=f"{row['loss']:.4f}", samples_per_s=f"{rate:.0f}")
        learning_rate = self._optimizer.param_groups[0]["lr"]
        if self._log is not None:
            self._log.training(self._step, row | {"learning_rate": learning_rate, "samples_per_s": rate})

    def _is_validation_step(self) -> bool:
        count, steps = self._settings.validations, self._settings.steps
        return self._step * count // steps != (self._step - 1) * count // steps

    def _validate(self) -> None:
        if self._log is None:
            return
        network = self._averaged.module.eval()
        with torch.no_grad(), self._fabric.autocast():
            measured = self._task.validate(network, self._fabric.device)
        self._record["validation"] = measured
        self._log.validation(self._step, measured)
        plot_losses(self._settings.out)
        self._window = (self._step, time.monotonic())
        tqdm.write(f"step {self._step}: " + "  ".join(f"{name} {value:.4g}" for name, value in measured.items()))

    def _progress(self) -> Any:
        return tqdm(
            total=self._settings.steps,
            initial=self._step,
            desc=f"train {self._task.kind}",
            unit=" steps",
            disable=not self._fabric.is_global_zero,
        )


def _average(decay: float) -> Any:
    """Return an exponential average whose decay grows from 0.1, so that the start is forgotten soon.

    Counters, the only integers among the buffers of batch normalisation, are copied.
    """

    def update(averaged: list[Tensor], current: list[Tensor], count: Tensor) -> None:
        if not averaged[0].is_floating_point():
            torch._foreach_copy_(averaged, current)
            return
        warm = min(decay, (1.0 + int(count)) / (10.0 + int(count)))
        torch._foreach_lerp_(averaged, current, 1.0 - warm)

    return update


def _schedule(step: int, warmup: int, steps: int) -> float:
    if step < warmup:
        return (step + 1) / warmup
    progress = (step - warmup) / max(1, steps - warmup)
    return 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))


@contextmanager
def _stop_signals() -> Iterator[list[int]]:
    """Collect SIGINT and SIGTERM while inside, instead of dying of them."""
    received: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        received.append(number)

    previous = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
