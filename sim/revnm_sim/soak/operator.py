"""Who gives a robot goals, one after the other, and judges how each ended."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from revnm_client.errors import LinkError
from revnm_sim.live.demo import ROBOT
from revnm_sim.live.server_api import ServerApi
from revnm_sim.site import GOAL_RADIUS_M
from revnm_sim.soak.goals import Goal, GoalDraw


@dataclass(frozen=True, slots=True)
class Drive:
    """How the drive to a goal ended.

    Attributes:
        goal: Where to.
        reached: The server said that the robot had arrived, and it truly was within 0.5 m.
        place_m: Where the robot truly was in the end.
        reason: What the server said then, or that it was wrong; empty where it was right.
    """

    goal: Goal
    reached: bool
    place_m: tuple[float, float]
    reason: str

    @property
    def off_m(self) -> float:
        """How far from the goal the robot was."""
        return math.dist(self.goal.place_m, self.place_m)


class Operator:
    """Sends a robot to random goals.

    Args:
        api: The server's.
        place_m: Tells where the robot truly is, (x, y), world frame.
        goals: Where to.

    Attributes:
        drives: Those that have ended.
    """

    def __init__(self, api: ServerApi, place_m: Callable[[], tuple[float, float]], goals: GoalDraw) -> None:
        self.drives: list[Drive] = []
        self._api, self._place_m, self._goals = api, place_m, goals
        self._send(goals.draw(place_m()))

    def look(self, robot: dict[str, Any]) -> None:
        """Look at what the server says of the robot; where it has arrived, or is too late, send it on."""
        if self._goal_id is None:
            self._point()
        elif robot["status"] == "arrived" and robot["goal"] is not None and robot["goal"]["id"] == self._goal_id:
            off_m = math.dist(self._goal.place_m, self._place_m())
            right = off_m <= GOAL_RADIUS_M
            self._end(reached=right, reason="" if right else f"the server says arrived {off_m:.2f} m away")
        elif time.monotonic() > self._deadline_s:
            self._end(reached=False, reason=f"{robot['status']}: {robot['reason']}")

    def grant(self, seconds: float) -> None:
        """Give the robot more time for its goal."""
        self._deadline_s += seconds

    def resume(self) -> None:
        """Release the robot's stop and send it to its goal again."""
        self._api.order(ROBOT, "resume")
        self._point()

    def _end(self, *, reached: bool, reason: str) -> None:
        place_m = self._place_m()
        self.drives.append(Drive(self._goal, reached, place_m, reason))
        self._send(self._goals.draw(place_m))

    def _send(self, goal: Goal) -> None:
        self._goal, self._deadline_s = goal, time.monotonic() + goal.limit_s
        self._point()

    def _point(self) -> None:
        """Tell the server the goal; where it takes none, as before its first picture, the next look tries again."""
        u, v = self._goal.pixel
        self._goal_id: str | None = None
        with suppress(LinkError):
            self._goal_id = self._api.set_goal(ROBOT, u=u, v=v)
