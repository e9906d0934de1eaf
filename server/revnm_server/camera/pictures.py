"""From the packets of one connection to pictures in the slot: what cannot be decoded, stands or comes late is none."""

from __future__ import annotations

import threading
import time

import av
import numpy as np
from av.video.stream import VideoStream

from revnm_server.camera.jpeg import check_size
from revnm_server.camera.lag import StreamLag
from revnm_server.camera.slot import LatestSlot
from revnm_server.camera.source import CameraState
from revnm_server.camera.stream import StreamError, StreamSource, unreadable
from revnm_server.camera.url import FileCamera

_NS_PER_S = 1e9
_LATEST_S = 0.5
_UNREADABLE_S = 1.5
_HOPELESS_S = 5.0  # key frames may be seconds apart, and nothing can be decoded before the first


class Pictures:
    """Decodes one connection's packets; judges whether that leads anywhere.

    Args:
        slot: Where pictures go.
        source: What they come from; a file may be played at the speed of its recording.
        closing: Ends a wait for a picture of a file to be due.
        lag: Judges which pictures are late; of this connection alone.

    Attributes:
        running: Pictures come, and are good.
    """

    def __init__(self, slot: LatestSlot, source: StreamSource, closing: threading.Event, lag: StreamLag) -> None:
        self.running = False
        self._slot, self._closing = slot, closing
        self._paced = isinstance(source, FileCamera) and source.realtime
        self._live = not isinstance(source, FileCamera)
        self._pace_s: float | None = None
        self._lag = lag
        self._late = False
        self._newest_pts = -1
        self._trouble = unreadable(source)
        self._good_s = time.monotonic()

    def take(self, packet: av.Packet[VideoStream], *, came_s: float) -> None:
        """Decode a packet whose picture began to come then, monotonic clock.

        Raises:
            StreamError: For seconds nothing has come of what comes.
        """
        try:
            frames = packet.decode()
        except av.FFmpegError:  # lost packets, or pictures before the first key frame
            frames = []
        was_late = self._late
        for frame in frames:
            late_s = self._lateness_s(frame, came_s)
            if late_s is not None:
                self._put(frame, came_s - late_s)
        if self._late != was_late:  # pictures between key frames are passed over undecoded until it has caught up
            packet.stream.codec_context.skip_frame = "NONKEY" if self._late else "DEFAULT"
        bad_s = time.monotonic() - self._good_s
        if self._live and bad_s > _UNREADABLE_S:
            self.running = False
            self._slot.set_state(CameraState.STALE, self._trouble)
        if self._live and bad_s > _HOPELESS_S:
            raise StreamError(self._trouble)

    def _lateness_s(self, frame: av.VideoFrame, came_s: float) -> float | None:
        """Return how late a picture came; None where that is too late, or it is not a new one."""
        if frame.pts is not None and frame.pts <= self._newest_pts:
            self._slot.note_repeated()
            self._trouble = "the time stamps of the stream stand still"
            return None
        self._newest_pts = frame.pts if frame.pts is not None else -1
        if frame.time is None or not self._live:
            return 0.0
        late_s, piled_up = self._lag.note(frame.time, came_s), self._lag.piled_up(frame.time, came_s)
        if piled_up:
            self._good_s = time.monotonic()
            return None
        self._late = late_s > _LATEST_S
        if self._late:
            self._trouble = (
                f"its pictures are {late_s:.0f} s old when they are decoded: network or computer is too slow for "
                "them; choose a smaller stream of the camera"
            )
        return None if self._late else late_s

    def _put(self, frame: av.VideoFrame, taken_s: float) -> None:
        if self._paced and frame.time is not None:
            self._wait_until(frame.time)
            taken_s = time.monotonic()
        stamp_ns = time.time_ns() - round((time.monotonic() - taken_s) * _NS_PER_S)
        check_size(frame.width, frame.height)
        image = np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
        self._slot.put(image, stamp_ns=stamp_ns)
        self.running, self._good_s = True, time.monotonic()

    def _wait_until(self, media_s: float) -> None:
        """Wait until a moment of the recording is due."""
        now_s = time.monotonic()
        if self._pace_s is None:
            self._pace_s = now_s - media_s
        self._closing.wait(max(0.0, media_s + self._pace_s - now_s))
