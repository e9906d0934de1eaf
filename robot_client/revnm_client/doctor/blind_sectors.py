"""Where a LiDAR cannot see."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revnm_client.messages import Scan
from revnm_client.obstacle_memory import beams_at

_NARROWEST_DEG = 5


class Sector(NamedTuple):
    """Directions from ``begin_deg`` counter-clockwise to ``end_deg``, degrees in [−180, 180), 0 is the front."""

    begin_deg: int
    end_deg: int

    def __str__(self) -> str:
        return f"{self.begin_deg}° to {self.end_deg}°"


def blind_degrees(scans: Sequence[Scan]) -> NDArray[np.bool_]:
    """Return (360,) for each whole degree from −180: no scan of these saw anything there, not even that it is free.

    That is so outside of the field of view and where ranges are below the shortest one, as of masked beams.
    """
    seen = np.zeros(360, dtype=bool)
    for scan in scans:
        bearings = np.radians(np.arange(-180, 180)) - scan.robot_from_lidar.yaw_rad
        beam, inside = beams_at(np.stack([np.cos(bearings), np.sin(bearings)], axis=1), scan)
        seen |= inside & scan.sees[beam]
    return ~seen


def sectors(degrees: NDArray[np.bool_]) -> list[Sector]:
    """Return the runs of true degrees (360,) that are 5° wide at least, around the circle."""
    if degrees.all():
        return [Sector(-180, 179)]
    first = int(np.flatnonzero(~degrees)[0])
    turned = np.roll(degrees, -first)  # begins with one that is false: no run goes over the end
    edges = np.diff(np.concatenate([[False], turned, [False]]).astype(np.int8))
    runs = zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True)
    wide = [(begin, end) for begin, end in runs if end - begin >= _NARROWEST_DEG]
    return [Sector(_wrapped(begin + first), _wrapped(end - 1 + first)) for begin, end in wide]


def _wrapped(index: int) -> int:
    return index % 360 - 180
