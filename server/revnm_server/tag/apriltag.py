"""The AprilTag library (pyapriltags), the better of the two; the only module that imports it.

It is C behind ctypes and dies on bad input: an empty picture kills the process (SIGFPE), and detectors crashed when
destroyed or used from several threads (pupil-labs/apriltags#34, #46, #52; AprilRobotics/apriltag#184). Hence one
thread a detector, pictures checked before every call, and one detector for the life of an :class:`AprilTagLibrary`:
make one per camera and keep it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyapriltags

from revnm_server.tag.family import FAMILY
from revnm_server.tag.library import Detection, Region, checked_gray, detection_in_picture

# The library's own default. pyapriltags 3.4.3 rounds what it is given to an integer, so that nothing is sharpened:
# a medium scene's tag of 16 px was found in 21 % of the pictures, sharpened in 52 %.
_SHARPENING = 0.25
_LEAST_MARGIN = 25.0  # gray levels, which sharpening about doubles: as many as OpenCV's 13


class AprilTagLibrary:
    """The C library, with its input checked and its conventions turned into ours."""

    name = "apriltag"

    def __init__(self) -> None:
        detector: Any = pyapriltags.Detector(families=FAMILY, nthreads=1, quad_decimate=1.0)
        self._detector = detector
        self._options = detector.tag_detector_ptr.contents
        self._options.decode_sharpening = _SHARPENING

    def detect(self, region: Region) -> list[Detection]:
        """Return what is certain: no corrected bit, a clear margin between ink and paper."""
        gray = checked_gray(region)
        if gray is None:
            return []
        self._options.quad_decimate = region.decimation
        return [
            detection_in_picture(
                region,
                tag_id=int(raw.tag_id),
                margin=float(raw.decision_margin),
                # From −1 to 1, x right, y down on the upright tag.
                homography=np.asarray(raw.homography, dtype=np.float64),
                corners=np.asarray(raw.corners, dtype=np.float64)[::-1],  # counter-clockwise from lower left
            )
            for raw in self._detector.detect(gray)
            if raw.hamming == 0 and raw.decision_margin >= _LEAST_MARGIN
        ]
