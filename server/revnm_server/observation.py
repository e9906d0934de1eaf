"""What the networks see: the same code builds training samples and run-time input.

Symbols: N frames of history, R robots, H waypoints. Imports numpy and OpenCV only: training runs this on
machines that have nothing else. Normalised pixels are (u / width, v / height), so the picture spans [0, 1]².
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray

Image32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ObservationSpec:
    """Shapes and ranges of the observation; part of a model bundle, so that server and training agree.

    Attributes:
        history: N, frames of history that the networks see.
        history_interval_s: Time between two frames of the history.
        disparity_hw: Height and width of the depth network's output.
        exo_hw: Height and width of the exo disparity that the policy sees.
        crop_px: Side of the crop around the robot, pixels of the crop.
        crop_span: Side of the crop as a fraction of the picture's width.
        crop_heading_up: Turn the crop so that the robot's heading points up; else it stays upright.
        ego_px: Side of the ego depth image.
        ego_hfov_rad: Horizontal field of view of the ego camera.
        ego_height_m: Height of the ego camera over the floor.
        ego_range_m: Depth that is mapped to +1; farther is clipped.
        waypoints: H, waypoints in a plan.
        spacing_m: Path length between two waypoints; the last ones repeat the goal where it is nearer.
    """

    history: int
    history_interval_s: float
    disparity_hw: tuple[int, int]
    exo_hw: tuple[int, int]
    crop_px: int
    crop_span: float
    crop_heading_up: bool
    ego_px: int
    ego_hfov_rad: float
    ego_height_m: float
    ego_range_m: float
    waypoints: int
    spacing_m: float


@dataclass(frozen=True, slots=True)
class ImagePose:
    """Robot pose in the picture, as the networks see it (paper, section III-B).

    Attributes:
        p_rob: (2,) tag centre, normalised pixel.
        q_rel: (2,) unit vector of the robot's forward axis in the picture, pixels, u right, v down.
    """

    p_rob: FloatArray
    q_rel: FloatArray


def normalise_pixel(pixel: FloatArray, size_px: tuple[int, int]) -> FloatArray:
    """Divide pixels (..., 2) by the picture's width and height."""
    return np.asarray(pixel / np.array(size_px, dtype=np.float64))


def normalise_disparity(disparity: Image32) -> Image32:
    """Map a picture's disparity (h, w) to [0, 1] between its 2nd and 98th percentile.

    Affine-invariant: depth networks give disparity up to an unknown scale and shift.
    """
    low, high = np.percentile(disparity, (2.0, 98.0))
    span = max(float(high - low), 1e-6)
    return np.asarray(np.clip((disparity - low) / span, 0.0, 1.0), dtype=np.float32)


def exo_view(disparity: Image32, spec: ObservationSpec) -> Image32:
    """Resize the normalised disparity to the size (h, w) that the policy sees."""
    height, width = spec.exo_hw
    return np.asarray(cv2.resize(disparity, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def crop_around(disparity: Image32, pose: ImagePose, aspect: float, spec: ObservationSpec) -> Image32:
    """Cut the robot's surroundings out of the normalised disparity (paper, Fig. 2 b).

    Args:
        disparity: (h, w) in [0, 1], a picture of any aspect squeezed into the disparity grid.
        pose: Where to cut and, if the spec says so, which way is up.
        aspect: Width over height of the camera's picture, to undo the squeezing.
        spec: Side and span of the crop.

    Returns:
        (crop_px, crop_px) float32 in [0, 1], the robot in the middle; outside the picture it is 0.
    """
    height, width = disparity.shape
    scale = spec.crop_span / spec.crop_px  # picture widths per crop pixel
    forward = pose.q_rel if spec.crop_heading_up else np.array([0.0, -1.0])
    right = np.array([-forward[1], forward[0]])
    # Crop pixel (x, y) -> picture, in units of its width: p + scale * (x * right - y * forward).
    to_grid = np.array([float(width), aspect * height])
    centre = pose.p_rob * np.array([width, height]) - 0.5
    linear = scale * np.stack([right, -forward], axis=1) * to_grid[:, None]
    middle = (spec.crop_px - 1) / 2.0
    matrix = np.column_stack([linear, centre - linear @ np.array([middle, middle])])
    crop = cv2.warpAffine(
        disparity,
        matrix,
        (spec.crop_px, spec.crop_px),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=0.0,
    )
    return np.asarray(crop, dtype=np.float32)


def exo_views(disparities: Image32, spec: ObservationSpec) -> Image32:
    """Apply :func:`exo_view` to a history (N, ·, ·): (N, h, w)."""
    return np.stack([exo_view(disparity, spec) for disparity in disparities])


def crops_around(disparities: Image32, pose: ImagePose, aspect: float, spec: ObservationSpec) -> Image32:
    """Apply :func:`crop_around` to a history (N, ·, ·), always around the newest pose: (N, crop_px, crop_px).

    The camera stands still, so a fixed window shows what moves; the paper does not say which pose it uses.
    """
    return np.stack([crop_around(disparity, pose, aspect, spec) for disparity in disparities])


def normalise_ego_depth(depth_m: Image32, spec: ObservationSpec) -> Image32:
    """Map ego depth in metres to [−1, 1]; what is farther than ``ego_range_m``, inf included, becomes 1."""
    return np.asarray(np.clip(depth_m / spec.ego_range_m, 0.0, 1.0) * 2.0 - 1.0, dtype=np.float32)
