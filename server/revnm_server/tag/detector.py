"""Follows robots by their tags from picture to picture, whichever library finds them."""

from __future__ import annotations

from collections.abc import Mapping, Set

import cv2
import numpy as np

from revnm_client.errors import ContractError
from revnm_server.frame import Frame, RobotSighting
from revnm_server.tag.choice import open_tag_library
from revnm_server.tag.library import SMALLEST_PICTURE_PX, Gray, Region, TagLibrary
from revnm_server.tag.regions import region_around, search_region

_SEARCH_INTERVAL = 5  # pictures between searches for lost robots while others are seen


class TagDetector:
    """Finds the configured robots in pictures of one camera; not for use by several threads.

    A robot that was seen is looked for around its last place first. Who is not there is looked for in the
    whole picture: every time while no robot is seen, else in every fifth picture.
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
        self._since_search = 0
        self._searches = 0

    def sightings(self, frame: Frame) -> list[RobotSighting]:
        """Return the robots that are visible in this picture, at most one sighting per robot.

        Raises:
            ContractError: The picture is not (H, W, 3) uint8.
        """
        if frame.image.dtype != np.uint8 or frame.image.ndim != 3 or frame.image.shape[2] != 3:
            raise ContractError(f"picture: expected (H, W, 3) uint8, got {frame.image.shape} {frame.image.dtype}")
        if min(frame.size_px) < SMALLEST_PICTURE_PX:
            return []
        gray = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        found = self._follow(gray, frame.stamp_ns)
        lost = self._robots.keys() - found.keys()
        self._since_search += 1
        if lost and (not found or self._since_search >= _SEARCH_INTERVAL):
            found |= self._search(gray, lost, frame.stamp_ns)
        self._last_seen |= found
        return list(found.values())

    def _follow(self, gray: Gray, stamp_ns: int) -> dict[int, RobotSighting]:
        """Look for each robot around its last place."""
        found: dict[int, RobotSighting] = {}
        for tag_id, last in self._last_seen.items():
            found |= self._sight(region_around(gray, last.corners), {tag_id}, stamp_ns)
        return found

    def _search(self, gray: Gray, lost: Set[int], stamp_ns: int) -> dict[int, RobotSighting]:
        """Look for lost robots in the whole picture."""
        region = search_region(gray, self._searches)
        self._since_search = 0
        self._searches += 1
        return self._sight(region, lost, stamp_ns)

    def _sight(self, region: Region, wanted: Set[int], stamp_ns: int) -> dict[int, RobotSighting]:
        detections = sorted(self._library.detect(region), key=lambda each: each.margin)
        return {  # of two with one id the clearer one stays
            each.tag_id: RobotSighting(self._robots[each.tag_id], stamp_ns, each.pixel, each.heading, each.corners)
            for each in detections
            if each.tag_id in wanted
        }
