"""Measures the true speed of the simulated robot, by the test's own clock."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from revnm_sim.simulation import Simulation

STANDS_MPS = 0.01
_WINDOW_NS = 50_000_000
_POLL_S = 0.004


class _Sample(NamedTuple):
    at_s: float
    time_ns: int
    path_m: float


class SpeedGauge:
    """Takes mean speeds over 50 ms of simulated time, so that a simulation that hangs is no robot that stands."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation

    def wait_faster(self, than_mps: float, *, within_s: float) -> None:
        """Wait until the robot drives faster than that."""
        self._wait(lambda speed_mps: speed_mps > than_mps, within_s)

    def wait_standing(self, *, within_s: float) -> float:
        """Wait until the robot stands; return since when it does, monotonic clock, seconds."""
        return self._wait(lambda speed_mps: speed_mps < STANDS_MPS, within_s)

    def _wait(self, fulfilled: Callable[[float], bool], within_s: float) -> float:
        """Wait for a speed; return when its window began."""
        samples: deque[_Sample] = deque()
        pause = threading.Event()
        deadline_s = time.monotonic() + within_s
        speed_mps = None
        while time.monotonic() < deadline_s:
            samples.append(_Sample(time.monotonic(), self._simulation.time_ns, self._simulation.path_m))
            while len(samples) > 1 and samples[-1].time_ns - samples[1].time_ns >= _WINDOW_NS:
                samples.popleft()
            span_ns = samples[-1].time_ns - samples[0].time_ns
            if span_ns >= _WINDOW_NS:
                speed_mps = (samples[-1].path_m - samples[0].path_m) / (span_ns * 1e-9)
                if fulfilled(speed_mps):
                    return samples[0].at_s
            pause.wait(_POLL_S)
        raise AssertionError(f"not within {within_s} s; the last speed was {speed_mps} m/s")
