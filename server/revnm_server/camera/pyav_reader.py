"""Cameras on the network, cameras at this computer and video files, decoded with PyAV (FFmpeg).

Measured: FFmpeg buffers whatever is not read, so a thread of its own reads as fast as pictures come and keeps
the newest; after a time-out it gives what it still held and only the second one in a row is an error, so
silence is judged here. Its parser gives a picture of H.264 or H.265 when the next one begins to arrive.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import cast

import av
import numpy as np
from av.container import InputContainer
from av.video.stream import VideoStream

from revnm_server.camera.backoff import Backoff
from revnm_server.camera.lag import StreamLag
from revnm_server.camera.pictures import Pictures
from revnm_server.camera.slot import LatestSlot
from revnm_server.camera.source import CameraState, CameraStatus
from revnm_server.camera.stream import StreamError, StreamSource, explain, open_stream, video_stream
from revnm_server.camera.url import DeviceCamera, FileCamera, NetworkCamera
from revnm_server.frame import Frame

logger = logging.getLogger(__name__)

_TIMEOUT_S = 2.0
_JOIN_S = 1.0
_HELD_BACK = ("h264", "hevc")


class PyavReader:
    """Reads a stream, a device or a file in a thread of its own; connects again by itself.

    Args:
        source: What to read.
        timeout_s: Longest wait for the network: for a connection, an answer, the next picture.
        new_lag: Makes what judges which pictures of a connection are late.
    """

    def __init__(
        self, source: StreamSource, *, timeout_s: float = _TIMEOUT_S, new_lag: Callable[[], StreamLag] = StreamLag
    ) -> None:
        self.redacted_url = _shown(source)
        self._source = source
        self._timeout_s = timeout_s
        self._new_lag = new_lag
        self._slot = LatestSlot(watch_content=not isinstance(source, FileCamera))
        self._backoff = Backoff(np.random.default_rng())
        self._told: str | None = None
        self._heard_s = 0.0
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

    def note_standing(self, robot: str) -> None:
        """Note a robot that the picture shows standing though its odometry has it drive."""
        self._slot.note_standing(robot)

    def close(self) -> None:
        """Stop reading; a thread that waits for a dead camera is left to its time-out."""
        self._closing.set()
        self._slot.set_state(CameraState.ENDED, "closed")
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        while not self._closing.is_set():
            before = self._slot.latest()
            error = self._attempt()
            came = self._slot.latest() is not before
            if isinstance(self._source, FileCamera) and error is None:
                if self._source.loop and came:
                    continue
                self._slot.set_state(CameraState.ENDED, "the file is over")
                return
            self._tell(explain(error, self._source) if error is not None else "the camera closed the stream")
            refused = isinstance(error, av.error.HTTPUnauthorizedError | av.error.HTTPForbiddenError)
            self._closing.wait(self._backoff.pause_s(worked=came, refused=refused))

    def _tell(self, reason: str) -> None:
        """Show why there are no pictures; log it where it was not the reason before."""
        self._slot.set_state(CameraState.RECONNECTING, reason)
        if reason != self._told and not self._closing.is_set():
            logger.warning("camera %s: %s", self.redacted_url, reason)
            self._told = reason

    def _attempt(self) -> Exception | None:
        """Read until the stream breaks or is over; return why it broke, None where it is just over."""
        self._heard_s = time.monotonic()
        try:
            with open_stream(self._source, timeout_s=self._timeout_s) as container:
                self._heard_s = time.monotonic()
                self._read(container)
        except (av.error.ExitError, av.error.TimeoutError, av.error.InvalidDataError, av.error.OSError) as error:
            return self._silence() if self._is_silent() else error  # FFmpeg calls an answer that never came invalid
        except Exception as error:  # whatever FFmpeg makes of a hostile stream: shown in the status
            return error
        return None

    def _is_silent(self) -> bool:
        return isinstance(self._source, NetworkCamera) and time.monotonic() - self._heard_s >= self._timeout_s

    def _silence(self) -> StreamError:
        return StreamError(f"nothing came for {self._timeout_s:.1f} s")

    def _read(self, container: InputContainer) -> None:
        stream = video_stream(container)
        pictures = Pictures(self._slot, self._source, self._closing, self._new_lag())
        held_back = isinstance(self._source, NetworkCamera) and stream.codec_context.name in _HELD_BACK
        began_s = time.monotonic()
        for packet in container.demux(stream):
            now_s = time.monotonic()
            if self._closing.is_set():
                return
            if self._is_silent():
                raise self._silence()
            if isinstance(self._source, DeviceCamera):
                packet = _detached(packet)
            # What was held back until the next picture began to arrive did so itself when the one before was given.
            pictures.take(packet, came_s=began_s if held_back else now_s)
            self._heard_s, began_s = time.monotonic(), now_s
            if pictures.running and self._told is not None:
                logger.info("camera %s: pictures come again", self.redacted_url)
                self._told = None


def _detached(packet: av.Packet[VideoStream]) -> av.Packet[VideoStream]:
    """Return a copy that owns its data; measured: FFmpeg crashes where one of the driver's outlives its device."""
    copy = cast("av.Packet[VideoStream]", av.Packet(bytes(packet)))
    copy.stream, copy.pts, copy.dts, copy.time_base = packet.stream, packet.pts, packet.dts, packet.time_base
    return copy


def _shown(source: StreamSource) -> str:
    if isinstance(source, NetworkCamera):
        return source.redacted
    return f"{'v4l2' if isinstance(source, DeviceCamera) else 'file'}://{source.path}"
