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
from revnm_server.robots.mission import Goal
from revnm_server.tick.pipeline import TickResult

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
        failures: It failed on so many...
        pictures: ...of so many pictures; with some pipelines a failure shows at every second one only.
        pause_s: Least time between two builds, after the first; doubled by each, up to ``longest_pause_s``.
        longest_pause_s: See there.
        restarts: Most builds within ``window_s``; after that it stays as it is.
        window_s: See there, seconds.
    """

    failures: int = 5
    pictures: int = 10
    pause_s: float = 1.0
    longest_pause_s: float = 30.0
    restarts: int = 8
    window_s: float = 600.0


class RestartingPipeline:
    """Steps a pipeline, and builds another when it keeps failing. Used by one thread.

    Attributes:
        restarts: How often it was built anew.
    """

    def __init__(
        self,
        pipeline: OwnedPipeline,
        build: Callable[[], OwnedPipeline],
        *,
        limits: RestartLimits | None = None,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin with a pipeline.

        Args:
            pipeline: The first one; closed by this.
            build: Makes another.
            limits: When to build anew.
            now_s: A clock that never jumps.
        """
        self.restarts = 0
        self._build, self._limits, self._now_s = build, limits or RestartLimits(), now_s
        self._pipeline: OwnedPipeline | None = pipeline
        self._failed: deque[bool] = deque(maxlen=self._limits.pictures)
        self._cause = ""
        self._built_s: deque[float] = deque()

    def step(self, frame: Frame, goals: Mapping[str, Goal]) -> TickResult:
        """Process one picture.

        Raises:
            StageError: The pipeline was built anew as often as may be, or could not be built.
            Exception: Whatever the pipeline raised.
        """
        if self._pipeline is None or sum(self._failed) >= self._limits.failures:
            self._restart()
        assert self._pipeline is not None
        try:
            result = self._pipeline.step(frame, goals)
        except Exception as error:
            self._failed.append(True)
            self._cause = str(error)
            raise
        self._failed.append(False)
        return result

    def close(self) -> None:
        """Close the pipeline."""
        if self._pipeline is not None:
            self._pipeline.close()

    def _restart(self) -> None:
        """Build another pipeline, unless that is too soon or was too often."""
        self._check_bounds()
        self.restarts += 1
        logger.warning("the pipeline keeps failing (%s): building it anew", self._cause)
        self._close_failed()
        try:
            self._pipeline = self._build()
        except Exception as error:
            self._cause = str(error)
            raise StageError(f"the pipeline could not be built anew: {error}") from error
        finally:
            self._built_s.append(self._now_s())
        self._failed.clear()

    def _check_bounds(self) -> None:
        limits, now_s = self._limits, self._now_s()
        while self._built_s and now_s - self._built_s[0] > limits.window_s:
            self._built_s.popleft()
        count = len(self._built_s)
        if count >= limits.restarts:
            raise StageError(
                f"the pipeline was built anew {count} times in {limits.window_s / 60:.0f} minutes, and it still fails: "
                f"{self._cause}"
            )
        pause_s = min(limits.pause_s * 2.0 ** max(0, count - 1), limits.longest_pause_s)
        if count and now_s - self._built_s[-1] < pause_s:
            raise StageError(f"the pipeline fails, and is built anew after {pause_s:.0f} s: {self._cause}")

    def _close_failed(self) -> None:
        """Close the failed pipeline and let go of it: there may be no memory for two."""
        failed, self._pipeline = self._pipeline, None
        try:
            if failed is not None:
                failed.close()
        except Exception:  # it has failed before; what matters is the next one
            logger.exception("the failed pipeline could not be closed")
