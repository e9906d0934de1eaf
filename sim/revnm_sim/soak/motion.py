"""When a simulated robot moved last, by the clock on the wall."""

from __future__ import annotations

import threading
import time
from collections import deque

from revnm_sim.simulation import Simulation

STANDS_MPS = 0.02
_WINDOW_NS = 25_000_000
_POLL_S = 0.004


def last_motion_s(simulation: Simulation, *, until_s: float) -> float | None:
    """Watch a robot that a simulator moves in another thread; return when it was last as fast as 0.02 m/s.

    Speeds are means over 25 ms of simulated time, so that a simulation that hangs is no robot that stands; each counts
    at the end of its window.

    Args:
        simulation: Of the robot.
        until_s: How long to watch, monotonic clock, seconds.

    Returns:
        Monotonic clock, seconds; None if it stood all the time.
    """
    samples: deque[tuple[int, float]] = deque()
    pause, last_s = threading.Event(), None
    while (now_s := time.monotonic()) < until_s:
        samples.append((simulation.time_ns, simulation.path_m))
        while len(samples) > 2 and samples[-1][0] - samples[1][0] >= _WINDOW_NS:
            samples.popleft()
        span_ns = samples[-1][0] - samples[0][0]
        if span_ns >= _WINDOW_NS and samples[-1][1] - samples[0][1] >= STANDS_MPS * span_ns * 1e-9:
            last_s = now_s
        pause.wait(_POLL_S)
    return last_s
