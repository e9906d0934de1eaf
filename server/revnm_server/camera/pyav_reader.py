"""Cameras on the network and video files, decoded with PyAV (FFmpeg).

Measured: FFmpeg buffers whatever is not read, so a thread of its own reads as fast as pictures come and keeps
the newest; a stream that freezes with its connection open is noticed by time-outs, twice as late as they say.
"""

from __future__ import annotations

import logging
import threading
import time

import av
import numpy as np
from av.container import InputContainer

from revnm_client.errors import RevnmError
from revnm_server.camera.jpeg import MAX_PIXELS, check_size
from revnm_server.camera.slot import LatestSlot
from revnm_server.camera.source import CameraState, CameraStatus
from revnm_server.camera.url import FileCamera, NetworkCamera
from revnm_server.frame import Frame

logger = logging.getLogger(__name__)

_RETRY_FIRST_S = 0.5
_RETRY_LONGEST_S = 10.0
_JOIN_S = 1.0
_RTSP_OPTIONS = {
    "rtsp_transport": "tcp",
    "fflags": "nobuffer",
    "flags": "low_delay",
    "analyzeduration": "500000",
    "protocol_whitelist": "rtsp,rtp,tcp,udp,tls,crypto",
}
_FILE_OPTIONS = {"protocol_whitelist": "file"}


class StreamError(RevnmError):
    """A stream that can be read and is no use: no pictures in it, or their time stamps stand."""


class PyavReader:
    """Reads a stream or a file in a thread of its own; connects again by itself.

    Args:
        source: What to read.
        timeout_s: Longest wait for the connection, and for the next packet.
    """

    def __init__(self, source: NetworkCamera | FileCamera, *, timeout_s: float = 3.0) -> None:
        is_file = isinstance(source, FileCamera)
        self.redacted_url = f"file://{source.path}" if isinstance(source, FileCamera) else source.redacted
        self._source = source
        self._timeout_s = timeout_s
        self._slot = LatestSlot(watch_content=not is_file)
        self._jitter = np.random.default_rng()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="camera", daemon=True)
        self._thread.start()

    def latest(self) -> Frame | None:
        """Return the newest frame."""
        return self._slot.latest()

    def wait_newer(self, seq: int, *, timeout_s: float) -> Frame | None:
        """Return the newest frame as soon as its number is not ``seq``; None after ``timeout_s``."""
        return self._slot.wait_newer(seq, timeout_s=timeout_s)

    def status(self) -> CameraStatus:
        """Return the camera's health now."""
        return self._slot.status()

    def note_motion(self, robot: str | None) -> None:
        """Note which robot drives in the picture; None where none does."""
        self._slot.note_motion(robot)

    def close(self) -> None:
        """Stop reading; a thread that waits for a dead camera is left to its time-out."""
        self._closing.set()
        self._slot.set_state(CameraState.ENDED, "closed")
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        delay_s = _RETRY_FIRST_S
        while not self._closing.is_set():
            before = self._slot.latest()
            reason = self._attempt()
            came = self._slot.latest() is not before
            if isinstance(self._source, FileCamera) and reason is None:
                if self._source.loop and came:
                    continue
                self._slot.set_state(CameraState.ENDED, "the file is over")
                return
            reason = reason or "the camera closed the stream"
            self._slot.set_state(CameraState.RECONNECTING, reason)
            logger.warning("camera %s: %s", self.redacted_url, reason)
            delay_s = _RETRY_FIRST_S if came else min(2.0 * delay_s, _RETRY_LONGEST_S)
            self._closing.wait(delay_s * self._jitter.uniform(0.5, 1.0))

    def _attempt(self) -> str | None:
        """Read until the stream breaks or is over; return why it broke, None where it is just over."""
        try:
            with self._open() as container:
                self._read(container)
        except Exception as error:  # whatever FFmpeg makes of a hostile stream: shown in the status
            return self._describe(error)
        return None

    def _read(self, container: InputContainer) -> None:
        if not container.streams.video:
            raise StreamError("there are no pictures in it, only sound or data")
        stream = container.streams.video[0]
        stream.thread_type = "SLICE"
        stream.codec_context.options = {"max_pixels": str(MAX_PIXELS)}
        newest_pts, advanced_s = -1, time.monotonic()
        pace = _Pace(self._closing)
        for frame in container.decode(stream):
            if self._closing.is_set():
                return
            if frame.pts is not None and frame.pts <= newest_pts:
                self._slot.note_repeated()
                if time.monotonic() - advanced_s > self._timeout_s:
                    raise StreamError("the time stamps of the stream stand still")
                continue
            newest_pts, advanced_s = frame.pts if frame.pts is not None else -1, time.monotonic()
            if isinstance(self._source, FileCamera) and self._source.realtime and frame.time is not None:
                pace.wait_until(frame.time)
            self._put(frame)

    def _put(self, frame: av.VideoFrame) -> None:
        stamp_ns = time.time_ns()
        check_size(frame.width, frame.height)
        image = np.asarray(frame.to_ndarray(format="rgb24"), dtype=np.uint8)
        self._slot.put(image, stamp_ns=stamp_ns)

    def _open(self) -> InputContainer:
        if isinstance(self._source, FileCamera):
            return av.open(str(self._source.path), options=_FILE_OPTIONS)
        timeout = (self._timeout_s, self._timeout_s)
        return av.open(self._source.url, options=_RTSP_OPTIONS, timeout=timeout)

    def _describe(self, error: Exception) -> str:
        """Return what went wrong, without the address: FFmpeg repeats it with its password."""
        if isinstance(error, av.error.ExitError):  # PyAV's way to say that a time-out ran out
            return f"nothing came for {self._timeout_s} s"
        if isinstance(error, OSError | av.FFmpegError) and error.strerror:
            return error.strerror
        if isinstance(error, RevnmError):
            return str(error)
        return f"{type(error).__name__}"


class _Pace:
    """Lets a file play at the speed of its recording."""

    def __init__(self, closing: threading.Event) -> None:
        self._closing = closing
        self._offset_s: float | None = None

    def wait_until(self, media_s: float) -> None:
        """Wait until ``media_s`` of the recording is due."""
        now_s = time.monotonic()
        if self._offset_s is None:
            self._offset_s = now_s - media_s
        self._closing.wait(max(0.0, media_s + self._offset_s - now_s))
