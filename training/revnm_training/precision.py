"""Which arithmetic a machine is fast in.

bfloat16 takes half to a third of the time of float32 on processors with instructions for it, and several times as long
on the others, which emulate it.
"""

from __future__ import annotations

from typing import Literal

import torch

Precision = Literal["32-true", "bf16-mixed"]

_CPU_FEATURES = ("amx_bf16", "avx512_bf16", "bf16")


def fast_precision() -> Precision:
    """Return ``bf16-mixed`` where the device that trains computes in bfloat16, else ``32-true``."""
    if torch.cuda.is_available():
        return "bf16-mixed" if torch.cuda.is_bf16_supported(including_emulation=False) else "32-true"
    features = torch.cpu.get_capabilities()
    return "bf16-mixed" if any(features.get(name) for name in _CPU_FEATURES) else "32-true"


def autocast(device: torch.device) -> torch.autocast:
    """Return a context in which networks run in the device's fast arithmetic."""
    return torch.autocast(device.type, torch.bfloat16, enabled=fast_precision() == "bf16-mixed")
