"""The unicycle with limited acceleration, for all samples at once.

Arrays are (K, T) as everywhere, but lie in memory step by step, since a rollout walks along the steps.
"""

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
    samples, steps = v_mps.shape
    dt = np.float32(config.dt_s)
    controls = np.empty((steps, 2, samples), dtype=np.float32)
    v, w = controls[:, 0], controls[:, 1]
    v_mps.T.clip(0.0, config.max_v_mps, out=v)
    w_radps.T.clip(-config.max_w_radps, config.max_w_radps, out=w)
    limit_rate(controls, start, config)
    yaw = w * dt
    half_turn = np.float32(0.5) * yaw
    _accumulate(yaw)
    yaw -= half_turn
    cos, sin = np.cos(yaw), np.sin(yaw)
    way = v * dt
    x, y = way * cos, way * sin
    _accumulate(x)
    _accumulate(y)
    return Rollouts(v.T, w.T, x.T, y.T, cos.T, sin.T)


def limit_rate(controls: Array32, start: Velocity, config: MppiConfig) -> None:
    """Bound the change from each step to the next, in place.

    Args:
        controls: (T, 2, K), speeds and turning rates.
        start: Velocity before the first step.
        config: Greatest accelerations and duration of a step.
    """
    before, change = np.empty((2, *controls.shape[1:]), dtype=np.float32)
    before[0], before[1] = start.v_mps, start.w_radps
    change[0], change[1] = config.max_a_mps2 * config.dt_s, config.max_alpha_radps2 * config.dt_s
    bound = np.empty_like(before)
    for now in controls:
        np.add(before, change, out=bound)
        np.minimum(now, bound, out=now)
        np.subtract(before, change, out=bound)
        np.maximum(now, bound, out=now)
        before = now


def _accumulate(steps: Array32) -> None:
    """Add to each step (T, K) all before it, in place; numpy's cumsum along the first axis is slow."""
    before = steps[0]
    for now in steps[1:]:
        np.add(before, now, out=now)
        before = now


def clearance(rollouts: Rollouts, field: DistanceField, footprint: Footprint) -> Array32:
    """Return (K, T), metres between the covering circles and the nearest obstacle; negative inside it."""
    nearest: Array32 | None = None
    for ahead_m in footprint.circles_x_m:
        x = np.float32(ahead_m) * rollouts.cos.T
        y = np.float32(ahead_m) * rollouts.sin.T
        x += rollouts.x_m.T
        y += rollouts.y_m.T
        distance = field.at(x, y)
        nearest = distance if nearest is None else np.minimum(nearest, distance, out=nearest)
    assert nearest is not None  # a footprint has circles
    nearest -= np.float32(footprint.circle_radius_m)
    return nearest.T


def clearance_now(field: DistanceField, footprint: Footprint) -> float:
    """Return the clearance of the robot where it stands, metres."""
    x = np.array(footprint.circles_x_m, dtype=np.float32)
    return float(field.at(x, np.zeros_like(x)).min()) - footprint.circle_radius_m
