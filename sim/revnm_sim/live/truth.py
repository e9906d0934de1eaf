"""What only a simulator knows, on a key of its own beside the robot's: for the demo's summary and for tests."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass

from revnm_client.keys import check_name


@dataclass(frozen=True, slots=True)
class Truth:
    """The exact state of the simulated robot, and what happened to it since the start.

    Attributes:
        x_m: Position, world frame.
        y_m: Position, world frame.
        yaw_rad: Heading, world frame.
        time_s: Simulated time since the start.
        path_m: Length of the path driven.
        closest_m: Least distance between body and obstacles, capped at the physics' ``CLEARANCE_LIMIT_M``.
        contact: Whether the body has touched an obstacle.
        rejected: Malformed velocity messages that were dropped.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    time_s: float
    path_m: float
    closest_m: float
    contact: bool
    rejected: int


def truth_key(robot: str) -> str:
    """Simulator → all: :class:`Truth` as JSON, 5 Hz."""
    return f"{check_name(robot)}/revnm/truth"


def encode_truth(truth: Truth) -> bytes:
    """Return the payload."""
    return json.dumps(dataclasses.asdict(truth)).encode()


def decode_truth(payload: bytes) -> Truth:
    """Return what our own simulator sent; the payload is trusted."""
    return Truth(**json.loads(payload))
