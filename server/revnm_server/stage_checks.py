"""What every tick does around its stages: measures how long they take, and checks what they give."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32


@contextmanager
def timed(timings_ms: dict[str, float], stage: str) -> Iterator[None]:
    """Add how long the block took to the stage, milliseconds."""
    start = time.perf_counter()
    yield
    timings_ms[stage] = timings_ms.get(stage, 0.0) + (time.perf_counter() - start) * 1e3


def check_shape(what: str, array: NDArray[Any], shape: tuple[int, ...]) -> None:
    """Check the shape of an array that compiled loops read, which look at no bounds.

    Raises:
        ContractError: It is another one.
    """
    if array.shape != shape:
        raise ContractError(f"{what}: shape expected {shape}, got {array.shape}")


def check_array(what: str, array: Image32 | FloatArray, shape: tuple[int, ...]) -> None:
    """Check what a stage gave.

    Raises:
        ContractError: It has another shape, or values that are not finite.
    """
    check_shape(what, array, shape)
    if not np.isfinite(array).all():
        raise ContractError(f"{what}: values that are not finite")
