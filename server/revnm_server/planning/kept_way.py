"""The way that a robot is on, and when it is left for another: the map flickers, the robot must not.

Imports numpy only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.planning.way import bent_to, evenly, farthest_m, rest_of

Carry = Callable[[FloatArray], tuple[FloatArray, NDArray[np.bool_]]]
"""Takes points (M, 2) into another frame; tells for which of them (M,) that is known."""

_LOOK_AHEAD_M = 1.5  # so far along the way the robot is looked for
_AGAIN_PER_M = 3.0  # metres in which the robot is led back to the way, for each metre that it is beside it
_AGAIN_LEAST_M = 0.8
_LONG_AGO_NS = -(1 << 62)
_COARSE = 3  # of the way's points one in so many is compared


@dataclass(frozen=True, slots=True)
class KeepSettings:
    """How firmly a way is kept.

    Attributes:
        ratio: Another way is clearly cheaper if it costs less than this share of the kept one...
        margin: ...and so much less, metres of free floor.
        patience: It must be so in so many searches, one after the other.
        much: At less than this share it is taken at once.
        corridor_m: The kept way may swerve so far for what comes to be seen; other ways are compared with the best
            way within. Else a speck that flickers on the kept way would make the other side look cheaper.
        same_m: A way that stays so near to the kept one passes everything on the same side.
        same_ratio: It is taken if it costs less than this share.
        nearer_m: A way that ends so much nearer to the goal is taken at once.
        off_m: A robot farther away is no longer on the way.
        moved_m: A goal that moved farther, though it is called the same, is a new one.
        turn_m_per_rad: What turning into a way costs, in metres of free floor.
    """

    ratio: float = 0.85
    margin: float = 0.5
    patience: int = 2
    much: float = 0.5
    corridor_m: float = 0.6
    same_m: float = 0.4
    same_ratio: float = 0.98
    nearer_m: float = 0.3
    off_m: float = 0.8
    moved_m: float = 0.5
    turn_m_per_rad: float = 0.6


@dataclass(frozen=True, slots=True)
class Option:
    """A way that could be taken now.

    Attributes:
        way_m: (P, 2) from the robot, metres, frame of the map.
        cost: Of it and of turning into it, in metres of free floor.
        short_m: How far from the goal it ends; 0 if it leads there.
        blocked: It goes where no way may go.
    """

    way_m: FloatArray
    cost: float
    short_m: float
    blocked: bool


@dataclass(frozen=True, slots=True)
class KeptWay:
    """The way that was chosen last.

    Attributes:
        goal_id: Of the goal that it was chosen for.
        goal_m: (2,) where that was, metres, frame of the map.
        way_m: (P, 2) what of it lies ahead, evenly spaced; None if there was none.
        short_m: How far from the goal it ends.
        reason: Why it does not lead to the goal; empty where it does.
        searched_ns: When a way was looked for last.
        defeats: In so many searches, one after the other, another way was clearly cheaper.
    """

    goal_id: str
    goal_m: FloatArray
    way_m: FloatArray | None
    short_m: float
    reason: str
    searched_ns: int
    defeats: int = 0

    def serves(self, goal_id: str, goal_m: FloatArray, robot_m: FloatArray, settings: KeepSettings) -> bool:
        """Tell whether the goal is the same and the robot still on the way."""
        if goal_id != self.goal_id or float(np.hypot(*(goal_m - self.goal_m))) > settings.moved_m:
            return False
        if self.way_m is None:
            return True
        ahead = rest_of(self.way_m, robot_m, within_m=_LOOK_AHEAD_M)
        return float(np.hypot(*(ahead[0] - robot_m))) <= settings.off_m

    def followed(self, robot_m: FloatArray, goal_m: FloatArray) -> KeptWay:
        """Return what lies ahead of the robot (2,); if the way leads to the goal, its end follows the goal (2,)."""
        if self.way_m is None:
            return self
        ahead = rest_of(self.way_m, robot_m, within_m=_LOOK_AHEAD_M)
        if self.short_m == 0.0:
            ahead = bent_to(ahead[::-1], goal_m, over_m=_AGAIN_LEAST_M)[::-1]
        return replace(self, way_m=ahead, goal_m=goal_m)

    def carried(self, onto: Carry) -> KeptWay | None:
        """Return the way in another frame, searched long ago; None where it does not lie in that, or there was none."""
        if self.way_m is None:
            return None
        moved, valid = onto(np.concatenate([self.way_m, self.goal_m[None]]))
        if not valid.all():
            return None
        return replace(self, way_m=evenly(moved[:-1]), goal_m=moved[-1], searched_ns=_LONG_AGO_NS)

    def from_robot(self, robot_m: FloatArray) -> FloatArray | None:
        """Return the way (P, 2) from the robot (2,), led smoothly back to the kept one, evenly spaced."""
        if self.way_m is None:
            return None
        beside_m = float(np.hypot(*(robot_m - self.way_m[0])))
        return evenly(bent_to(self.way_m, robot_m, over_m=max(_AGAIN_LEAST_M, _AGAIN_PER_M * beside_m)))


def swerves(kept: Option, beside: Option, settings: KeepSettings) -> bool:
    """Tell whether the best way in the corridor of the kept one shall be taken instead: no change of mind.

    Small gains are taken only where everything is passed on the same side, so that it does not sway about a post.
    """
    if beside.short_m > kept.short_m + settings.nearer_m or beside.blocked:
        return False
    if kept.blocked or beside.cost < min(settings.ratio * kept.cost, kept.cost - settings.margin):
        return True
    near = farthest_m(beside.way_m[::_COARSE], kept.way_m) <= settings.same_m
    return near and beside.cost < settings.same_ratio * kept.cost


def judge(kept: Option, other: Option, defeats: int, settings: KeepSettings) -> tuple[bool, int]:
    """Tell whether another way shall be taken, and how often in a row, with this time, it was clearly cheaper.

    A blocked way is left at once, and so is one that ends farther from the goal; for a much cheaper one too; for a
    clearly cheaper one when it stays so.
    """
    if kept.blocked or other.short_m < kept.short_m - settings.nearer_m:
        return True, 0
    if other.short_m > kept.short_m + settings.nearer_m:
        return False, 0
    clearly = other.cost < min(settings.ratio * kept.cost, kept.cost - settings.margin)
    defeats = defeats + 1 if clearly else 0
    much = clearly and other.cost < settings.much * kept.cost
    return much or defeats >= settings.patience, defeats
