"""OpenCV's aruco with the AprilTag library's search for quads: where pyapriltags does not load.

Plain aruco would find smaller tags, but its corners lie 0.65 px inside, which shows in every distance, and by its
minMarkerPerimeterRate, relative to the picture, a small noisy part is full of candidates: 160 × 160 px of noise took
it over a second, and this search for quads, which knows no such rate, 20 ms.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.tag.edges import refined_corners
from revnm_server.tag.family import CELLS, opencv_is_upside_down, upright_cells
from revnm_server.tag.library import Detection, Gray, Region, checked_gray, detection_in_picture

# A medium scene's tag of 16 px, enlarged twice, was found in 3 % of the pictures with OpenCV's 4 pixels a cell, a
# margin of 0.13 and no correction, in 28 % with 16 and 0.25, and in 52 % with two of 36 bits corrected besides.
_PIXELS_PER_CELL = 16
_MARGIN_OF_CELL = 0.25
_CORRECTED_BITS = 2
_BITS_OPENCV_CORRECTS = 5  # of this family; the rate is in units of it

_LEAST_MARGIN = 13.0  # gray levels

_SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], dtype=np.float32)


class OpenCvLibrary:
    """OpenCV's detector, with its conventions turned into ours."""

    name = "opencv"

    def __init__(self) -> None:
        self._parameters = cv2.aruco.DetectorParameters()
        self._parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
        self._parameters.perspectiveRemovePixelPerCell = _PIXELS_PER_CELL
        self._parameters.perspectiveRemoveIgnoredMarginPerCell = _MARGIN_OF_CELL
        self._parameters.errorCorrectionRate = (_CORRECTED_BITS + 0.5) / _BITS_OPENCV_CORRECTS
        family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        self._detector = cv2.aruco.ArucoDetector(family, self._parameters)
        self._first_corner = 2 if opencv_is_upside_down() else 0

    def detect(self, region: Region) -> list[Detection]:
        """Return what is certain: two corrected bits at most, a clear margin between ink and paper."""
        gray = checked_gray(region)
        if gray is None:
            return []
        self._parameters.aprilTagQuadDecimate = region.decimation
        self._detector.setDetectorParameters(self._parameters)
        corners, ids, _ = self._detector.detectMarkers(gray)
        found = [] if ids is None else zip(corners, np.ravel(ids).tolist(), strict=True)
        detections = (self._detection(region, gray, int(tag_id), np.asarray(each)) for each, tag_id in found)
        return [each for each in detections if each.margin >= _LEAST_MARGIN]

    def _detection(self, region: Region, gray: Gray, tag_id: int, corners: NDArray[np.float32]) -> Detection:
        rough = np.roll(corners.reshape(4, 2).astype(np.float64), -self._first_corner, axis=0) - 0.5
        from_front_left = refined_corners(gray, rough, reach_px=region.decimation + 1.0) + 0.5
        matrix = cv2.getPerspectiveTransform(_SQUARE, from_front_left.astype(np.float32))
        homography = np.asarray(matrix, dtype=np.float64)
        return detection_in_picture(
            region,
            tag_id=tag_id,
            margin=_margin(gray, tag_id, homography),
            homography=homography,
            corners=from_front_left,
        )


def _margin(gray: Gray, tag_id: int, homography: FloatArray) -> float:
    """Return half the difference between the tag's white and black cells, looked at in their middles."""
    places = (np.arange(CELLS) + 0.5) * (2.0 / CELLS) - 1.0
    x, y = np.meshgrid(places, places)
    u, v, w = np.einsum("ij,jkl->ikl", homography, np.stack([x, y, np.ones_like(x)]))
    columns, rows = (u / w - 0.5).astype(np.float32), (v / w - 0.5).astype(np.float32)
    levels = cv2.remap(gray, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    white = upright_cells(tag_id)
    return 0.5 * (float(levels[white].mean()) - float(levels[~white].mean()))
