"""The newest frame of a camera, with how old it is and what the reader says of its connection."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np
from numpy.typing import NDArray

from revnm_server.camera.content import ContentWatch, digest
from revnm_server.camera.source import CameraState, CameraStatus
from revnm_server.frame import Frame

STALE_AFTER_S = 1.0
_FPS_WINDOW = 20


class LatestSlot:
    """Holds one frame: a slow consumer gets the newest, never a queue of old ones. Thread-safe.

    Args:
        watch_content: Mind pictures that do not change at all: a real sensor always has noise, a rendered
            picture has none.
    """

    def __init__(self, *, watch_content: bool) -> None:
        self._new = threading.Condition()
        self._content = ContentWatch() if watch_content else None
        self._frame: Frame | None = None
        self._arrivals_s: deque[float] = deque(maxlen=_FPS_WINDOW)
        self._arrived_s = 0.0
        self._state = CameraState.INIT
        self._reason = "no picture yet"
        self._repeating = False
        self._rejected = 0

    def put(self, image: NDArray[np.uint8], *, stamp_ns: int, jpeg: bytes | None = None) -> None:
        """Take a new picture (H, W, 3) RGB, captured at ``stamp_ns``; the camera is running.

        ``jpeg`` is what it was decoded from, if that was one.
        """
        now_s = time.monotonic()
        content = digest(image) if self._content is not None else 0
        with self._new:
            if self._state is CameraState.ENDED:
                return
            seq = self._frame.seq + 1 if self._frame is not None else 1
            if self._content is not None:
                self._content.see(content, now_s)
            self._frame = Frame(image, stamp_ns, seq, jpeg)
            self._arrived_s = now_s
            self._arrivals_s.append(now_s)
            self._state, self._repeating = CameraState.RUNNING, False
            self._new.notify_all()

    def note_repeated(self) -> None:
        """Note a picture whose time stamp did not advance: it is no new one."""
        with self._new:
            self._repeating = True

    def note_rejected(self) -> None:
        """Count a picture that was refused."""
        with self._new:
            self._rejected += 1

    def note_motion(self, robot: str | None) -> None:
        """Note which robot drives in the picture, which must then change; None where none does."""
        if self._content is not None:
            with self._new:
                self._content.note_motion(robot, time.monotonic())

    def note_standing(self, robot: str) -> None:
        """Note a robot that the picture shows standing though its odometry has it drive."""
        if self._content is not None:
            with self._new:
                self._content.note_standing(robot, time.monotonic())

    def set_state(self, state: CameraState, reason: str) -> None:
        """Note that the camera is not running, and why; ENDED is final."""
        with self._new:
            if self._state is not CameraState.ENDED:
                self._state, self._reason = state, reason
                self._arrivals_s.clear()  # the rate begins anew

    def latest(self) -> Frame | None:
        """Return the newest frame."""
        with self._new:
            return self._frame

    def wait_newer(self, seq: int, *, timeout_s: float) -> Frame | None:
        """Return the newest frame as soon as its number is not ``seq``; None after ``timeout_s``."""
        with self._new:
            self._new.wait_for(lambda: self._frame is not None and self._frame.seq != seq, timeout_s)
            return self._frame if self._frame is not None and self._frame.seq != seq else None

    def status(self, *, more_rejected: int = 0) -> CameraStatus:
        """Return the health now; ``more_rejected`` were refused before they came here."""
        now_s = time.monotonic()
        with self._new:
            age_s = now_s - self._arrived_s if self._frame is not None else None
            state, reason = self._judge(age_s, now_s)
            running = state is CameraState.RUNNING
            return CameraStatus(
                state=state,
                reason=None if running else reason,
                warning=self._content.odd(now_s) if running and self._content is not None else None,
                size_px=self._frame.size_px if self._frame is not None else None,
                fps=self._fps() if running else None,
                frame_age_s=age_s,
                rejected=self._rejected + more_rejected,
            )

    def _judge(self, age_s: float | None, now_s: float) -> tuple[CameraState, str]:
        if self._state is not CameraState.RUNNING or age_s is None:
            return self._state, self._reason
        if age_s > STALE_AFTER_S and self._repeating:
            return CameraState.STALE, f"the picture is frozen: its time stamp stands since {age_s:.1f} s"
        if age_s > STALE_AFTER_S:
            return CameraState.STALE, f"no new picture for {age_s:.1f} s"
        frozen = self._content.frozen(now_s) if self._content is not None else None
        return (CameraState.RUNNING, "") if frozen is None else (CameraState.STALE, frozen)

    def _fps(self) -> float | None:
        span_s = self._arrivals_s[-1] - self._arrivals_s[0]
        return (len(self._arrivals_s) - 1) / span_s if span_s > 0.0 else None
