"""What a bundle's manifest says of its networks and of how they came to be."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from revnm_server.networks.checked_file import file_sha256
from revnm_training.checkpoint import Checkpoint
from revnm_training.kept_part import KeptPart
from revnm_training.preset import Preset


def bundle_manifest(
    preset: Preset,
    checkpoints: Mapping[str, Checkpoint],
    kept: Mapping[str, KeptPart],
    folder: Path,
    benchmark: list[dict[str, Any]],
) -> dict[str, Any]:
    """Return the manifest of a bundle, JSON-able.

    Args:
        preset: Of the bundle.
        checkpoints: Of the networks that were exported, by kind.
        kept: The networks that were taken over, by kind.
        folder: Holds the ONNX files, ``KIND.onnx``, and perhaps ``encoder.onnx``, the policy's first part.
        benchmark: Rows of benchmarks of the bundle.
    """
    parts = {kind: _part(checkpoint) for kind, checkpoint in checkpoints.items()}
    parts |= {kind: {"run": part.run, "data": part.data, "validation": part.validation} for kind, part in kept.items()}
    models = {kind: _entry(preset, kind) | _file_entry(folder / f"{kind}.onnx") for kind in checkpoints}
    models |= {kind: part.entry | _file_entry(folder / f"{kind}.onnx") for kind, part in kept.items()}
    if (folder / "encoder.onnx").exists():
        models["policy"]["encoder"] = _file_entry(folder / "encoder.onnx")
    return {
        "format": 2,
        "name": preset.name,
        "observation": dataclasses.asdict(preset.observation),
        "models": models,
        "recipe": {
            "preset": dataclasses.asdict(preset),
            "runs": {kind: part["run"] for kind, part in parts.items()},
        },
        "data": {kind: part["data"] for kind, part in parts.items()},
        "results": {
            "validation": {kind: part["validation"] for kind, part in parts.items()},
            "benchmark": benchmark,
        },
    }


def _part(checkpoint: Checkpoint) -> dict[str, Any]:
    """Return what a manifest tells of a training run."""
    record = {name: value for name, value in checkpoint.record.items() if name != "validation"}
    return {
        "run": {"seed": checkpoint.seed, "steps": checkpoint.step, "planned_steps": checkpoint.steps, **record},
        "data": checkpoint.record.get("data", {}),
        "validation": checkpoint.record["validation"],
    }


def _file_entry(path: Path) -> dict[str, Any]:
    return {"file": path.name, "sha256": file_sha256(path)}


def _entry(preset: Preset, kind: str) -> dict[str, Any]:
    """Return what the server must know to run a network."""
    if kind == "policy":
        return {"sees": "picture" if preset.map_policy is None else "map"}
    if kind == "exo2ego":
        config = preset.exo2ego
        return {"steps": config.steps, "schedule": "cosine", "prior": config.prior, "noise": config.noise}
    assert preset.depth is not None
    return {"kind": "disparity", "mean": preset.depth.mean, "std": preset.depth.std}
