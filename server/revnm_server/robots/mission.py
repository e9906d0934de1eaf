"""What the operator wants of each robot: its goal, whether it is stopped, and the epoch of its plans.

The only place where goals and stops are kept; what robots say of a stop :mod:`revnm_server.service` minds, too. It
outlives the process: every change is written to the state file, so a killed server goes on where it was. Reads never
wait for the disk.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NamedTuple
from uuid import uuid4

from revnm_client.errors import ConfigError, ContractError, RevnmError
from revnm_client.keys import check_name
from revnm_server.robots.mission_file import MissionFile, Record

logger = logging.getLogger(__name__)

ARRIVAL_PX = 20.0
"""Robot and goal nearer than this, in a picture 640 pixels wide, are together (paper, section IV)."""

ARRIVAL_WIDTH_PX = 640
MAX_EPOCH = 2**52
"""Epochs from this on are not believed: no server counts that far, and the state file's end at 2⁵³."""


class UnknownRobotError(ConfigError):
    """No robot of that name is configured."""


class GoalError(ContractError):
    """A goal is not finite or lies outside the picture."""


class StoppedError(RevnmError):
    """A goal was set for a robot whose stop is latched."""


@dataclass(frozen=True, slots=True)
class Goal:
    """Where the operator clicked.

    Attributes:
        id: Unique to this click; plans carry it.
        pixel_uv: The click (u, v), pixels of the camera's picture.
        size_px: Width and height of that picture, pixels.
    """

    id: str
    pixel_uv: tuple[float, float]
    size_px: tuple[int, int]

    @property
    def normalised(self) -> tuple[float, float]:
        """The click divided by the picture's width and height, in [0, 1)."""
        return self.pixel_uv[0] / self.size_px[0], self.pixel_uv[1] / self.size_px[1]


class PlanNumber(NamedTuple):
    """What makes a plan the newest: see :class:`revnm_client.messages.Plan`."""

    epoch: int
    seq: int


@dataclass(frozen=True, slots=True)
class RobotMission:
    """What is wanted of one robot.

    Attributes:
        goal: Where to go; None after a stop.
        arrived: The goal has been reached; no more plans.
        stopped: The stop is latched.
        epoch: Raised by every stop and every start of the server.
        order: What the robot has not yet confirmed, if anything.
    """

    goal: Goal | None = None
    arrived: bool = False
    stopped: bool = False
    epoch: int = 0
    order: Literal["stop", "resume"] | None = None


class Mission:
    """Goals, stops and epochs of all robots. Thread-safe.

    Args:
        robots: Their names.
        state_file: Where it is kept over a restart; None keeps it in memory only.

    Raises:
        ConfigError: A name may not stand in a key.
        FileError: The state file is there and malformed.
    """

    def __init__(self, robots: Iterable[str], *, state_file: Path | None = None) -> None:
        self._lock = threading.Lock()
        self._file = MissionFile(state_file) if state_file is not None else None
        saved = self._file.load() if self._file is not None else {}
        self._robots = {check_name(name): _restored(saved.get(name)) for name in robots}
        self._strangers = {name: record for name, record in saved.items() if name not in self._robots}
        self._seq = dict.fromkeys(self._robots, 0)
        self._heard: set[str] = set()
        self._version = 0
        self._save()

    @property
    def names(self) -> Sequence[str]:
        """The robots' names."""
        return tuple(self._robots)

    @property
    def version(self) -> int:
        """Counts the changes of what is wanted."""
        with self._lock:
            return self._version

    @property
    def save_error(self) -> str | None:
        """Why the last change could not be written, if it could not."""
        return self._file.error if self._file is not None else None

    def of(self, robot: str) -> RobotMission:
        """Return what is wanted of ``robot`` now.

        Raises:
            UnknownRobotError: It is not configured.
        """
        with self._lock:
            return self._get(robot)

    def driving_goals(self) -> dict[str, Goal]:
        """Return the goals of the robots that are to drive now: not stopped, not arrived."""
        with self._lock:
            return {
                name: wanted.goal
                for name, wanted in self._robots.items()
                if wanted.goal is not None and not wanted.arrived and not wanted.stopped
            }

    def set_goal(self, robot: str, u: float, v: float, *, size_px: tuple[int, int]) -> Goal:
        """Send ``robot`` to the pixel (u, v) of a picture of ``size_px`` = (width, height).

        Raises:
            UnknownRobotError: The robot is not configured.
            GoalError: The pixel is not finite or outside the picture.
            StoppedError: The robot's stop is latched.
        """
        width, height = size_px
        if not (math.isfinite(u) and math.isfinite(v) and 0 <= u < width and 0 <= v < height):
            raise GoalError(f"goal ({u}, {v}) is outside the picture: expected 0 <= u < {width}, 0 <= v < {height}")
        goal = Goal(uuid4().hex[:12], (float(u), float(v)), size_px)
        with self._lock:
            wanted = self._get(robot)
            if wanted.stopped:
                raise StoppedError(f"{robot} is stopped: resume it before you set a goal")
            self._put(robot, replace(wanted, goal=goal, arrived=False))
        self._save()
        return goal

    def drop_goal(self, robot: str) -> None:
        """Forget the goal of ``robot``.

        Raises:
            UnknownRobotError: It is not configured.
        """
        with self._lock:
            self._put(robot, replace(self._get(robot), goal=None, arrived=False))
        self._save()

    def stop(self, robot: str) -> RobotMission:
        """Latch the stop of ``robot``, forget its goal, raise its epoch; it holds even where saving fails.

        Raises:
            UnknownRobotError: It is not configured.
        """
        with self._lock:
            epoch = self._get(robot).epoch + 1
            stopped = RobotMission(stopped=True, epoch=epoch, order="stop")
            self._put(robot, stopped)
        self._save()
        return stopped

    def resume(self, robot: str) -> RobotMission:
        """Release the stop of ``robot``; one that :meth:`stop` stopped has no goal, and stands until it is given one.

        Raises:
            UnknownRobotError: It is not configured.
        """
        with self._lock:
            resumed = replace(self._get(robot), stopped=False, order="resume")
            self._put(robot, resumed)
        self._save()
        return resumed

    def halt(self, robot: str) -> RobotMission:
        """Raise the epoch of ``robot`` and owe it a resume: the server shuts down and tells it to stand.

        The goal stays: after a restart the robot is told to go on.
        """
        with self._lock:
            wanted = self._get(robot)
            halted = replace(wanted, epoch=wanted.epoch + 1, order="stop" if wanted.stopped else "resume")
            self._put(robot, halted)
        self._save()
        return halted

    def confirm(self, robot: str, order: RobotMission) -> None:
        """Note that the robot has confirmed ``order``, unless something else is wanted by now."""
        with self._lock:
            wanted = self._get(robot)
            if (wanted.order, wanted.epoch) != (order.order, order.epoch):
                return
            self._put(robot, replace(wanted, order=None))
        self._save()

    def repeat_order(self, robot: str) -> None:
        """Tell a stopped robot again: it moves on, as after a restart of its own."""
        with self._lock:
            wanted = self._get(robot)
            if wanted.stopped:
                self._put(robot, replace(wanted, order="stop"))

    def catch_up(self, robot: str, epoch: int) -> None:
        """Get ahead of a robot that knows an epoch from another server, as after the loss of the state file.

        Its last plan of that epoch has a number that nobody here knows, and it refuses what is not newer; so
        the next epoch is taken. The first time that a robot is heard, an equal epoch may be such a one.
        """
        with self._lock:
            wanted = self._get(robot)
            foreign = epoch > wanted.epoch or (epoch == wanted.epoch and robot not in self._heard)
            self._heard.add(robot)
            if not foreign or epoch >= MAX_EPOCH:
                return
            # A resume that is owed yet would release a stop of the other server's operator.
            self._put(robot, replace(wanted, epoch=epoch + 1, order="stop" if wanted.stopped else None))
        self._save()

    def leave_to_another(self, robot: str) -> None:
        """Note that ``robot`` follows another server: of whatever epoch it is afterwards, that may be the other's."""
        with self._lock:
            self._heard.discard(robot)

    def number_plan(self, robot: str, goal_id: str) -> PlanNumber | None:
        """Return the next plan's number; None if ``robot`` is not to drive to that goal any more."""
        with self._lock:
            wanted = self._get(robot)
            if wanted.goal is None or wanted.goal.id != goal_id or wanted.stopped or wanted.arrived:
                return None
            self._seq[robot] += 1
            return PlanNumber(wanted.epoch, self._seq[robot])

    def note_position(self, robot: str, pixel_uv: tuple[float, float], *, size_px: tuple[int, int]) -> bool:
        """Compare where ``robot`` is with its goal; return whether it has just arrived.

        Args:
            robot: Its name.
            pixel_uv: Its position (u, v) in a picture of ``size_px``.
            size_px: Width and height of that picture.
        """
        width, height = size_px
        with self._lock:
            wanted = self._get(robot)
            if wanted.goal is None or wanted.arrived:
                return False
            u, v = wanted.goal.normalised
            distance_px = math.hypot(pixel_uv[0] - u * width, pixel_uv[1] - v * height)
            if distance_px > ARRIVAL_PX * width / ARRIVAL_WIDTH_PX:
                return False
            self._put(robot, replace(wanted, arrived=True))
        self._save()
        return True

    def note_arrival(self, robot: str, goal_id: str) -> None:
        """Note that ``robot`` has come to a goal, unless another is wanted by now."""
        with self._lock:
            wanted = self._get(robot)
            if wanted.goal is None or wanted.goal.id != goal_id or wanted.arrived:
                return
            self._put(robot, replace(wanted, arrived=True))
        self._save()

    def seq(self, robot: str) -> int:
        """Return the number of the last plan of ``robot``."""
        with self._lock:
            return self._seq[robot]

    def _get(self, robot: str) -> RobotMission:
        try:
            return self._robots[robot]
        except KeyError:
            known = ", ".join(self._robots) or "none"
            raise UnknownRobotError(f"no robot is named {robot[:80]!r}: configured are {known}") from None

    def _put(self, robot: str, wanted: RobotMission) -> None:
        if wanted.epoch != self._robots[robot].epoch:
            self._seq[robot] = 0
        self._robots[robot] = wanted
        self._version += 1

    def _save(self) -> None:
        if self._file is None:
            return
        with self._lock:
            version = self._version
            records = {name: _record(wanted) for name, wanted in self._robots.items()}
        self._file.save(self._strangers | records, version=version)


def _restored(record: Record | None) -> RobotMission:
    if record is None:
        return RobotMission(epoch=1)
    goal = record["goal"]
    return RobotMission(
        goal=Goal(goal["id"], goal["pixel_uv"], goal["size_px"]) if goal is not None else None,
        arrived=record["arrived"],
        stopped=record["stopped"],
        epoch=record["epoch"] + 1,
        order="stop" if record["stopped"] else record["order"],
    )


def _record(wanted: RobotMission) -> Record:
    goal = wanted.goal
    return {
        "goal": {"id": goal.id, "pixel_uv": goal.pixel_uv, "size_px": goal.size_px} if goal is not None else None,
        "arrived": wanted.arrived,
        "stopped": wanted.stopped,
        "epoch": wanted.epoch,
        "order": wanted.order,
    }
