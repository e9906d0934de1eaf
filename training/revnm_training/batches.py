"""Turns rendered arrays into training batches: gathering, scaling, mirroring, noise.

B batch, N frames of history, H waypoints. Mirroring left and right gives another world that is as good, so it doubles
the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from revnm_training.sample_set import Rows

_NOISE = 0.01


def gather(columns: Mapping[str, Rows], names: Sequence[str], index: NDArray[np.int64]) -> dict[str, Tensor]:
    """Copy items of memory-mapped columns into tensors, in the order of ``index``."""
    order = np.argsort(index)  # neighbours in a file are read together
    back, ascending = np.argsort(order), index[order]
    # A batch in file order would give its first half, which the diffusion loss treats apart, to the first worlds.
    return {name: torch.from_numpy(np.ascontiguousarray(columns[name][ascending])[back]) for name in names}


def unit(values: Tensor) -> Tensor:
    """Map bytes to float32 in [0, 1]."""
    return values.float() / 255.0


def signed(values: Tensor) -> Tensor:
    """Map bytes to float32 in [−1, 1]."""
    return values.float() / 127.5 - 1.0


def mirror(batch: Mapping[str, Tensor], generator: torch.Generator) -> dict[str, Tensor]:
    """Mirror about half of the samples left to right.

    Args:
        batch: Any of ``exo``, ``crop``, ``prior``, ``ego``, ``map``, ``occupied``, ``cost`` (B, …, w), ``rgb``
            (B, h, w, 3), ``disparity`` (B, h, w), ``robot``, ``goal`` (B, 2) normalised pixels, ``heading`` (B, 2),
            ``way``, ``waypoints`` (B, H, 2) and ``aim`` (B, 2) metres, robot frame.
        generator: Decides which.
    """
    first = next(iter(batch.values()))
    chosen = torch.rand(len(first), generator=generator, device=first.device) < 0.5
    return {name: torch.where(chosen.view(-1, *[1] * (x.ndim - 1)), _mirrored(name, x), x) for name, x in batch.items()}


def _mirrored(name: str, x: Tensor) -> Tensor:
    if name in {"robot", "goal"}:
        return torch.stack([1.0 - x[:, 0], x[:, 1]], dim=1)
    if name == "heading":
        return x * x.new_tensor([-1.0, 1.0])
    if name in {"waypoints", "way", "aim"}:
        return x * x.new_tensor([1.0, -1.0])
    if name == "rgb":
        return x.flip(2)
    return x.flip(-1)


def add_noise(images: Tensor, generator: torch.Generator) -> Tensor:
    """Add noise to images (B, …) in [0, 1], of another strength for each, at most 0.01."""
    strength = torch.rand(len(images), generator=generator, device=images.device) * _NOISE
    noise = torch.randn(images.shape, generator=generator, device=images.device)
    return (images + strength.view(-1, *[1] * (images.ndim - 1)) * noise).clamp(0.0, 1.0)
