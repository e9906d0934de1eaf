"""The recording as the server knows it: started and stopped by whoever may, shown every tick."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import zenoh

from revnm_server.recording.entry_queue import LogEntry, TickEntry
from revnm_server.recording.errors import RecordingError
from revnm_server.recording.heard_log import HeardLog
from revnm_server.recording.record_folder import RecordFolder
from revnm_server.recording.recording import Recording, Rotation
from revnm_server.recording.scribe import Scribe
from revnm_server.recording.wire_tap import WireTap
from revnm_server.settings import RecordingSettings
from revnm_server.tick.site_report import SiteReport
from revnm_server.tick.tick_recorder import ObservedTick
from revnm_server.views.view import RecordingView, ServerView

logger = logging.getLogger(__name__)

_MB, _GB = 1e6, 1e9
_TURN_S = 5.0


class Recorder:
    """Records what is heard and shown between start and stop. Thread-safe.

    Args:
        settings: Where, and how much.
        session: The router's.
        camera: The camera's name.
        robots: Their names.
        about: What every file says of itself.
        heard: What the ticks hear; None where they hear nothing.
    """

    def __init__(
        self,
        settings: RecordingSettings,
        session: zenoh.Session,
        *,
        camera: str,
        robots: tuple[str, ...],
        about: Mapping[str, str],
        heard: HeardLog | None = None,
    ) -> None:
        self._settings, self._session = settings, session
        self._camera, self._robots, self._about = camera, robots, about
        self._heard = heard or HeardLog()
        self._site: SiteReport | None = None
        self._ticks = 0
        self._server_view: Callable[[], ServerView] | None = None
        self._switching = threading.Lock()
        self._recording: Recording | None = None
        self._log: _LogTap | None = None
        self._refusal: str | None = None

    def watch(self, view: Callable[[], ServerView]) -> None:
        """Learn how to ask the server how it is; begin a record where the settings say so."""
        self._server_view = view
        if not self._settings.from_start:
            return
        try:
            self.start()
        except RecordingError as error:  # a robot can be driven without a record
            self._refusal = str(error)
            logger.warning("nothing is recorded: %s", error)

    def observe(self, tick: ObservedTick) -> None:
        """Take a tick; runs in the tick's thread, never blocks and never raises."""
        heard, recording = self._heard.take(), self._recording
        if tick.result is not None:
            self._site = tick.result.site
        if recording is not None:
            recording.offer_tick(TickEntry(tick, heard, time.time_ns(), self._ticks))
        self._ticks += 1

    def view(self) -> RecordingView:
        """Return what there is to show of the record; never waits for the disk."""
        recording = self._recording
        return recording.view() if recording is not None else RecordingView(reason=self._refusal)

    def start(self) -> RecordingView:
        """Begin a record, unless one is being written; return what there is now.

        Raises:
            RecordingError: Nothing can be recorded.
        """
        with self._switched():
            if self._recording is None or not self._recording.active:
                self._leave()
                self._begin()
            return self.view()

    def stop(self) -> RecordingView:
        """End the record, if one is being written; return what became of it.

        Raises:
            RecordingError: The disk does not answer.
        """
        with self._switched():
            self._leave()
            return self.view()

    def close(self) -> None:
        """End the record."""
        self.stop()

    @contextmanager
    def _switched(self) -> Iterator[None]:
        """Let one switch at a time, and none wait for ever: each is a thread of the HTTP server, as Stop needs one."""
        if not self._switching.acquire(timeout=_TURN_S):
            raise RecordingError("the record is being switched already, and its disk does not answer")
        try:
            yield
        finally:
            self._switching.release()

    def _begin(self) -> None:
        settings = self._settings
        if settings.folder is None or self._server_view is None:
            raise RecordingError("nothing can be recorded: set recording.folder (REVNM_RECORDING__FOLDER)")
        folder = RecordFolder(
            settings.folder,
            quota_bytes=settings.quota_gb * _GB,
            least_free_bytes=settings.least_free_gb * _GB,
        )
        scribe = Scribe(self._camera, self._robots, jpeg_quality=settings.jpeg_quality, site=self._site)
        rotation = Rotation(settings.rotate_mb * _MB, settings.rotate_s)
        tap = WireTap(self._session, self._robots)
        try:
            recording = Recording(folder, rotation, tap, scribe, self._about, self._server_view)
        except RecordingError:
            tap.close()
            raise
        self._refusal = None
        self._log = _LogTap(recording)
        self._recording = recording

    def _leave(self) -> None:
        """Hear no more, and complete what was begun."""
        if self._log is not None:
            self._log.close()
        if self._recording is not None:
            self._recording.stop()
        self._log = None


class _LogTap(logging.Handler):
    """Hands on the lines that the server logs."""

    def __init__(self, recording: Recording) -> None:
        super().__init__(level=logging.INFO)
        self._recording = recording
        self._source = logging.getLogger("revnm_server")
        self._source.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        at_ns = round(record.created * 1e9)
        self._recording.offer_line(LogEntry(record.getMessage(), record.levelno, record.name, at_ns))

    def close(self) -> None:
        self._source.removeHandler(self)
        super().close()
