"""One recording, from its start to its stop: a thread that writes what the queue gives, file after file."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from revnm_server.recording.entry_queue import EntryQueue, LogEntry, TickEntry
from revnm_server.recording.errors import RecordingError
from revnm_server.recording.record_file import RecordFile
from revnm_server.recording.record_folder import RecordFolder
from revnm_server.recording.scribe import Scribe
from revnm_server.recording.wire_tap import WireTap
from revnm_server.views.view import RecordingView, ServerView

logger = logging.getLogger(__name__)

_TAKE_S = 0.05  # the robots are heard as often
_HOUSEKEEPING_S = 1.0
_STOP_S = 20.0
_MB = 1e6


@dataclass(frozen=True, slots=True)
class Rotation:
    """When a file is closed and the next begun: at this size or after this time, whichever comes first."""

    most_bytes: float
    most_s: float


class Recording:
    """Writes entries until it is told to stop, or the disk fails it.

    Args:
        folder: Where the files go.
        rotation: How long they become.
        tap: Hears the robots; closed at the end.
        scribe: Writes the messages.
        about: What every file says of itself.
        view: Tells of the server, for the diagnostics.
        queue: Where entries wait; None for a new one.

    Raises:
        RecordingError: The first file cannot be written.
    """

    def __init__(
        self,
        folder: RecordFolder,
        rotation: Rotation,
        tap: WireTap,
        scribe: Scribe,
        about: Mapping[str, str],
        view: Callable[[], ServerView],
        queue: EntryQueue | None = None,
    ) -> None:
        self._queue = queue or EntryQueue()
        self._folder, self._rotation, self._tap, self._scribe = folder, rotation, tap, scribe
        self._about, self._view = about, view
        self._began_s = time.monotonic()
        self._lasted_s: float | None = None
        self._before = 0  # messages in the files before this one
        self._size_bytes = 0
        self._reason: str | None = None
        self._stopping = threading.Event()
        self._file = self._open()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def active(self) -> bool:
        """Whether it is being written."""
        return self._lasted_s is None

    @property
    def _wanted(self) -> bool:
        return self.active and not self._stopping.is_set()  # else a slow disk would never be done with the last ones

    def offer_line(self, entry: LogEntry) -> None:
        """Take a line of the log."""
        if self._wanted:
            self._queue.offer_line(entry)

    def offer_tick(self, entry: TickEntry) -> None:
        """Take a tick; never blocks."""
        if self._wanted:
            self._queue.offer_tick(entry)

    def stop(self) -> None:
        """Write what waits, and complete the file; waits for the disk, but not for ever."""
        self._stopping.set()
        self._thread.join(_STOP_S)
        if self._thread.is_alive():
            self._fail(f"the disk has not taken its end within {_STOP_S:.0f} s")

    def view(self) -> RecordingView:
        """Return what there is to show; never waits for the disk."""
        lasted_s = self._lasted_s
        return RecordingView(
            active=lasted_s is None,
            name=self._file.path.name,
            size_mb=round(self._size_bytes / _MB, 2),
            duration_s=round(time.monotonic() - self._began_s if lasted_s is None else lasted_s, 1),
            messages=self._before + self._file.messages,
            dropped=self._queue.dropped + self._tap.overflows,
            refused=self._scribe.refused + self._tap.oversized,
            reason=self._reason,
        )

    def _run(self) -> None:
        try:
            self._write_all()
            self._write_wire()
            self._file.finish()
        except RecordingError as error:
            self._fail(str(error))
            self._complete()
        except OSError as error:
            self._fail(f"{self._file.path.name}: {error.strerror or error}")
            self._file.abandon()
        except Exception as error:  # driving goes on, and the state says why nothing is recorded
            logger.exception("the recording failed")
            self._fail(f"{type(error).__name__}: {error}")
            self._file.abandon()
        finally:
            self._lasted_s = time.monotonic() - self._began_s
            self._tap.close()

    def _write_all(self) -> None:
        housekeeping_s = self._began_s
        while True:
            last = self._stopping.is_set()  # asked first: what was offered before the stop is found then
            entry = self._queue.take(timeout_s=_TAKE_S)
            if entry is None and last:
                return
            self._write_wire()
            if entry is not None:
                self._scribe.write(self._file, entry)
            if time.monotonic() >= housekeeping_s:
                housekeeping_s = time.monotonic() + _HOUSEKEEPING_S
                self._keep_house()
            if self._file.size_bytes >= self._rotation.most_bytes or time.monotonic() >= self._file_until_s:
                self._rotate()

    def _write_wire(self) -> None:
        for heard in self._tap.poll():
            self._scribe.write(self._file, heard)

    def _keep_house(self) -> None:
        """Bring what was written to the disk, note how the server is, and see that there is room."""
        self._scribe.write_view(self._file, self._view(), at_ns=time.time_ns())
        self._file.flush()
        self._size_bytes = self._file.size_bytes
        try:
            self._folder.check_free()
        except RecordingError:
            self._folder.make_room(written_bytes=self._size_bytes, wanted_bytes=0.0)

    def _rotate(self) -> None:
        self._file.finish()
        self._before += self._file.messages
        self._file = self._open()

    def _open(self) -> RecordFile:
        """Begin a file.

        Raises:
            RecordingError: It cannot be written.
        """
        path = self._folder.new_path()
        self._folder.make_room(written_bytes=0, wanted_bytes=self._rotation.most_bytes)
        try:
            file = RecordFile(path, about=self._about, topics=self._scribe.topics)
        except OSError as error:
            raise RecordingError(f"{path}: {error.strerror or error}") from error
        try:
            self._scribe.begin(file, at_ns=time.time_ns())
        except OSError as error:
            file.abandon()
            raise RecordingError(f"{path}: {error.strerror or error}") from error
        self._file_until_s = time.monotonic() + self._rotation.most_s
        return file

    def _fail(self, reason: str) -> None:
        """Say why nothing is recorded any more."""
        self._reason = f"the recording stopped: {reason}"
        logger.warning(self._reason)

    def _complete(self) -> None:
        try:
            self._file.finish()
        except OSError as error:
            logger.warning("%s stays incomplete: %s", self._file.path, error.strerror)
