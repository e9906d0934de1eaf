"""What waits to be written: bounded, so that a slow disk costs messages and neither time nor memory."""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass

from revnm_server.recording.heard_log import Listening
from revnm_server.recording.topics import Topic
from revnm_server.tick_recorder import ObservedTick

_MOST_ENTRIES = 4000
_MOST_BYTES = 64_000_000
_OVERHEAD_BYTES = 500


@dataclass(frozen=True, slots=True)
class WireEntry:
    """A payload as it went over Zenoh.

    Attributes:
        robot: Whose it is.
        topic: Where it belongs.
        payload: Its bytes.
        at_ns: When it was received, server's clock.
        attachment: What came with it.
    """

    robot: str
    topic: Topic
    payload: bytes
    at_ns: int
    attachment: bytes | None = None

    @property
    def size_bytes(self) -> int:
        """What it takes while it waits."""
        return len(self.payload) + _OVERHEAD_BYTES


@dataclass(frozen=True, slots=True)
class TickEntry:
    """A tick.

    Attributes:
        tick: What the service showed.
        heard: What it heard.
        at_ns: When it was over, server's clock.
    """

    tick: ObservedTick
    heard: tuple[Listening, ...]
    at_ns: int

    @property
    def size_bytes(self) -> int:
        """What it takes while it waits."""
        return self.tick.frame.image.nbytes + _OVERHEAD_BYTES


@dataclass(frozen=True, slots=True)
class LogEntry:
    """A line of the log."""

    text: str
    level: int
    name: str
    at_ns: int

    @property
    def size_bytes(self) -> int:
        """What it takes while it waits."""
        return len(self.text) + _OVERHEAD_BYTES


Entry = WireEntry | TickEntry | LogEntry


class EntryQueue:
    """Holds entries until they are taken. Thread-safe.

    Args:
        most_entries: More are dropped.
        most_bytes: More are dropped; a tick counts as its picture does in memory.
    """

    def __init__(self, *, most_entries: int = _MOST_ENTRIES, most_bytes: int = _MOST_BYTES) -> None:
        self._most_entries, self._most_bytes = most_entries, most_bytes
        self._entries: deque[Entry] = deque()
        self._bytes = 0
        self._dropped = 0
        self._came = threading.Condition()

    @property
    def dropped(self) -> int:
        """How many entries found no room."""
        return self._dropped

    def offer(self, entry: Entry) -> bool:
        """Add an entry, or drop it where there is no room; return whether it was added. Never blocks for long."""
        size = entry.size_bytes
        with self._came:
            full = len(self._entries) >= self._most_entries
            if full or (self._entries and self._bytes + size > self._most_bytes):
                self._dropped += 1
                return False
            self._entries.append(entry)
            self._bytes += size
            self._came.notify()
            return True

    def take(self, *, timeout_s: float) -> Entry | None:
        """Return the oldest entry; None where none comes in time."""
        with self._came:
            if not self._came.wait_for(lambda: self._entries, timeout_s):
                return None
            entry = self._entries.popleft()
            self._bytes -= entry.size_bytes
            return entry
