"""Lets those who only look wait while a tick runs: what Python does for them, it would take from the tick."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

_LONGEST_S = 0.05
"""A tick that takes longer lets them look meanwhile: at a rate that shares a core with it, and no worse."""
_LOOK_S = 0.004


class BetweenTicks:
    """The time in which no tick runs, for all who wait for it in one event loop. Who acts does not wait."""

    def __init__(self, ticking: Callable[[], bool]) -> None:
        """Ask ``ticking`` whether a tick runs."""
        self._ticking = ticking
        self._waiting: asyncio.Task[None] | None = None

    async def wait(self) -> None:
        """Return when no tick runs, or after 0.05 s."""
        if self._waiting is None:
            if not self._ticking():
                return
            self._waiting = asyncio.create_task(self._wait())
        await asyncio.shield(self._waiting)  # one who leaves takes nothing from the others

    async def _wait(self) -> None:
        try:
            until_s = time.monotonic() + _LONGEST_S
            while self._ticking() and time.monotonic() < until_s:
                await asyncio.sleep(_LOOK_S)
        finally:
            self._waiting = None
