"""Follows robots by their tags from picture to picture, whichever library finds them."""

from __future__ import annotations

from collections.abc import Mapping, Set

import cv2
import numpy as np

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame, RobotSighting
from revnm_server.tag.choice import open_tag_library
from revnm_server.tag.library import SMALLEST_PICTURE_PX, Gray, Region, TagLibrary
from revnm_server.tag.regions import FARTHEST_SIDES, IDLE_WORK_PX, WORK_PX, Sweep, region_around

_FRESH_S = 1.0  # a robot that was seen so lately is looked for where it was, later where it is expected
# How far around a tag is looked, in its sides: its white rim is an eighth; at 0.5 m/s one of 0.2 m moves 2.5 a second.
_STILL_SIDES, _SIDES_PER_S = 0.25, 3.0
_EXPECTED_SIDES = 1.0
_SEARCH_INTERVAL = 5  # pictures between searches while some are seen, and the others expected where they are hidden
_EDGE_PX = 1.0
_NS_PER_S = 1e9


class TagDetector:
    """Finds the configured robots in pictures of one camera; not for use by several threads.

    A robot is looked for around its last place, or where it is expected, first. Who is not there is searched for,
    a piece of the picture each time, so that no picture takes much longer than another.
    """

    def __init__(self, tag_ids: Mapping[int, str], *, library: TagLibrary | None = None) -> None:
        """Create the detector.

        Args:
            tag_ids: The robot's name by the id of its tag.
            library: What finds tags, of this detector alone; the better one that loads if it is not given.
        """
        self._robots = dict(tag_ids)
        self._library = open_tag_library("auto").library if library is None else library
        self._last_seen: dict[int, RobotSighting] = {}
        self._sweep = Sweep()
        self._since_search = 0

    def sightings(self, frame: Frame, expected: Mapping[str, FloatArray] | None = None) -> list[RobotSighting]:
        """Return the robots that are visible in this picture, at most one sighting per robot.

        Args:
            frame: The picture.
            expected: (4, 2) by robot: about where its tag's corners should be, seen or hidden.

        Raises:
            ContractError: The picture is not (H, W, 3) uint8.
        """
        if frame.image.dtype != np.uint8 or frame.image.ndim != 3 or frame.image.shape[2] != 3:
            raise ContractError(f"picture: expected (H, W, 3) uint8, got {frame.image.shape} {frame.image.dtype}")
        if min(frame.size_px) < SMALLEST_PICTURE_PX:
            return []
        gray = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        places = expected or {}
        found = self._follow(gray, frame.stamp_ns, places)
        lost = self._robots.keys() - found.keys()
        if lost:
            found |= self._search(gray, lost, frame.stamp_ns, seen=bool(found), expected=places)
        self._last_seen |= found
        return list(found.values())

    def _follow(self, gray: Gray, stamp_ns: int, expected: Mapping[str, FloatArray]) -> dict[int, RobotSighting]:
        """Look for each robot where it was just now, else where it is expected, else where it was long ago."""
        found: dict[int, RobotSighting] = {}
        for tag_id, robot in self._robots.items():
            last = self._last_seen.get(tag_id)
            age_s = np.inf if last is None else abs(stamp_ns - last.stamp_ns) / _NS_PER_S
            if robot in expected and age_s > _FRESH_S:
                region = region_around(gray, expected[robot], margin_sides=_EXPECTED_SIDES)
            elif last is not None:
                margin = min(_STILL_SIDES + _SIDES_PER_S * age_s, FARTHEST_SIDES)
                region = region_around(gray, last.corners, margin_sides=margin)
            else:
                continue
            found |= self._sight(region, {tag_id}, stamp_ns)
        return found

    def _search(
        self, gray: Gray, lost: Set[int], stamp_ns: int, *, seen: bool, expected: Mapping[str, FloatArray]
    ) -> dict[int, RobotSighting]:
        """Look for lost robots in a piece of the picture."""
        unplaced = any(self._robots[tag_id] not in expected for tag_id in lost)
        self._since_search += 1
        if seen and not unplaced and self._since_search < _SEARCH_INTERVAL:
            return {}
        self._since_search = 0
        work_px = WORK_PX if seen or expected else IDLE_WORK_PX
        return self._sight(self._sweep.piece(gray, work_px), lost, stamp_ns)

    def _sight(self, region: Region, wanted: Set[int], stamp_ns: int) -> dict[int, RobotSighting]:
        detections = sorted(self._library.detect(region), key=lambda each: each.margin)
        return {  # of two with one id the clearer one stays
            each.tag_id: RobotSighting(self._robots[each.tag_id], stamp_ns, each.pixel, each.heading, each.corners)
            for each in detections
            if each.tag_id in wanted and _is_whole(region, each.corners)
        }


def _is_whole(region: Region, corners: FloatArray) -> bool:
    """Tell whether a tag lies in a region with all corners (4, 2): one that was cut off is wrong by a pixel."""
    corner_px = np.array([region.left, region.top]) - 0.5
    size_px = np.array(region.gray.shape[::-1]) / region.scale
    return bool(np.all((corners > corner_px + _EDGE_PX) & (corners < corner_px + size_px - _EDGE_PX)))
