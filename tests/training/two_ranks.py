"""Trains a tiny network in each process of ``torchrun``: writes ``last.pt``, and what each process ended with."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional

from revnm_training.preset import TrainConfig
from revnm_training.run_settings import RunSettings
from revnm_training.trainer import Trainer

CONFIG = TrainConfig(learning_rate=0.02, weight_decay=0.01, batch=8, warmup_steps=3, ema=0.9, kl_weight=0.0)


class PlaneTask:
    """Learns y = 3 x0 − 2 x1; nothing in it is random."""

    kind = "policy"
    train_size = 40

    def __init__(self) -> None:
        self.data = {"train_samples": self.train_size}
        self._x = torch.randn(self.train_size, 2, generator=torch.Generator().manual_seed(5))

    def batch(self, index, rng):
        x = self._x[index]
        return {"x": x, "y": x @ torch.tensor([3.0, -2.0])}

    def loss(self, network, batch, generator):
        return {"loss": functional.mse_loss(network(batch["x"])[:, 0], batch["y"])}

    def validate(self, network, device):
        return {"mse": float(functional.mse_loss(network(self._x)[:, 0], self._x @ torch.tensor([3.0, -2.0])))}


def train(out: Path, *, devices: int, resume: bool = False, steps: int = 12) -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)
    network = nn.Sequential(nn.Linear(2, 16), nn.ReLU(), nn.Linear(16, 1))
    settings = RunSettings(
        out, "tiny", steps=steps, seed=1, precision="32-true", resume=resume, validations=2, devices=devices
    )
    fabric = settings.open_fabric()
    assert Trainer(PlaneTask(), network, CONFIG, settings, fabric).run()
    torch.save(network.state_dict(), out / f"rank_{fabric.global_rank}.pt")


if __name__ == "__main__":
    train(Path(sys.argv[1]), devices=2)
