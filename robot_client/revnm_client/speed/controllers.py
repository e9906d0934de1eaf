"""Times controllers on the same problem: ours, and others that are installed.

Others come in by the entry-point group ``revnm_client.bench_backends``; each is a function that builds a controller
of a :class:`MppiConfig`. The training package has one, pytorch_mppi.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol

import numpy as np

from revnm_client.messages import Velocity
from revnm_client.mppi import Mppi, MppiConfig, MppiInput
from revnm_client.speed import course

GROUP = "revnm_client.bench_backends"
SIZES = {
    "2000x56": MppiConfig(samples=2000, steps=56, dt_s=0.05),  # as Nav2's
    "1000x30": MppiConfig(),
}
_WARM_UP = 20


class Controller(Protocol):
    """What is timed."""

    def plan(self, state: MppiInput) -> Velocity:
        """Return the velocity for the next control period."""
        ...


Backend = Callable[[MppiConfig], Controller]


def backends() -> dict[str, EntryPoint]:
    """Return the other controllers that are installed, by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


def measure_ours(size: str, ticks: int) -> Mapping[str, float]:
    """Return ``p50_ms`` and ``p95_ms`` of our controller with a size of :data:`SIZES`."""
    return _measure(Mppi(SIZES[size]), SIZES[size], ticks)


def measure_other(name: str, size: str, ticks: int) -> Mapping[str, float]:
    """Return the same of another controller.

    Raises:
        RevnmError: It cannot run here; the text says why.
    """
    backend: Backend = backends()[name].load()
    return _measure(backend(SIZES[size]), SIZES[size], ticks)


def _measure(controller: Controller, config: MppiConfig, ticks: int) -> Mapping[str, float]:
    """Time each tick from path and obstacle points to velocity, with the distance field, after some warm-up."""
    taken_ms = []
    states = course.inputs(_WARM_UP + ticks, config.period_s)
    gc.collect()
    for state in states:
        began_s = time.perf_counter()
        controller.plan(state)
        taken_ms.append((time.perf_counter() - began_s) * 1e3)
    p50, p95 = np.percentile(taken_ms[_WARM_UP:], (50, 95))
    return {"p50_ms": round(float(p50), 2), "p95_ms": round(float(p95), 2)}
