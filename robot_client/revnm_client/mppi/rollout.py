"""The unicycle with limited acceleration, for all samples at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.messages import Velocity
from revnm_client.mppi.config import Footprint, MppiConfig
from revnm_client.mppi.distance_field import DistanceField

Array32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Rollouts:
    """Where the samples lead, each (K, T) float32, after each step, in the robot frame of the tick.

    Attributes:
        v_mps: Speed, within the limits.
        w_radps: Turning rate, within the limits.
        x_m: Forward.
        y_m: To the left.
        cos: Cosine of the heading in the middle of the step.
        sin: Its sine.
    """

    v_mps: Array32
    w_radps: Array32
    x_m: Array32
    y_m: Array32
    cos: Array32
    sin: Array32


def roll_out(v_mps: Array32, w_radps: Array32, start: Velocity, config: MppiConfig) -> Rollouts:
    """Drive the unicycle along every sample.

    Args:
        v_mps: (K, T) wanted speeds; untouched.
        w_radps: (K, T) wanted turning rates; untouched.
        start: Velocity of the robot now.
        config: Limits and step.
    """
    dt = np.float32(config.dt_s)
    v = np.clip(v_mps, 0.0, np.float32(config.max_v_mps))
    w = np.clip(w_radps, -np.float32(config.max_w_radps), np.float32(config.max_w_radps))
    limit_rate(v, start.v_mps, config.max_a_mps2 * config.dt_s)
    limit_rate(w, start.w_radps, config.max_alpha_radps2 * config.dt_s)
    yaw = np.cumsum(w, axis=1)
    yaw -= np.float32(0.5) * w
    yaw *= dt
    cos, sin = np.cos(yaw), np.sin(yaw)
    step = v * dt
    x = np.cumsum(step * cos, axis=1)
    y = np.cumsum(step * sin, axis=1)
    return Rollouts(v, w, x, y, cos, sin)


def limit_rate(values: Array32, start: float, step: float) -> None:
    """Bound the change from each step to the next, in place.

    Args:
        values: (K, T).
        start: Value before the first step.
        step: Largest change a step.
    """
    step32 = np.float32(step)
    before = np.full(values.shape[0], start, dtype=np.float32)
    bound = np.empty_like(before)
    for t in range(values.shape[1]):
        now = values[:, t]
        np.add(before, step32, out=bound)
        np.minimum(now, bound, out=now)
        np.subtract(before, step32, out=bound)
        np.maximum(now, bound, out=now)
        before = now


def clearance(rollouts: Rollouts, field: DistanceField, footprint: Footprint) -> Array32:
    """Return (K, T), metres between the covering circles and the nearest obstacle; negative inside it."""
    dx = np.float32(footprint.circle_offset_m) * rollouts.cos
    dy = np.float32(footprint.circle_offset_m) * rollouts.sin
    front = field.at(rollouts.x_m + dx, rollouts.y_m + dy)
    back = field.at(rollouts.x_m - dx, rollouts.y_m - dy)
    np.minimum(front, back, out=front)
    front -= np.float32(footprint.circle_radius_m)
    return front


def clearance_now(field: DistanceField, footprint: Footprint) -> float:
    """Return the clearance of the robot where it stands, metres."""
    x = np.array([footprint.circle_offset_m, -footprint.circle_offset_m], dtype=np.float32)
    return float(field.at(x, np.zeros_like(x)).min()) - footprint.circle_radius_m
