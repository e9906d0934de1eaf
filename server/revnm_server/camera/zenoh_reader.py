"""A camera that publishes JPEG pictures over Zenoh: the simulator's, or a ROS 2 camera behind the bridge."""

from __future__ import annotations

import logging
import threading
import time

import zenoh

from revnm_client import keys
from revnm_client.cdr import decode_image
from revnm_client.errors import MessageError
from revnm_client.link import Inbox, LatestSubscriber
from revnm_client.messages import CompressedImage
from revnm_server.camera.jpeg import decode_jpeg
from revnm_server.camera.slot import LatestSlot
from revnm_server.camera.source import CameraState, CameraStatus
from revnm_server.frame import Frame

logger = logging.getLogger(__name__)

_POLL_S = 0.004
_OLDEST_NS = 1_000_000_000
_FUTURE_NS = 100_000_000


class ZenohReader:
    """Reads ``<camera>/image/compressed`` in a thread of its own.

    A picture counts as new where its stamp differs from the last one's: a scene in which nothing moves
    renders to the same bytes again and again, and is alive all the same.

    Args:
        session: An open session.
        name: The camera's name.
    """

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self.redacted_url = f"zenoh://{name}"
        self._slot = LatestSlot(watch_content=False)
        self._subscriber = LatestSubscriber(session, keys.image(name))
        self._inbox = Inbox(self._subscriber, decode_image)
        self._last_stamp_ns = -1
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"camera-{name}", daemon=True)
        self._thread.start()

    def latest(self) -> Frame | None:
        """Return the newest frame."""
        return self._slot.latest()

    def wait_newer(self, seq: int, *, timeout_s: float) -> Frame | None:
        """Return the newest frame as soon as its number is not ``seq``; None after ``timeout_s``."""
        return self._slot.wait_newer(seq, timeout_s=timeout_s)

    def status(self) -> CameraStatus:
        """Return the camera's health now."""
        return self._slot.status(more_rejected=self._inbox.rejected)

    def note_motion(self, robot: str | None) -> None:
        """Note which robot drives in the picture; None where none does."""
        self._slot.note_motion(robot)

    def note_standing(self, robot: str) -> None:
        """Note a robot that the picture shows standing though its odometry has it drive."""
        self._slot.note_standing(robot)

    def close(self) -> None:
        """Stop reading."""
        self._closing.set()
        self._thread.join()
        self._subscriber.close()
        self._slot.set_state(CameraState.ENDED, "closed")

    def _run(self) -> None:
        while not self._closing.wait(_POLL_S):
            try:
                message = self._inbox.take()
                if message is not None:
                    self._accept(message)
            except MessageError:
                self._slot.note_rejected()
            except Exception:  # the outermost loop of this thread: counted, and the picture grows stale
                self._slot.note_rejected()
                logger.exception("camera %s: a picture could not be read", self.redacted_url)

    def _accept(self, message: CompressedImage) -> None:
        if message.stamp_ns == self._last_stamp_ns:
            self._slot.note_repeated()
            return
        now_ns = time.time_ns()
        image = decode_jpeg(message.data)
        self._last_stamp_ns = message.stamp_ns
        believable = now_ns - _OLDEST_NS <= message.stamp_ns <= now_ns + _FUTURE_NS
        self._slot.put(image, stamp_ns=message.stamp_ns if believable else now_ns, jpeg=message.data)
