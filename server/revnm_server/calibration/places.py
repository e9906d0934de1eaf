"""Keeps over a restart where robots are: a server may not see them then, and their odometry tells how far they went.

A file of its own beside the calibration, written at most once a second, by a thread of its own. It is no loss where it
cannot be read: then a robot must be seen before it is led.
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

from revnm_client.geometry import Pose2, wrap_angle

logger = logging.getLogger(__name__)

_FORMAT = "revnm robot places 1"
_INTERVAL_S = 1.0
_OLDEST_NS = 300_000_000_000
_REFRESHED_NS = 60_000_000_000
_FARTHEST_M, _MOST_TURNED_RAD = 1.0, 1.0  # robots without plans stand, within a second
_MOVED_M, _TURNED_RAD = 0.05, 0.05


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

    def holds(self, stamp_ns: int, odom_from_robot: Pose2) -> bool:
        """Return whether odometry that is heard first now can be of the same frame, and soon enough to trust it."""
        step = self.odom_from_robot.inverse() @ odom_from_robot
        near = math.hypot(step.x_m, step.y_m) <= _FARTHEST_M and abs(step.yaw_rad) <= _MOST_TURNED_RAD
        return near and 0 <= stamp_ns - self.stamp_ns <= _OLDEST_NS

    def tells(self, other: Place) -> bool:
        """Return whether this says of the robot what ``other`` says, as nearly as matters."""
        pairs = (
            (self.floor_from_robot, other.floor_from_robot),
            (self.odom_from_robot, other.odom_from_robot),
        )
        return abs(self.stamp_ns - other.stamp_ns) <= _REFRESHED_NS and all(
            math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) <= _MOVED_M
            and abs(wrap_angle(a.yaw_rad - b.yaw_rad)) <= _TURNED_RAD
            for a, b in pairs
        )


class PlaceKeeper:
    """Loads and saves where one camera's robots are."""

    def __init__(self, folder: Path, camera: str, *, now_s: Callable[[], float] = time.monotonic) -> None:
        """Keep it in ``folder/camera.places.json``.

        Args:
            folder: Is made when it is needed.
            camera: Its name.
            now_s: Monotonic clock.
        """
        self._path, self._camera, self._now_s = folder / f"{camera}.places.json", camera, now_s
        self._wanted: dict[str, Place] = {}
        self._saved: dict[str, Place] = {}
        self._tried_s = -math.inf
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="places")
        self._writing: Future[None] | None = None

    def load(self) -> dict[str, Place]:
        """Return by robot where it was; nothing where there is no file, or no sound one."""
        try:
            return _read(json.loads(self._path.read_text()), self._camera)
        except FileNotFoundError:
            return {}
        except (OSError, ValueError, TypeError, KeyError) as error:
            logger.warning("%s: refused, robots must be seen first: %r", self._path, error)
            return {}

    def offer(self, places: Mapping[str, Place]) -> None:
        """Say where robots are now; it is saved if that is due. Who is not among them is where it was."""
        self._wanted |= places
        due = self._now_s() - self._tried_s >= _INTERVAL_S
        busy = self._writing is not None and not self._writing.done()
        if due and not busy and not self._is_saved():
            self._tried_s = self._now_s()
            self._writing = self._thread.submit(self._write, dict(self._wanted))

    def close(self) -> None:
        """Save where they were at last."""
        self._thread.shutdown()
        if not self._is_saved():
            self._write(self._wanted)

    def _is_saved(self) -> bool:
        return all(robot in self._saved and place.tells(self._saved[robot]) for robot, place in self._wanted.items())

    def _write(self, places: dict[str, Place]) -> None:
        content = {"format": _FORMAT, "camera": self._camera, "places": places}
        fresh = self._path.with_name(self._path.name + ".new")
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            fresh.write_text(json.dumps(content) + "\n")
            fresh.replace(self._path)
        except OSError as error:
            logger.warning("%s: %s", self._path, error)
        else:
            self._saved = places


def _read(content: Any, camera: str) -> dict[str, Place]:
    """Return the places of a file's content.

    Raises:
        ValueError, TypeError, KeyError: It is malformed, or another camera's.
    """
    if content["format"] != _FORMAT or content["camera"] != camera:
        raise ValueError(f"expected {_FORMAT!r} of camera {camera!r}")
    return {
        robot: Place(int(stamp_ns), _pose(floor), _pose(odom))
        for robot, (stamp_ns, floor, odom) in content["places"].items()
    }


def _pose(values: Any) -> Pose2:
    x, y, yaw = (float(value) for value in values)
    if not all(map(math.isfinite, (x, y, yaw))):
        raise ValueError(f"{values}: expected finite numbers")
    return Pose2(x, y, yaw)
