"""What a camera gives and what is seen in it: the inputs of the pipeline.

Imports numpy only, so that training and the simulator can use it anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray


@dataclass(frozen=True, slots=True)
class Frame:
    """One decoded picture.

    Attributes:
        image: (H, W, 3) uint8, RGB.
        stamp_ns: Capture time, nanoseconds since the epoch, server's clock.
        seq: Counts up; two frames with one number are the same frame.
        jpeg: The picture as the camera sent it, where that was a JPEG.
    """

    image: NDArray[np.uint8]
    stamp_ns: int
    seq: int
    jpeg: bytes | None = None

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.image.shape[1], self.image.shape[0]


@dataclass(frozen=True, slots=True)
class RobotSighting:
    """Where a robot is in a picture, from the tag on its back. No metric quantity: the camera is uncalibrated.

    Attributes:
        robot: The robot's name.
        stamp_ns: Capture time of the picture in which the robot was seen last, nanoseconds, server's clock.
        pixel: (2,) the tag's centre (u, v), pixels, u right, v down, pixel centres at integers.
        heading: (2,) unit vector along which the tag's centre moves in the picture when the robot drives
            forward, (u, v) pixels.
        corners: (4, 2) the tag's black border: front left, front right, rear right, rear left as the robot
            sees itself, pixels.
    """

    robot: str
    stamp_ns: int
    pixel: FloatArray
    heading: FloatArray
    corners: FloatArray

    @property
    def side_px(self) -> float:
        """The shortest side of the tag's black border, pixels."""
        return float(np.linalg.norm(self.corners - np.roll(self.corners, 1, axis=0), axis=1).min())
