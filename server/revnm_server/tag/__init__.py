"""Finds robots by the AprilTags (36h11) on their backs, with either of two libraries, and prints such tags.

A printed tag's upper edge, as in AprilRobotics/apriltag-imgs, lies at the robot's front: pictures of tags come from
:mod:`revnm_server.tag.family`, which knows which way up a library has them.
"""

from revnm_server.tag.choice import OpenedLibrary, open_tag_library
from revnm_server.tag.detector import TagDetector
from revnm_server.tag.library import TagLibrary

__all__ = ["OpenedLibrary", "TagDetector", "TagLibrary", "open_tag_library"]
