"""Finds robots by the AprilTag (36h11) on their backs; the only module that imports pyapriltags.

A printed tag's upper edge, as in AprilRobotics/apriltag-imgs, lies at the robot's front: take pictures of
tags from there. OpenCV up to 5.0.0 prints the family upside down (opencv/opencv#28823).

The library is C behind ctypes and dies on bad input: an empty picture kills the process (SIGFPE), and
detectors crashed when destroyed or used from several threads (pupil-labs/apriltags#34, #46, #52;
AprilRobotics/apriltag#184). Hence one thread, pictures checked before every call, and one detector for the
life of a :class:`TagDetector`: make one per process and keep it.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from typing import Any, NamedTuple

import cv2
import numpy as np
import pyapriltags
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray
from revnm_server.frame import Frame, RobotSighting

Gray = NDArray[np.uint8]

_SMALLEST_PICTURE_PX = 32
_SMALL_TAG_PX = 24.0  # a smaller tag is looked for in a region enlarged twice
_LARGE_TAG_PX = 80.0  # a larger one is looked for at half resolution; its edges are refined at full
_REGION_SIDES = 2.0  # half the region's side, in sides of the tag, which moves 0.2 a picture at 0.5 m/s
_SMALLEST_REGION_PX = 40.0  # half the region's side at least
_LEAST_MARGIN = 15.0  # gray levels between bits and threshold; 14 px reach 50 with black on white
_SEARCH_INTERVAL = 5  # pictures between searches for lost robots while others are seen
# Two searches in turn. Measured at 1280 × 960, cluttered, one thread: decimation 2 takes 22 ms and needs
# 24 px (40 px where tilt halves the height), decimation 1 takes 116 ms and needs 14 px (20 px).
_SEARCH_DECIMATIONS = (2.0, 1.0)


class _Region(NamedTuple):
    """A part of a picture: its first pixel, how much it is enlarged, and the library's ``quad_decimate``."""

    gray: Gray
    left: int
    top: int
    scale: int
    decimation: float


class TagDetector:
    """Finds the configured robots in pictures of one camera; not for use by several threads.

    A robot that was seen is looked for around its last place first. Who is not there is looked for in the
    whole picture: every time while no robot is seen, else in every fifth picture.
    """

    def __init__(self, tag_ids: Mapping[int, str]) -> None:
        """Create the detector.

        Args:
            tag_ids: The robot's name by the id of its tag.
        """
        self._robots = dict(tag_ids)
        self._library = _Library()
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
        if min(frame.size_px) < _SMALLEST_PICTURE_PX:
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
            found |= self._sight(_region_around(gray, last.corners), {tag_id}, stamp_ns)
        return found

    def _search(self, gray: Gray, lost: Set[int], stamp_ns: int) -> dict[int, RobotSighting]:
        """Look for lost robots in the whole picture."""
        decimation = _SEARCH_DECIMATIONS[self._searches % len(_SEARCH_DECIMATIONS)]
        self._since_search = 0
        self._searches += 1
        return self._sight(_Region(gray, 0, 0, 1, decimation), lost, stamp_ns)

    def _sight(self, region: _Region, wanted: Set[int], stamp_ns: int) -> dict[int, RobotSighting]:
        detections = sorted(self._library.detect(region), key=lambda each: each.margin)
        return {  # of two with one id the clearer one stays
            each.tag_id: RobotSighting(self._robots[each.tag_id], stamp_ns, each.pixel, each.heading, each.corners)
            for each in detections
            if each.tag_id in wanted
        }


class _Detection(NamedTuple):
    tag_id: int
    margin: float
    pixel: FloatArray
    heading: FloatArray
    corners: FloatArray


class _Library:
    """The C library, with its input checked and its conventions turned into ours."""

    def __init__(self) -> None:
        self._detector: Any = pyapriltags.Detector(families="tag36h11", nthreads=1, quad_decimate=1.0)

    def detect(self, region: _Region) -> list[_Detection]:
        """Return what is certain: no corrected bit, a clear margin between ink and paper."""
        gray = np.ascontiguousarray(region.gray, dtype=np.uint8)
        if gray.ndim != 2 or min(gray.shape) < _SMALLEST_PICTURE_PX:
            return []
        self._detector.tag_detector_ptr.contents.quad_decimate = region.decimation
        return [
            _in_picture(raw, region)
            for raw in self._detector.detect(gray)
            if raw.hamming == 0 and raw.decision_margin >= _LEAST_MARGIN
        ]


def _in_picture(raw: Any, region: _Region) -> _Detection:
    """Turn a detection of a region into one of the picture.

    The library counts pixels from their outer edges, we from their centres: half a pixel less. Its tag frame
    is x right, y down on the upright tag, from −1 to 1; its corners run counter-clockwise from lower left.
    """
    offset = np.array([region.left, region.top]) - 0.5
    homography = np.asarray(raw.homography, dtype=np.float64)
    x, y, w = homography[:, 2]  # the tag's middle
    # Derivative of the projected middle along the tag's up, (0, −1).
    up = -(homography[:2, 1] - homography[2, 1] * np.array([x, y]) / w) / w
    return _Detection(
        tag_id=int(raw.tag_id),
        margin=float(raw.decision_margin),
        pixel=np.array([x, y]) / w / region.scale + offset,
        heading=np.asarray(up / np.linalg.norm(up)),
        corners=np.asarray(raw.corners, dtype=np.float64)[::-1] / region.scale + offset,
    )


def _region_around(gray: Gray, corners: FloatArray) -> _Region:
    """Cut a tag's surroundings out of the picture, enlarged if the tag is small; may be empty."""
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    reach = max(_REGION_SIDES * float(sides.max()), _SMALLEST_REGION_PX)
    middle = corners.mean(axis=0)
    height, width = gray.shape
    left, top = np.clip(middle - reach, 0, (width, height)).astype(int)
    right, bottom = np.clip(middle + reach + 1, 0, (width, height)).astype(int)
    part = gray[top:bottom, left:right]
    if part.size > 0 and sides.min() < _SMALL_TAG_PX:
        enlarged = cv2.resize(part, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
        return _Region(np.asarray(enlarged, dtype=np.uint8), int(left), int(top), 2, 1.0)
    decimation = 2.0 if sides.min() > _LARGE_TAG_PX else 1.0
    return _Region(part, int(left), int(top), 1, decimation)
