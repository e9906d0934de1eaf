"""What waits to be written: bounded, so that a slow disk costs messages and neither time nor memory."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from queue import Empty, SimpleQueue

from revnm_server.recording.heard_log import Listening
from revnm_server.tick.tick_recorder import ObservedTick

_MOST_TICK_BYTES = 64_000_000
_MOST_LINES = 1000


@dataclass(frozen=True, slots=True)
class TickEntry:
    """A tick.

    Attributes:
        tick: What the service showed.
        heard: What it heard.
        at_ns: When it was over, server's clock.
        number: Ticks of the server before it.
    """

    tick: ObservedTick
    heard: tuple[Listening, ...]
    at_ns: int
    number: int

    @property
    def size_bytes(self) -> int:
        """What it takes while it waits."""
        return self.tick.frame.image.nbytes


@dataclass(frozen=True, slots=True)
class LogEntry:
    """A line of the log."""

    text: str
    level: int
    name: str
    at_ns: int


Entry = TickEntry | LogEntry


class EntryQueue:
    """Holds entries until they are taken.

    Ticks come from one thread, and its way in has no lock: it would wait for whoever holds it and has no core. Lines of
    the log may come from any thread. One thread takes.

    Args:
        most_tick_bytes: So much of ticks may wait; a tick counts as its picture does in memory.
        most_lines: So many lines of the log may wait.
    """

    def __init__(self, *, most_tick_bytes: int = _MOST_TICK_BYTES, most_lines: int = _MOST_LINES) -> None:
        self._queue: SimpleQueue[Entry] = SimpleQueue()
        self._ticks, self._lines = _Lane(most_tick_bytes), _Lane(most_lines)
        self._among_lines = threading.Lock()

    @property
    def dropped(self) -> int:
        """How many entries found no room."""
        return self._ticks.dropped + self._lines.dropped

    def offer_tick(self, entry: TickEntry) -> bool:
        """Add a tick, or drop it where there is no room; return whether it was added. Never blocks."""
        if not self._ticks.admit(entry.size_bytes):
            return False
        self._queue.put(entry)
        return True

    def offer_line(self, entry: LogEntry) -> bool:
        """Add a line of the log, or drop it where there is no room; return whether it was added."""
        with self._among_lines:
            if not self._lines.admit(1):
                return False
            self._queue.put(entry)
        return True

    def take(self, *, timeout_s: float) -> Entry | None:
        """Return the oldest entry; None where none comes in time."""
        try:
            entry = self._queue.get(timeout=timeout_s)
        except Empty:
            return None
        if isinstance(entry, TickEntry):
            self._ticks.left += entry.size_bytes
        else:
            self._lines.left += 1
        return entry


class _Lane:
    """Measures what waits of one kind: whoever adds writes one half of the numbers, whoever takes the other."""

    def __init__(self, most: int) -> None:
        self._most, self._came = most, 0
        self.left = self.dropped = 0

    def admit(self, size: int) -> bool:
        waiting = self._came - self.left
        if waiting and waiting + size > self._most:
            self.dropped += 1
            return False
        self._came += size
        return True
