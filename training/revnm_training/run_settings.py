"""What tells one training run from another, and whether a folder's run can go on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightning_fabric import Fabric

from revnm_client.errors import ConfigError, FileError
from revnm_training.checkpoint import Checkpoint, load_checkpoint
from revnm_training.devices import open_fabric
from revnm_training.precision import Precision

CHECKPOINT = "last.pt"


@dataclass(frozen=True, slots=True)
class RunSettings:
    """One run.

    Attributes:
        out: Folder for checkpoint and logs.
        preset: Name of the preset, for the checkpoint.
        steps: Length of the run and of its schedule.
        seed: Of everything random.
        precision: Of the arithmetic; see :func:`revnm_training.precision.fast_precision`.
        resume: Go on from the folder's checkpoint.
        checkpoint_s: Time between two checkpoints.
        validations: How often to validate, evenly spread, the last at the end.
        devices: Of each machine.
        nodes: Machines.
        accumulate: Parts in which each process computes its share of a batch, one after the other, where it does not
            fit the device's memory; 1 or more. Batch normalisation sees the parts.

    Raises:
        ConfigError: ``accumulate`` is less than 1.
    """

    out: Path
    preset: str
    steps: int
    seed: int
    precision: Precision = "bf16-mixed"
    resume: bool = False
    checkpoint_s: float = 120.0
    validations: int = 5
    devices: int = 1
    nodes: int = 1
    accumulate: int = 1

    def __post_init__(self) -> None:
        if self.accumulate < 1:
            raise ConfigError(f"--accumulate {self.accumulate}: expected 1 or more")

    def open_fabric(self) -> Fabric:
        """Start the run's processes; see :func:`revnm_training.devices.open_fabric`."""
        return open_fabric(devices=self.devices, nodes=self.nodes, precision=self.precision)

    def begun(self, kind: str) -> Checkpoint | None:
        """Return the checkpoint that the run goes on from; None where it begins.

        Called before any work, too: what does not fit is told at once.

        Raises:
            ConfigError: A run is there, but ``resume`` is not set.
            FileError: The checkpoint is of another kind, preset, seed or length.
        """
        path = self.out / CHECKPOINT
        if not path.exists():
            return None
        if not self.resume:
            raise ConfigError(f"{path}: a run is there already: resume it or name another folder")
        checkpoint = load_checkpoint(path, kind)
        check_kept(
            path,
            preset=(checkpoint.preset, self.preset),
            seed=(checkpoint.seed, self.seed),
            steps=(checkpoint.steps, self.steps),
        )
        return checkpoint


def check_kept(path: Path, **kept_and_asked: tuple[Any, Any]) -> None:
    """Compare what a checkpoint has with what is asked for, by name.

    Raises:
        FileError: They differ.
    """
    for name, (kept, asked) in kept_and_asked.items():
        if kept != asked:
            raise FileError(f"{path}: {name} {kept}, but asked for {asked}: a resumed run keeps it")
