"""When the next tick is due."""

from __future__ import annotations

import math


class Pacer:
    """Due times start + k · period: no drift, and no burst of late ticks after a stall."""

    def __init__(self, period_s: float, start_s: float) -> None:
        self._period_s = period_s
        self._start_s = start_s
        self._index = 0

    def next_due_s(self, now_s: float) -> float:
        """Return when the next tick is due; due times that have passed already are left out."""
        passed = math.ceil((now_s - self._start_s) / self._period_s)
        self._index = max(self._index + 1, passed)
        return self._start_s + self._index * self._period_s
