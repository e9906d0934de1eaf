"""Checkpoints: what a training run needs to go on, and what the export reads.

Loaded with ``weights_only``: a checkpoint can hold tensors, numbers and text, never code.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from revnm_client.errors import FileError

FORMAT = 1


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The state of a training run after a step.

    Attributes:
        kind: What is trained: ``policy``, ``exo2ego`` or ``depth``.
        preset: Name of the preset.
        step: Steps done.
        steps: Steps of the whole run.
        seed: Of the run; with the step it gives the order of the data and every random number.
        network: Weights as trained.
        averaged: Averaged weights: these are validated and exported.
        optimizer: State of the optimizer.
        record: For people and manifests: seconds trained, samples seen, recipe, machine, last validation.
    """

    kind: str
    preset: str
    step: int
    steps: int
    seed: int
    network: dict[str, Tensor]
    averaged: dict[str, Tensor]
    optimizer: dict[str, Any]
    record: dict[str, Any]


def save_checkpoint(path: Path, checkpoint: Checkpoint) -> None:
    """Write a checkpoint; it appears whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    content = {"format": FORMAT} | {name: getattr(checkpoint, name) for name in Checkpoint.__slots__}
    torch.save(content, partial)
    partial.replace(path)


def load_checkpoint(path: Path, kind: str) -> Checkpoint:
    """Read a checkpoint onto the CPU.

    Raises:
        FileError: The file is missing, damaged, no checkpoint of this format, or of another kind.
    """
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises whatever its zip and pickle readers meet
        raise FileError(f"{path}: no readable checkpoint: {error}") from error
    if not isinstance(content, dict) or content.pop("format", None) != FORMAT:
        raise FileError(f"{path}: no checkpoint of format {FORMAT}")
    if set(content) != set(Checkpoint.__slots__):
        raise FileError(f"{path}: keys {sorted(content)} are not {sorted(Checkpoint.__slots__)}")
    if content["kind"] != kind:
        raise FileError(f"{path}: a checkpoint of kind {content['kind']!r}, expected {kind!r}")
    return Checkpoint(**content)


def load_trained(path: Path, kind: str, preset: str) -> Checkpoint:
    """Read a checkpoint of a preset.

    Raises:
        FileError: As :func:`load_checkpoint`, or it is of another preset.
    """
    checkpoint = load_checkpoint(path, kind)
    if checkpoint.preset != preset:
        raise FileError(f"{path}: trained with preset {checkpoint.preset!r}, not {preset!r}")
    return checkpoint


def fill(network: nn.Module, checkpoint: Checkpoint, path: Path) -> None:
    """Fill a network with a checkpoint's averaged weights.

    Raises:
        FileError: The weights are not the network's; the text names the path.
    """
    try:
        network.load_state_dict(checkpoint.averaged)
    except RuntimeError as error:
        what = f"weights do not fit the {checkpoint.kind} network of preset {checkpoint.preset!r}"
        raise FileError(f"{path}: {what}: {error}") from error


def save_weights(checkpoints: Mapping[str, Path], folder: Path) -> None:
    """Write the averaged weights of checkpoints, by kind, in half precision and without what only their runs need.

    Other runs begin with them and bundles are exported from them; the runs themselves cannot go on from them.

    Raises:
        FileError: As :func:`load_checkpoint`.
    """
    loaded = {kind: load_checkpoint(path, kind) for kind, path in checkpoints.items()}
    folder.mkdir(parents=True, exist_ok=True)
    for kind, checkpoint in loaded.items():
        averaged = {name: x.half() if x.is_floating_point() else x for name, x in checkpoint.averaged.items()}
        save_checkpoint(folder / f"{kind}.pt", replace(checkpoint, network={}, averaged=averaged, optimizer={}))
