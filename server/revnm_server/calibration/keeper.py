"""Keeps one camera's calibration on disk while it is learnt: when it becomes good, now and then, and at the end.

A file that was refused is left as it is until there is a good calibration to put in its place; then it is moved aside.
Writing happens in a thread of its own, so that nobody waits for the disk.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from revnm_client.errors import FileError
from revnm_server.calibration.adjustment import Belief
from revnm_server.calibration.store import load_belief, save_belief

logger = logging.getLogger(__name__)

_INTERVAL_S = 30.0


class _Version(NamedTuple):
    """What is to be kept, of pictures of a size."""

    size_px: tuple[int, int]
    belief: Belief

    def same(self, other: _Version | None) -> bool:
        if other is None or self.size_px != other.size_px:
            return False
        mine, yours = self.belief, other.belief
        return np.array_equal(mine.mean, yours.mean) and np.array_equal(mine.covariance, yours.covariance)


class CalibrationKeeper:
    """Loads and saves the calibration of one camera.

    Attributes:
        trouble: Why a file was refused or could not be written, if so.
    """

    def __init__(
        self,
        folder: Path,
        camera: str,
        *,
        interval_s: float = _INTERVAL_S,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Keep it in ``folder/camera.json``.

        Args:
            folder: Is made when it is needed.
            camera: Its name.
            interval_s: Changes are saved no more often.
            now_s: Monotonic clock.
        """
        self.trouble: str | None = None
        self._path, self._camera = folder / f"{camera}.json", camera
        self._interval_s, self._now_s = interval_s, now_s
        self._refused = False
        self._was_good = False
        self._wanted: _Version | None = None
        self._saved: _Version | None = None
        self._tried_s = now_s()
        self._writer: threading.Thread | None = None

    def load(self, size_px: tuple[int, int]) -> Belief | None:
        """Return what was kept of the camera with pictures of a size; None if there is nothing, or nothing sound."""
        self._join()
        self._wanted, self._was_good, self.trouble = None, False, None
        try:
            belief = load_belief(self._path, self._camera, size_px)
        except FileError as error:
            self._refused, self.trouble = True, f"{error}: refused, the camera is learnt anew"
            logger.warning(self.trouble)
            return None
        if belief is not None:
            self._saved, self._was_good, self._refused = _Version(size_px, belief), True, False
        return belief

    def offer(self, size_px: tuple[int, int], belief: Belief, *, good: bool) -> None:
        """Say what is known now; it is saved if that is due.

        Args:
            size_px: Of the camera's pictures.
            belief: What is known.
            good: Only then is it worth keeping.
        """
        became_good, self._was_good = good and not self._was_good, good
        self._wanted = _Version(size_px, belief) if good else None
        due = became_good or self._now_s() - self._tried_s >= self._interval_s
        if self._wanted is None or not due or self._wanted.same(self._saved):
            return
        if self._writer is not None and self._writer.is_alive():
            return
        self._tried_s = self._now_s()
        self._writer = threading.Thread(target=self._write, args=(self._wanted,), name="calibration", daemon=True)
        self._writer.start()

    def close(self) -> None:
        """Save what was good at last."""
        self._join()
        if self._wanted is not None and not self._wanted.same(self._saved):
            self._write(self._wanted)

    def _join(self) -> None:
        if self._writer is not None:
            self._writer.join()

    def _write(self, version: _Version) -> None:
        try:
            if self._refused:
                self._path.replace(self._path.with_name(self._path.name + ".refused"))
                self._refused = False
            save_belief(self._path, self._camera, version.size_px, version.belief)
        except (FileError, OSError) as error:
            self.trouble = str(error) if isinstance(error, FileError) else f"calibration {self._path}: {error}"
            logger.warning(self.trouble)
        else:
            self._saved, self.trouble = version, None
