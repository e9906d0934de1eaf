"""Builds the pipeline anew when it fails again and again, a bounded number of times.

A network on a graphics card may not recover from one error, and a state that no test foresaw may fail on every
picture. Until the new pipeline works no plan is sent, as with every failed tick.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from revnm_client.errors import RevnmError
from revnm_server.frame import Frame
from revnm_server.mission import Goal
from revnm_server.pipeline import TickResult

logger = logging.getLogger(__name__)


class StageError(RevnmError):
    """The pipeline failed so often that it is not built anew any more."""


class OwnedPipeline(Protocol):
    """A pipeline that its owner closes."""

    def step(self, frame: Frame, goals: Mapping[str, Goal]) -> TickResult:
        """Process one picture."""
        ...

    def close(self) -> None:
        """Keep what was learnt, and end what runs beside."""
        ...


@dataclass(frozen=True, slots=True)
class RestartLimits:
    """When a pipeline is built anew.

    Attributes:
        failures: Pictures in a row that it failed on.
        pause_s: Least time between two builds; doubled by each, up to ``longest_pause_s``.
        longest_pause_s: See there.
        restarts: Most builds within ``window_s``; after that it stays as it is.
        window_s: See there, seconds.
    """

    failures: int = 3
    pause_s: float = 1.0
    longest_pause_s: float = 30.0
    restarts: int = 5
    window_s: float = 600.0


class RestartingPipeline:
    """Steps a pipeline, and builds another when it keeps failing. Used by one thread.

    Attributes:
        restarts: How often it was built anew.
    """

    def __init__(
        self,
        build: Callable[[], OwnedPipeline],
        *,
        limits: RestartLimits | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Build the first one.

        Args:
            build: Makes a pipeline; what it raises the first time is raised.
            limits: When to build anew.
            now_s: A clock that never jumps.
        """
        self.restarts = 0
        self._build, self._limits, self._now_s = build, limits or RestartLimits(), now_s
        self._pipeline: OwnedPipeline | None = build()
        self._failures = 0
        self._built_s: deque[float] = deque()

    def step(self, frame: Frame, goals: Mapping[str, Goal]) -> TickResult:
        """Process one picture.

        Raises:
            StageError: The pipeline was built anew as often as may be, or could not be built.
            Exception: Whatever the pipeline raised.
        """
        if self._pipeline is None or self._failures >= self._limits.failures:
            self._restart()
        assert self._pipeline is not None
        try:
            result = self._pipeline.step(frame, goals)
        except Exception:
            self._failures += 1
            raise
        self._failures = 0
        return result

    def close(self) -> None:
        """Close the pipeline."""
        if self._pipeline is not None:
            self._pipeline.close()

    def _restart(self) -> None:
        """Build another pipeline, unless that is too soon or was too often."""
        self._check_bounds()
        self._built_s.append(self._now_s())
        self.restarts += 1
        logger.warning("the pipeline failed on %d pictures in a row: building it anew", self._failures)
        failed, self._pipeline = self._pipeline, None
        if failed is not None:
            self._close_failed(failed)
        try:
            self._pipeline = self._build()
        except Exception as error:
            raise StageError(f"the pipeline could not be built anew: {error}") from error
        self._failures = 0

    def _check_bounds(self) -> None:
        limits, now_s = self._limits, self._now_s()
        while self._built_s and now_s - self._built_s[0] > limits.window_s:
            self._built_s.popleft()
        count = len(self._built_s)
        if count >= limits.restarts:
            raise StageError(
                f"the pipeline was built anew {count} times in {limits.window_s / 60:.0f} minutes and fails on: "
                "see the log, mend the cause, restart the server"
            )
        pause_s = min(limits.pause_s * 2.0 ** max(0, count - 1), limits.longest_pause_s)
        if count and now_s - self._built_s[-1] < pause_s:
            raise StageError(f"the pipeline fails: it is built anew after {pause_s:.0f} s")

    def _close_failed(self, failed: OwnedPipeline) -> None:
        try:
            failed.close()
        except Exception:  # it has failed before; what matters is the next one
            logger.exception("the failed pipeline could not be closed")
