"""How long the stages of a tick took."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from revnm_server.views.view import TimingView

_KEPT = 200


class Timings:
    """The last durations of each stage, and how many there were, and their sum."""

    def __init__(self) -> None:
        self._kept_ms: dict[str, deque[float]] = {}
        self._totals_ms: dict[str, tuple[int, float]] = {}

    def add(self, timings_ms: Mapping[str, float]) -> None:
        """Take the durations of one tick."""
        for stage, duration_ms in timings_ms.items():
            self._kept_ms.setdefault(stage, deque(maxlen=_KEPT)).append(duration_ms)
            count, sum_ms = self._totals_ms.get(stage, (0, 0.0))
            self._totals_ms[stage] = count + 1, sum_ms + duration_ms

    def totals_ms(self) -> dict[str, tuple[int, float]]:
        """Return by stage how often it ran and how long it took in all, milliseconds."""
        return dict(self._totals_ms)

    def view(self) -> dict[str, TimingView]:
        """Return the percentiles by stage."""
        return {
            stage: TimingView(*(round(float(p), 2) for p in np.percentile(list(kept), (50, 95))))
            for stage, kept in self._kept_ms.items()
        }
