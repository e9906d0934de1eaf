"""Which tag library is used: the one that is asked for, or the better one that loads."""

from __future__ import annotations

import logging
from typing import Literal, NamedTuple

from revnm_client.errors import ConfigError
from revnm_server.tag.library import TagLibrary
from revnm_server.tag.opencv import OpenCvLibrary

logger = logging.getLogger(__name__)

LibraryName = Literal["apriltag", "opencv"]
LIBRARIES: tuple[LibraryName, ...] = ("apriltag", "opencv")


class OpenedLibrary(NamedTuple):
    """A library, and what an operator should know of how it came to be chosen."""

    library: TagLibrary
    note: str | None


def open_tag_library(name: LibraryName | Literal["auto"]) -> OpenedLibrary:
    """Return a tag library of the caller's own.

    ``auto`` takes OpenCV where the AprilTag library does not load, logs why and returns it as a note.

    Raises:
        ConfigError: ``apriltag`` is asked for and does not load.
    """
    if name == "opencv":
        return OpenedLibrary(OpenCvLibrary(), None)
    try:
        from revnm_server.tag.apriltag import AprilTagLibrary  # must not keep a server without it from starting

        return OpenedLibrary(AprilTagLibrary(), None)
    except (ImportError, OSError, AttributeError) as error:  # no package, no shared library, another one of its name
        reason = f"the AprilTag library does not load ({error})"
    if name == "apriltag":
        raise ConfigError(f"perception.tag_library apriltag: {reason}: install pyapriltags, or set auto or opencv")
    note = f"{reason}: tags are found by OpenCV, which takes three times as long"
    logger.warning(note)
    return OpenedLibrary(OpenCvLibrary(), note)
