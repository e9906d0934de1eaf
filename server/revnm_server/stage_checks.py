"""What every tick does around its stages: measures how long they take, and checks what they give."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32


@contextmanager
def timed(timings_ms: dict[str, float], stage: str) -> Iterator[None]:
    """Add how long the block took to the stage, milliseconds."""
    start = time.perf_counter()
    yield
    timings_ms[stage] = timings_ms.get(stage, 0.0) + (time.perf_counter() - start) * 1e3


def check_array(what: str, array: Image32 | FloatArray, shape: tuple[int, ...]) -> None:
    """Check what a stage gave.

    Raises:
        ContractError: It has another shape, or values that are not finite.
    """
    if array.shape != shape:
        raise ContractError(f"{what}: shape expected {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ContractError(f"{what}: values that are not finite")
