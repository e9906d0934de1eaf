"""What the server asks of a camera, and the states a camera can be in."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

from revnm_server.frame import Frame


class CameraState(StrEnum):
    """Where a camera stands; only a RUNNING one may steer a robot."""

    INIT = "init"
    """Nothing has come yet."""
    RUNNING = "running"
    """New pictures keep coming."""
    STALE = "stale"
    """Connected, yet no new picture for a second, or the same one while a robot drives in it."""
    RECONNECTING = "reconnecting"
    """The connection broke or never came about; it is tried again."""
    ENDED = "ended"
    """The file is over, or the camera was closed."""


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """A camera's health at one moment.

    Attributes:
        state: Where it stands.
        reason: Why it is not running; None where it is.
        warning: What is odd though it runs, such as a picture that never changes.
        size_px: Width and height of the newest picture; None before the first.
        fps: Pictures a second lately; None before the second picture.
        frame_age_s: Time since the newest picture came; None before the first.
        rejected: Pictures that were refused.
    """

    state: CameraState
    reason: str | None
    warning: str | None
    size_px: tuple[int, int] | None
    fps: float | None
    frame_age_s: float | None
    rejected: int


class CameraSource(Protocol):
    """A camera: a reader thread of its own behind a slot that holds the newest frame."""

    @property
    def redacted_url(self) -> str:
        """The camera's address without credentials."""
        ...

    def latest(self) -> Frame | None:
        """Return the newest frame, however old; None before the first."""
        ...

    def wait_newer(self, seq: int, *, timeout_s: float) -> Frame | None:
        """Return the newest frame as soon as its number is not ``seq``; None after ``timeout_s``."""
        ...

    def status(self) -> CameraStatus:
        """Return the camera's health now."""
        ...

    def note_motion(self, robot: str | None) -> None:
        """Note which robot, lately seen, says that it drives; None where none does. Call it several times a second.

        A picture that stays the same meanwhile is STALE. Ignored where equal pictures are honest: files, the
        simulator's over Zenoh.
        """
        ...

    def note_standing(self, robot: str) -> None:
        """Note a robot that the picture shows standing though its odometry has it drive: the picture is STALE.

        Ignored where :meth:`note_motion` is.
        """
        ...

    def close(self) -> None:
        """Stop reading; the state becomes ENDED."""
        ...
