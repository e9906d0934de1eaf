"""Waits for conditions instead of sleeping."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def eventually(condition: Callable[[], T], *, within_s: float = 10.0, every_s: float = 0.01) -> T:
    """Return what ``condition`` returns as soon as it is true; ask ``every_s``, fail after ``within_s``."""
    deadline_s = time.monotonic() + within_s
    pause = threading.Event()
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < deadline_s, f"not within {within_s} s; last value: {value!r}"
        pause.wait(every_s)
