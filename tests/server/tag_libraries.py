"""Both tag libraries, for tests that hold for either, and how long a first sighting may take."""

from __future__ import annotations

from revnm_server.frame import Frame, RobotSighting
from revnm_server.tag import TagDetector, open_tag_library
from revnm_server.tag.choice import LibraryName

CYCLE = 18  # at most so many pictures until every part of one of 640 × 480 was looked at in every way


def detector_with(name: LibraryName, tag_ids: dict[int, str]) -> TagDetector:
    return TagDetector(tag_ids, library=open_tag_library(name).library)


def first_sighting(detector: TagDetector, frame: Frame) -> RobotSighting:
    """Show a picture until a robot is seen in it."""
    for _ in range(CYCLE):
        for sighting in detector.sightings(frame):
            return sighting
    raise AssertionError(f"no robot seen in {CYCLE} pictures")
