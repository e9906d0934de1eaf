"""Keeps over a restart where robots are: a server may not see them then, and their odometry tells how far they went.

A file of its own beside the calibration, written twice a second at most, by a thread of its own. Where it cannot be
read robots must be seen before they are led, as without it.
"""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray, Pose2
from revnm_client.messages import Odometry
from revnm_server.calibration.store import write_whole

logger = logging.getLogger(__name__)

_FORMAT = "revnm robot places 1"
_INTERVAL_S, _PAUSE_S = 0.5, 30.0
_OLDEST_NS = 300_000_000_000
_REFRESHED_NS = 60_000_000_000
_LARGEST_M, _LARGEST_NS = 1e6, 2**63
_ARM_M = 0.2


class _Apart(NamedTuple):
    """How far two poses may lie apart."""

    way_m: float
    turn_rad: float

    def covers(self, a: Pose2, b: Pose2) -> bool:
        step = a.inverse() @ b
        return math.hypot(step.x_m, step.y_m) <= self.way_m and abs(step.yaw_rad) <= self.turn_rad


_STANDS = _Apart(0.05, 0.05)
_GOES_ON = _Apart(1.5, 2.0)  # a robot that is driven stands within a second of its last plan
_BEGINS = _Apart(0.02, 0.02)


class Place(NamedTuple):
    """Where a robot was.

    Attributes:
        stamp_ns: When, server's clock.
        floor_from_robot: Pose in the camera's floor frame.
        odom_from_robot: By its own odometry.
    """

    stamp_ns: int
    floor_from_robot: Pose2
    odom_from_robot: Pose2

    def carried(self, odom_from_robot: Pose2) -> Pose2:
        """Return where the robot is on the floor by its odometry since."""
        return self.floor_from_robot @ self.odom_from_robot.inverse() @ odom_from_robot

    def goes_on(self, odometry: Odometry) -> bool:
        """Return whether odometry that is heard first now is of the same frame, as far as it tells, and soon enough.

        What begins at the origin has begun anew, unless the robot was there.
        """
        now, origin = odometry.odom_from_robot, Pose2(0.0, 0.0, 0.0)
        anew = _BEGINS.covers(origin, now) and not _STANDS.covers(origin, self.odom_from_robot)
        soon = 0 <= odometry.stamp_ns - self.stamp_ns <= _OLDEST_NS
        return soon and not anew and _GOES_ON.covers(self.odom_from_robot, now)

    def tells(self, other: Place) -> bool:
        """Return whether this says of the robot what ``other`` says, as nearly as matters."""
        fresh = abs(self.stamp_ns - other.stamp_ns) <= _REFRESHED_NS
        return (
            fresh
            and _STANDS.covers(self.floor_from_robot, other.floor_from_robot)
            and _STANDS.covers(self.odom_from_robot, other.odom_from_robot)
        )


class Anchor:
    """Where a robot was before a restart: holds as long as its odometry goes on from there, and nobody has seen it."""

    def __init__(self, place: Place | None) -> None:
        self._place = place
        self._drive: int | None = None
        self._last: Pose2 | None = None

    @property
    def holds(self) -> bool:
        """Whether the robot may be led from there."""
        return self._place is not None and self._drive is not None

    def hear(self, odometry: Odometry, drive: int) -> None:
        """Take the newest odometry, and the drive that it belongs to."""
        if self._place is None:
            return
        now = odometry.odom_from_robot
        if self._last is None:
            goes_on = self._place.goes_on(odometry)
        else:  # stamps alone may step back, once it is known how the robot's clock goes
            goes_on = drive == self._drive or _STANDS.covers(self._last, now)
        if not goes_on:
            self.forget()
            return
        self._drive, self._last = drive, now

    def floor_from_robot(self, odom_from_robot: Pose2, drive: int) -> Pose2 | None:
        """Return where the robot is by its odometry since; None where that is not known."""
        if self._place is None or drive != self._drive:
            return None
        return self._place.carried(odom_from_robot)

    def carry(self, onto: Callable[[FloatArray], tuple[FloatArray, NDArray[np.bool_]]]) -> None:
        """Go over to another floor frame; ``onto`` takes points (2, 2) there, and tells for which that is known."""
        if self._place is None:
            return
        x, y, yaw = self._place.floor_from_robot
        ends, known = onto(np.array([[x, y], [x + _ARM_M * math.cos(yaw), y + _ARM_M * math.sin(yaw)]]))
        if not known.all():
            self.forget()
            return
        ahead = ends[1] - ends[0]
        moved = Pose2(float(ends[0, 0]), float(ends[0, 1]), math.atan2(ahead[1], ahead[0]))
        self._place = self._place._replace(floor_from_robot=moved)

    def forget(self) -> None:
        """Hold no more."""
        self._place = None


class PlaceKeeper:
    """Loads and saves where one camera's robots are.

    Attributes:
        trouble: Why the file could not be written, if so.
    """

    def __init__(self, folder: Path, camera: str, *, now_s: Callable[[], float] = time.monotonic) -> None:
        """Keep it in ``folder/camera.places.json``.

        Args:
            folder: Is made when it is needed.
            camera: Its name.
            now_s: Monotonic clock.
        """
        self.trouble: str | None = None
        self._path, self._camera, self._now_s = folder / f"{camera}.places.json", camera, now_s
        self._wanted: dict[str, Place] = {}
        self._saved: dict[str, Place] = {}
        self._due_s = -math.inf
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="places")
        self._writing: Future[None] | None = None

    def load(self) -> dict[str, Place]:
        """Return by robot where it was; nothing where there is no file, or no sound one."""
        try:
            found = _read(json.loads(self._path.read_text()), self._camera)
        except FileNotFoundError:
            found = {}
        except (OSError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
            logger.warning("%s: refused, robots must be seen first: %r", self._path, error)
            found = {}
        self._wanted, self._saved = dict(found), found
        return dict(found)

    def offer(self, places: Mapping[str, Place | None]) -> bool:
        """Say where robots are now; return whether that is being saved.

        Args:
            places: None for a robot of which nobody knows any more. Who is not among them is where it was.
        """
        self._wanted |= {robot: place for robot, place in places.items() if place is not None}
        for robot in [robot for robot, place in places.items() if place is None]:
            self._wanted.pop(robot, None)
        busy = self._writing is not None and not self._writing.done()
        if busy or self._now_s() < self._due_s or self._is_saved():
            return False
        self._due_s = self._now_s() + (_INTERVAL_S if self.trouble is None else _PAUSE_S)
        self._writing = self._thread.submit(self._write, dict(self._wanted))
        return True

    def close(self) -> None:
        """Save where they were at last."""
        self._thread.shutdown()
        if not self._is_saved():
            self._write(self._wanted)

    def _is_saved(self) -> bool:
        known = self._wanted.keys() == self._saved.keys()
        return known and all(place.tells(self._saved[robot]) for robot, place in self._wanted.items())

    def _write(self, places: dict[str, Place]) -> None:
        content = {"format": _FORMAT, "camera": self._camera, "places": places}
        try:
            write_whole(self._path, json.dumps(content) + "\n")
        except OSError as error:
            if self.trouble is None:
                logger.warning("%s: %s", self._path, error)
            self.trouble = f"{self._path}: {error.strerror or error}"
        else:
            self._saved, self.trouble = places, None


def _read(content: Any, camera: str) -> dict[str, Place]:
    """Return the places of a file's content.

    Raises:
        ValueError and others: It is malformed, or another camera's.
    """
    if content["format"] != _FORMAT or content["camera"] != camera:
        raise ValueError(f"expected {_FORMAT!r} of camera {camera!r}")
    return {
        robot: Place(_stamp_ns(stamp_ns), _pose(floor), _pose(odom))
        for robot, (stamp_ns, floor, odom) in content["places"].items()
    }


def _stamp_ns(value: Any) -> int:
    if not 0 <= int(value) < _LARGEST_NS:
        raise ValueError(f"{value}: expected nanoseconds")
    return int(value)


def _pose(values: Any) -> Pose2:
    x, y, yaw = (float(value) for value in values)
    if not all(abs(value) <= _LARGEST_M for value in (x, y, yaw)):  # no number is within, either
        raise ValueError(f"{values}: expected metres and radians")
    return Pose2(x, y, yaw)
