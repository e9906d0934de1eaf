"""Keeps what was learnt of a camera on disk, one JSON file for each, written whole or not at all."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from revnm_client.errors import FileError
from revnm_client.geometry import FloatArray
from revnm_server.calibration.adjustment import Belief
from revnm_server.floor_camera import PARAMETERS

_FORMAT = "revnm camera calibration 1"
_KEYS = {"format", "camera", "width_px", "height_px", "mean", "covariance"}
_PLAUSIBLE = (np.array([-2.5, -0.3, -0.8, math.log(0.3), -1.0]), np.array([1.5, 1.58, 0.8, math.log(30.0), 1.0]))


def save_belief(path: Path, camera: str, size_px: tuple[int, int], belief: Belief) -> None:
    """Write a calibration.

    Args:
        path: The file.
        camera: Name of the camera.
        size_px: Width and height of its picture.
        belief: What is known of it.

    Raises:
        FileError: The file cannot be written; an older one is as it was.
    """
    content = {
        "format": _FORMAT,
        "camera": camera,
        "width_px": size_px[0],
        "height_px": size_px[1],
        "mean": belief.mean.tolist(),
        "covariance": belief.covariance.tolist(),
    }
    try:
        write_whole(path, json.dumps(content, indent=1) + "\n")
    except OSError as error:
        raise FileError(f"calibration {path}: {error}") from error


def write_whole(path: Path, text: str) -> None:
    """Write a file, in a folder that is made when it is needed; it appears whole or not at all.

    Raises:
        OSError: It cannot be written; an older one is as it was.
    """
    fresh = path.with_name(path.name + ".new")
    path.parent.mkdir(parents=True, exist_ok=True)
    fresh.write_text(text)
    fresh.replace(path)


def load_belief(path: Path, camera: str, size_px: tuple[int, int]) -> Belief | None:
    """Read a calibration.

    Returns:
        What was kept; None if there is no such file.

    Raises:
        FileError: The file is damaged, or of another camera or resolution.
    """
    try:
        content: Any = json.loads(path.read_text())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise FileError(f"calibration {path}: {error}") from error
    if not isinstance(content, dict) or set(content) != _KEYS or content["format"] != _FORMAT:
        raise FileError(f"calibration {path}: expected {_FORMAT!r} with the keys {', '.join(sorted(_KEYS))}")
    if content["camera"] != camera:
        raise FileError(f"calibration {path}: is of camera {content['camera']!r}, expected {camera!r}")
    size = (content["width_px"], content["height_px"])
    if size != size_px:
        raise FileError(
            f"calibration {path}: is of pictures {size[0]} × {size[1]}, expected {size_px[0]} × {size_px[1]}"
        )
    mean = _array(path, "mean", content["mean"], (PARAMETERS,))
    covariance = _array(path, "covariance", content["covariance"], (PARAMETERS, PARAMETERS))
    _check(path, mean, covariance)
    return Belief(mean, covariance)


def _array(path: Path, key: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FileError(f"calibration {path}: {key}: {error}") from error
    if array.shape != shape or not np.isfinite(array).all():
        raise FileError(f"calibration {path}: {key}: expected finite numbers of shape {shape}, got {array.shape}")
    return array


def _check(path: Path, mean: FloatArray, covariance: FloatArray) -> None:
    low, high = _PLAUSIBLE
    if not ((mean >= low) & (mean <= high)).all():
        raise FileError(f"calibration {path}: mean: expected values between {low.tolist()} and {high.tolist()}")
    if not np.allclose(covariance, covariance.T) or np.linalg.eigvalsh(covariance).min() <= 0.0:
        raise FileError(f"calibration {path}: covariance: expected a symmetric, positive definite matrix")
