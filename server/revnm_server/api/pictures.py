"""Streams of pictures, made once for all who look: drawn only while someone does, at most ten times a second."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from starlette.concurrency import run_in_threadpool

from revnm_server.api.between_ticks import BetweenTicks
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.service import NavigationService
from revnm_server.views.depth_picture import depth_picture, ego_picture
from revnm_server.views.map_picture import map_picture

MEDIA_TYPE = "multipart/x-mixed-replace; boundary=frame"
_PERIOD_S = 0.1
_WIDEST_PX = 1024


class Drawing(NamedTuple):
    """A picture that may have to be drawn: when what it shows was captured, and what draws it (h, w, 3)."""

    stamp_ns: int
    draw: Callable[[], NDArray[np.uint8]]


class _Part(NamedTuple):
    stamp_ns: int
    data: bytes


class SharedPictures:
    """One layer of the camera's picture, as parts of a multipart stream.

    All who look wait for one task, which draws the newest picture if it is a new one. It belongs to the event loop in
    which they look.
    """

    def __init__(
        self, newest: Callable[[], Drawing | None], *, between_ticks: BetweenTicks, closing: Callable[[], bool]
    ) -> None:
        """Share what ``newest`` gives, until ``closing``; it gives None where there is no picture."""
        self._newest, self._between_ticks, self._closing = newest, between_ticks, closing
        self._making: asyncio.Task[_Part | None] | None = None
        self._made: _Part | None = None
        self._due_s = 0.0

    @property
    def available(self) -> bool:
        """Whether there is a picture."""
        return self._newest() is not None

    async def parts(self) -> AsyncIterator[bytes]:
        """Yield the newest picture, and each one that is new then; who takes them slowly misses some."""
        shown_ns: int | None = None
        while not self._closing():
            if self._making is None:
                self._making = asyncio.create_task(self._make())
            part = await asyncio.shield(self._making)  # one who leaves takes nothing from the others
            if part is not None and part.stamp_ns != shown_ns:
                shown_ns = part.stamp_ns
                yield part.data

    async def _make(self) -> _Part | None:
        """Return the newest picture once its time has come."""
        try:
            await asyncio.sleep(self._due_s - time.monotonic())
            await self._between_ticks.wait()
            self._due_s = time.monotonic() + _PERIOD_S
            drawing = self._newest()
            if drawing is None:
                return None
            if self._made is None or self._made.stamp_ns != drawing.stamp_ns:
                self._made = await run_in_threadpool(_drawn, drawing)
            return self._made
        finally:
            self._making = None


def _drawn(drawing: Drawing) -> _Part:
    data = encode_jpeg(drawing.draw())
    head = (
        f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n"
        f"X-Frame-Stamp-Ms: {drawing.stamp_ns / 1e6:.1f}\r\n\r\n"
    )
    return _Part(drawing.stamp_ns, head.encode() + data + b"\r\n")


class Layers:
    """All that can be looked at: the camera's picture, its depth, the map, and what each robot is thought to see."""

    def __init__(self, service: NavigationService, between_ticks: BetweenTicks) -> None:
        """Share the pictures of a service."""
        self._service, self._between_ticks = service, between_ticks
        self.exo = self._shared(self._seen)
        self.depth = self._shared(self._deep)
        self.map = self._shared(self._mapped)
        self.ego = {robot: self._shared(partial(self._imagined, robot)) for robot in service.mission.names}

    def _shared(self, newest: Callable[[], Drawing | None]) -> SharedPictures:
        return SharedPictures(newest, between_ticks=self._between_ticks, closing=lambda: self._service.closing)

    def _seen(self) -> Drawing | None:
        frame = self._service.camera.latest()
        return Drawing(frame.stamp_ns, lambda: _bounded(frame.image)) if frame is not None else None

    def _deep(self) -> Drawing | None:
        tick = self._service.last_tick()
        if tick is None:
            return None
        return Drawing(tick.stamp_ns, lambda: depth_picture(tick.result.disparity, size_px=tick.size_px))

    def _mapped(self) -> Drawing | None:
        report = self._service.site()
        return Drawing(report.stamp_ns, lambda: map_picture(report)) if report is not None else None

    def _imagined(self, robot: str) -> Drawing | None:
        tick = self._service.last_tick()
        ego = tick.result.ego_depths.get(robot) if tick is not None else None
        return Drawing(tick.stamp_ns, lambda: ego_picture(ego)) if tick is not None and ego is not None else None


def _bounded(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the picture, smaller where it is wider than a page needs it."""
    height, width = image.shape[:2]
    if width <= _WIDEST_PX:
        return image
    size = (_WIDEST_PX, max(1, round(height * _WIDEST_PX / width)))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
