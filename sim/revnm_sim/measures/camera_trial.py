"""Breaks a software camera in every way it knows, and times how the server's reader bears it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import RevnmError
from revnm_server.camera import CameraSource, CameraState
from revnm_server.camera.pyav_reader import PyavReader
from revnm_server.camera.url import NetworkCamera, parse_camera_url
from revnm_sim.burnt_time import burn_time, read_age_ms
from revnm_sim.live.rtsp_server import Fault, RtspServer, filming

FPS = 30.0
_POLL_S = 0.005
_PATIENCE_S = 30.0
_LOGIN = ("viewer", "secret")
_SMALL_PX, _LARGE_PX = (640, 480), (3840, 2160)

Breakage = Callable[[RtspServer], None]


class TrialError(RevnmError):
    """The reader did not come to where the trial needs it."""


@dataclass(frozen=True, slots=True)
class FaultTiming:
    """How the reader bore one fault.

    Attributes:
        state: The first state but running that it showed, and ``running`` for a change of size.
        state_after_s: After how long.
        reason: What it said at the end of the fault.
        recovered_after_s: Until pictures came again, from the end of the fault.
    """

    state: str
    state_after_s: float
    reason: str
    recovered_after_s: float


BREAKAGES: dict[str, Breakage] = {
    "frozen": lambda server: server.set_fault(Fault.FROZEN),
    "dropped": lambda server: server.drop(),
    "refused": lambda server: server.set_fault(Fault.REFUSED),
    "blackhole": lambda server: server.set_fault(Fault.BLACKHOLE),
    "wrong_codec": lambda server: server.set_fault(Fault.WRONG_CODEC),
}


class Scene:
    """A still, textured scene with the time in it and something that moves.

    Args:
        size_px: Width and height; may be changed at any time.
    """

    def __init__(self, size_px: tuple[int, int]) -> None:
        self._bases = {size: _base(size) for size in {size_px, _SMALL_PX}}
        self.size_px = size_px

    def add_size(self, size_px: tuple[int, int]) -> None:
        """Prepare for another size."""
        self._bases[size_px] = _base(size_px)

    def picture(self, index: int) -> NDArray[np.uint8]:
        """Return a picture (H·3/2, W) YUV 4:2:0, planar, with the time it was made at."""
        width, height = self.size_px
        picture = self._bases[width, height].copy()
        side = height // 8
        left = (index * side // 16) % (width - side)
        picture[height // 2 : height // 2 + side, left : left + side] = 200
        burn_time(picture[:height], _now_ms())
        return picture


@contextmanager
def watched(scene: Scene, *, fps: float = FPS) -> Iterator[tuple[RtspServer, CameraSource]]:
    """Yield a software camera that films a scene, and the server's reader on it, running."""
    with RtspServer(fps=fps, login=_LOGIN) as server, filming(server, scene.picture, fps=fps):
        source = parse_camera_url(server.url)
        assert isinstance(source, NetworkCamera)
        camera = PyavReader(source)
        try:
            wait_until(lambda: _runs(camera), what="first picture")
            yield server, camera
        finally:
            camera.close()


def time_fault(server: RtspServer, camera: CameraSource, breakage: Breakage, *, hold_s: float) -> FaultTiming:
    """Break a running camera for a while, and mend it.

    Args:
        server: The camera.
        camera: Its reader, running.
        breakage: What breaks it.
        hold_s: For how long; 0 where the breakage is over at once.

    Raises:
        TrialError: The reader did not notice, or did not recover.
    """
    began_s = time.monotonic()
    breakage(server)
    state_after_s = wait_until(lambda: not _runs(camera), what="state that tells of the fault")
    state = camera.status().state.value
    threading.Event().wait(hold_s - (time.monotonic() - began_s))
    reason = camera.status().reason or ""
    ended_s = time.monotonic() if hold_s > 0.0 else began_s
    server.set_fault(Fault.NONE)
    wait_until(lambda: _runs(camera), what="recovery")
    return FaultTiming(state, state_after_s, reason, time.monotonic() - ended_s)


def time_4k(scene: Scene, camera: CameraSource, *, hold_s: float) -> FaultTiming:
    """Let a running camera change to 4K and back; return when the pictures of either size came."""
    scene.add_size(_LARGE_PX)
    before, scene.size_px = scene.size_px, _LARGE_PX
    after_s = wait_until(lambda: camera.status().size_px == _LARGE_PX and _runs(camera), what="4K picture")
    threading.Event().wait(hold_s - after_s)
    status, scene.size_px = camera.status(), before
    back_s = wait_until(lambda: camera.status().size_px == before and _runs(camera), what="picture of the old size")
    return FaultTiming(status.state.value, after_s, status.reason or "", back_s)


def sample_ages_ms(camera: CameraSource, *, rate_hz: float, count: int) -> list[int]:
    """Return how old the newest picture was whenever a consumer looked, at a rate.

    Looks are up to a picture's time off, else all would meet the same moment between two pictures.

    Raises:
        TrialError: In a picture no time could be read.
    """
    ages_ms, pause, began_s = [], threading.Event(), time.monotonic()
    off_s = np.random.default_rng(0).uniform(0.0, 1.0 / FPS, count)
    for number in range(count):
        pause.wait(began_s + number / rate_hz + off_s[number] - time.monotonic())
        frame, now_ms = camera.latest(), _now_ms()
        age_ms = read_age_ms(frame.image[:, :, 1], now_ms) if frame is not None else None
        if age_ms is None:
            raise TrialError("no time can be read in the picture that came")
        ages_ms.append(age_ms)
    return ages_ms


def wait_until(condition: Callable[[], bool], *, what: str) -> float:
    """Wait for a condition; return how long that took.

    Raises:
        TrialError: It took half a minute.
    """
    pause, began_s = threading.Event(), time.monotonic()
    while not condition():
        if time.monotonic() - began_s > _PATIENCE_S:
            raise TrialError(f"no {what} within {_PATIENCE_S:.0f} s")
        pause.wait(_POLL_S)
    return time.monotonic() - began_s


def _runs(camera: CameraSource) -> bool:
    return camera.status().state is CameraState.RUNNING


def _now_ms() -> int:
    return time.monotonic_ns() // 1_000_000


def _base(size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a picture (H·3/2, W) YUV 4:2:0: tiles of random brightness, blurred as a lens does."""
    width, height = size_px
    tiles = np.random.default_rng(0).integers(40, 200, (-(-height // 40), -(-width // 40)), dtype=np.uint8)
    luma = cv2.GaussianBlur(np.kron(tiles, np.ones((40, 40), np.uint8))[:height, :width], (5, 5), 0)
    return np.concatenate([luma, np.full((height // 2, width), 128, np.uint8)])
