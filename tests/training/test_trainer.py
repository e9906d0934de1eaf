from __future__ import annotations

import os
import signal
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from torch.nn import functional

from revnm_client.errors import ConfigError, FileError
from revnm_training.batches import gather, mirror
from revnm_training.checkpoint import load_checkpoint
from revnm_training.preset import TrainConfig
from revnm_training.run_settings import RunSettings
from revnm_training.train_policy import waypoint_errors
from revnm_training.trainer import Trainer

CONFIG = TrainConfig(learning_rate=0.02, weight_decay=0.0, batch=8, warmup_steps=3, ema=0.9, kl_weight=0.0)
STEPS = 24


@pytest.fixture(autouse=True, scope="module")
def _one_thread():
    """Tiny tensors gain nothing from threads, and on a busy machine those wait for each other."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


class LineTask:
    """Learns y = 3 x0 − 2 x1 through a network with dropout and batch normalisation."""

    kind = "policy"
    train_size = 30

    def __init__(self, stop_at: int | None = None, *, crash: bool = False) -> None:
        self.data = {"train_samples": self.train_size}
        self.seen: list[list[int]] = []
        self._x = torch.randn(self.train_size, 2, generator=torch.Generator().manual_seed(5))
        self._stop_at, self._crash = stop_at, crash

    def batch(self, index, rng):
        self.seen.append(index.tolist())
        if len(self.seen) == self._stop_at:
            if self._crash:
                raise RuntimeError("power cut")
            os.kill(os.getpid(), signal.SIGINT)
        x = self._x[index]
        return {"x": x, "y": x @ torch.tensor([3.0, -2.0])}

    def loss(self, network, batch, generator):
        noise = 0.01 * torch.randn(batch["x"].shape, generator=generator)
        return {"loss": functional.mse_loss(network(batch["x"] + noise)[:, 0], batch["y"])}

    def validate(self, network, device):
        assert not network.training
        y = self._x @ torch.tensor([3.0, -2.0])
        return {"mse": float(functional.mse_loss(network(self._x)[:, 0], y))}


def network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Linear(2, 16), nn.BatchNorm1d(16), nn.Dropout(0.1), nn.Linear(16, 1))


def settings(out: Path, **changes) -> RunSettings:
    base = RunSettings(out=out, preset="tiny", steps=STEPS, seed=1, precision="32-true", validations=2)
    return replace(base, **changes)


def final_state(folder: Path):
    checkpoint = load_checkpoint(folder / "last.pt", "policy")
    assert checkpoint.step == STEPS
    return checkpoint


def assert_same(a, b) -> None:
    for states in ((a.network, b.network), (a.averaged, b.averaged)):
        assert states[0].keys() == states[1].keys()
        for name, tensor in states[0].items():
            assert torch.equal(tensor, states[1][name]), name
    assert a.record["validation"] == b.record["validation"]
    assert a.record["samples"] == b.record["samples"] == STEPS * CONFIG.batch


@pytest.mark.parametrize("crash", [False, True])
def test_a_stopped_run_goes_on_exactly(tmp_path, crash) -> None:
    whole = LineTask()
    assert Trainer(whole, network(), CONFIG, settings(tmp_path / "whole")).run()

    first = LineTask(stop_at=10, crash=crash)
    trainer = Trainer(first, network(), CONFIG, settings(tmp_path / "parts", checkpoint_s=0.0))
    if crash:
        with pytest.raises(RuntimeError):
            trainer.run()
    else:
        assert not trainer.run()
    done = load_checkpoint(tmp_path / "parts" / "last.pt", "policy").step
    assert done == (9 if crash else 10)

    second = LineTask()
    assert Trainer(second, network(), CONFIG, settings(tmp_path / "parts", resume=True)).run()
    assert first.seen[:done] + second.seen == whole.seen
    assert_same(final_state(tmp_path / "whole"), final_state(tmp_path / "parts"))
    logs = [(tmp_path / name / "validation.csv").read_text() for name in ("whole", "parts")]
    assert logs[0] == logs[1]
    assert logs[0].splitlines()[0] == "step,mse"
    assert len(logs[0].splitlines()) == 3


class CopyTask(LineTask):
    """Without noise, so that what a batch teaches is known."""

    def loss(self, network, batch, generator):
        return {"loss": functional.mse_loss(network(batch["x"])[:, 0], batch["y"])}


def test_a_batch_in_parts_teaches_what_it_teaches_whole(tmp_path) -> None:
    trained = []
    for parts in (1, 4):
        torch.manual_seed(0)
        out = tmp_path / str(parts)
        Trainer(CopyTask(), nn.Linear(2, 1), CONFIG, settings(out, accumulate=parts)).run()
        trained.append(final_state(out).network)
    for name, tensor in trained[0].items():
        assert torch.allclose(tensor, trained[1][name], atol=1e-5), name
    with pytest.raises(ConfigError, match="a batch of 8 cannot be shared evenly by 1 processes in 3 parts each"):
        Trainer(CopyTask(), nn.Linear(2, 1), CONFIG, settings(tmp_path / "odd", accumulate=3))
    with pytest.raises(ConfigError, match="--accumulate 0: expected 1 or more"):
        settings(tmp_path, accumulate=0)


def test_an_epoch_shows_every_sample_at_most_once(tmp_path) -> None:
    task = LineTask()
    Trainer(task, network(), CONFIG, settings(tmp_path)).run()
    batches = task.train_size // CONFIG.batch  # 3 batches of 8 fit into 30
    for epoch in range(STEPS // batches):
        seen = list(chain(*task.seen[epoch * batches : (epoch + 1) * batches]))
        assert len(seen) == len(set(seen)) == 24
    assert task.seen[0] != task.seen[batches]


def test_the_loss_falls(tmp_path) -> None:
    Trainer(LineTask(), network(), CONFIG, settings(tmp_path, steps=400)).run()
    record = load_checkpoint(tmp_path / "last.pt", "policy").record
    assert record["validation"]["mse"] < 0.5  # y has variance 13
    assert record["seconds"] > 0
    assert record["recipe"]["learning_rate"] == CONFIG.learning_rate  # not always the preset's: see DAgger


def test_a_run_is_not_overwritten_nor_resumed_as_another(tmp_path) -> None:
    Trainer(LineTask(), network(), CONFIG, settings(tmp_path)).run()
    with pytest.raises(ConfigError, match="a run is there already"):
        Trainer(LineTask(), network(), CONFIG, settings(tmp_path))
    with pytest.raises(FileError, match="seed 1"):
        Trainer(LineTask(), network(), CONFIG, settings(tmp_path, resume=True, seed=2))
    with pytest.raises(FileError, match="preset tiny, but asked for huge"):
        Trainer(LineTask(), network(), CONFIG, settings(tmp_path, resume=True, preset="huge"))
    with pytest.raises(FileError, match="does not fit the network"):
        Trainer(LineTask(), nn.Linear(2, 1), CONFIG, settings(tmp_path, resume=True))
    more = LineTask()
    more.data = {"train_samples": 31}
    with pytest.raises(FileError, match=r"data .*30.*, but asked for .*31"):
        Trainer(more, network(), CONFIG, settings(tmp_path, resume=True))
    with pytest.raises(FileError, match="kind 'policy', expected 'depth'"):
        load_checkpoint(tmp_path / "last.pt", "depth")


def test_a_batch_keeps_the_order_that_was_asked_for() -> None:
    columns = {"x": np.arange(50) * 10, "y": np.arange(100).reshape(50, 2)}
    index = np.array([7, 3, 42, 0, 9])
    batch = gather(columns, ("x", "y"), index)
    assert batch["x"].tolist() == [70, 30, 420, 0, 90]
    assert batch["y"][:, 0].tolist() == [14, 6, 84, 0, 18]


def test_a_truncated_checkpoint_is_refused_by_name(tmp_path) -> None:
    Trainer(LineTask(), network(), CONFIG, settings(tmp_path)).run()
    path = tmp_path / "last.pt"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FileError, match=r"last\.pt"):
        load_checkpoint(path, "policy")


def test_too_few_samples_are_refused(tmp_path) -> None:
    with pytest.raises(ConfigError, match="30 training samples"):
        Trainer(LineTask(), network(), replace(CONFIG, batch=64), settings(tmp_path))


def test_waypoint_errors_by_hand() -> None:
    true = np.array([[[1.0, 0.0], [2.0, 0.0]]], dtype=np.float32)
    predicted = np.array([[[1.0, 0.3], [0.0, 2.0]]], dtype=np.float32)
    errors = waypoint_errors(predicted, true)
    assert errors["waypoint_1_m"] == pytest.approx(0.3)
    assert errors["waypoint_2_m"] == pytest.approx(8**0.5)
    assert errors["l1_m"] == pytest.approx((0.3 + 2 + 2) / 4)
    assert errors["first_deg"] == pytest.approx(np.degrees(np.arctan2(0.3, 1.0)))
    assert errors["last_deg"] == pytest.approx(90.0)


def test_mirroring_twice_is_nothing_and_once_flips_left_and_right() -> None:
    batch = {
        "exo": torch.rand(6, 1, 4, 5),
        "robot": torch.rand(6, 2),
        "heading": torch.rand(6, 2),
        "waypoints": torch.rand(6, 3, 2),
    }
    once = mirror(batch, torch.Generator().manual_seed(0))
    twice = mirror(once, torch.Generator().manual_seed(0))
    for name, x in batch.items():
        assert torch.allclose(twice[name], x)
    flipped = (once["robot"] != batch["robot"]).any(dim=1)
    assert 0 < flipped.sum() < 6
    k = int(flipped.nonzero()[0])
    assert once["robot"][k, 0] == pytest.approx(1.0 - float(batch["robot"][k, 0]))
    assert torch.equal(once["exo"][k, 0, :, 0], batch["exo"][k, 0, :, -1])
    assert torch.equal(once["waypoints"][k, :, 1], -batch["waypoints"][k, :, 1])
    assert torch.equal(once["waypoints"][k, :, 0], batch["waypoints"][k, :, 0])


def test_half_precision_leaves_poses_and_labels_alone(tmp_path) -> None:
    class Watching(LineTask):
        def loss(self, network, batch, generator):
            assert {x.dtype for x in batch.values()} == {torch.float32}
            assert network(batch["x"]).dtype == torch.bfloat16
            return super().loss(network, batch, generator)

    Trainer(Watching(), network(), CONFIG, settings(tmp_path, steps=2, precision="bf16-mixed")).run()
