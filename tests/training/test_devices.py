"""Two processes train what one trains: through torchrun, and through the command itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from revnm_client.errors import ConfigError
from revnm_training.checkpoint import load_checkpoint
from revnm_training.run_settings import RunSettings
from revnm_training.trainer import Trainer

from .two_ranks import CONFIG, PlaneTask, train


def test_two_processes_train_what_one_does(tmp_path: Path) -> None:
    (tmp_path / "two").mkdir()
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    script = Path(__file__).with_name("two_ranks.py")
    subprocess.run([*command, str(script), str(tmp_path / "two")], check=True, timeout=120, env=_one_thread())
    ranks = [torch.load(tmp_path / "two" / f"rank_{rank}.pt", weights_only=True) for rank in range(2)]
    train(tmp_path / "one", devices=1)
    one, two = (load_checkpoint(tmp_path / name / "last.pt", "policy") for name in ("one", "two"))
    for name, weights in one.network.items():
        assert torch.equal(ranks[0][name], ranks[1][name])
        torch.testing.assert_close(two.network[name], weights, rtol=1e-4, atol=1e-6)
        torch.testing.assert_close(two.averaged[name], one.averaged[name], rtol=1e-4, atol=1e-6)
    assert two.record["samples"] == one.record["samples"] == 12 * CONFIG.batch
    assert two.record["validation"]["mse"] == pytest.approx(one.record["validation"]["mse"], rel=1e-3)
    logs = [(tmp_path / name / "training.csv").read_text().splitlines() for name in ("one", "two")]
    assert len(logs[0]) == len(logs[1]) == 2


def test_a_batch_that_cannot_be_shared_is_told(tmp_path: Path) -> None:
    class ThreeProcesses:
        world_size = 3

    settings = RunSettings(tmp_path, "tiny", steps=1, seed=1)
    with pytest.raises(ConfigError, match="a batch of 8 cannot be shared evenly by 3 processes"):
        Trainer(PlaneTask(), torch.nn.Linear(2, 1), CONFIG, settings, ThreeProcesses())


def _one_thread() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1"}
