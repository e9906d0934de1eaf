"""The controller: sample, roll out, criticise, average."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_client.messages import Velocity
from revnm_client.mppi.config import MppiConfig
from revnm_client.mppi.critics import align_cost, follow_cost, heading_cost, obstacle_cost, turning_cost
from revnm_client.mppi.distance_field import DistanceField
from revnm_client.mppi.reference_path import ReferencePath, path_ahead
from revnm_client.mppi.rollout import Rollouts, clearance, clearance_now, roll_out
from revnm_client.mppi.sampling import Sampler
from revnm_client.mppi.smoothing import savitzky_golay
from revnm_client.mppi.turning import TurnFirst

Array32 = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class MppiInput:
    """What the controller looks at in one tick, all in the robot frame now.

    Attributes:
        waypoints_m: (H, 2), H ≥ 1, the path to follow; what lies behind the robot's nearest point is ignored.
        points_m: (M, 2) obstacle points.
        velocity: Of the robot now.
        max_v_mps: No rollout goes faster, where this is less than the configured top speed.
    """

    waypoints_m: FloatArray
    points_m: FloatArray
    velocity: Velocity
    max_v_mps: float = math.inf


class Mppi:
    """Turns a path and obstacle points into a velocity; deterministic by seed.

    It keeps the last solution to start from: call it every ``config.period_s``, and :meth:`reset` it after a
    pause.
    """

    def __init__(self, config: MppiConfig, seed: int = 0) -> None:
        self._config = config
        self._sampler = Sampler(config, seed)
        self._smoother = savitzky_golay(config.steps)
        self._turn_first = TurnFirst(config)
        self._nominal = np.zeros((2, config.steps), dtype=np.float32)
        _keep_freed_memory()

    def reset(self) -> None:
        """Forget the last solution; the next one starts from standing still."""
        self._nominal[:] = 0.0
        self._turn_first.reset()

    def plan(self, state: MppiInput) -> Velocity:
        """Return the velocity for the next control period, within the limits even where the robot's own is not."""
        config, wanted = self._config, self._choose(state)
        return Velocity(
            min(max(wanted.v_mps, 0.0), config.max_v_mps),
            min(max(wanted.w_radps, -config.max_w_radps), config.max_w_radps),
        )

    def _choose(self, state: MppiInput) -> Velocity:
        """Return what can be reached from the present velocity in one step; only that bounds it."""
        config = self._config
        path = path_ahead(state.waypoints_m)
        field = DistanceField.from_points(
            state.points_m,
            half_m=config.field_half_m,
            resolution_m=config.field_resolution_m,
            reach_m=config.field_reach_m,
        )
        turn = self._turn_first.command(path, field, state.velocity)
        if turn is not None:
            self._nominal[:] = 0.0
            return turn
        self._shift()
        slower = config if state.max_v_mps >= config.max_v_mps else replace(config, max_v_mps=state.max_v_mps)
        rollouts = roll_out(*self._sampler.draw(self._nominal), state.velocity, slower)
        clear = clearance(rollouts, field, config.footprint)
        best, mean = self._average(rollouts, self._criticise(rollouts, clear, path, field))
        mean_rollout = roll_out(mean[:1], mean[1:], state.velocity, slower)
        worst = float(clearance(mean_rollout, field, config.footprint).min())
        # The mean of one way round an obstacle on the left and one on the right leads into it.
        if worst < min(0.0, float(clear[best].min())):
            self._nominal = np.stack([rollouts.v_mps[best], rollouts.w_radps[best]])
        else:
            self._nominal = np.concatenate([mean_rollout.v_mps, mean_rollout.w_radps])
        return Velocity(float(self._nominal[0, 0]), float(self._nominal[1, 0]))

    def _shift(self) -> None:
        """Move the last solution on by one control period."""
        part = np.float32(self._config.period_s / self._config.dt_s)
        self._nominal[:, :-1] += part * np.diff(self._nominal)

    def _criticise(self, rollouts: Rollouts, clear: Array32, path: ReferencePath, field: DistanceField) -> Array32:
        """Return the cost (K,) of each rollout."""
        config, weights = self._config, self._config.weights
        free = self._free(path, field)
        target = path.points_m[self._target(path, free)]
        cost = obstacle_cost(clear, clearance_now(field, config.footprint), weights)
        cost += follow_cost(rollouts, target, weights)
        cost += heading_cost(rollouts, target, weights)
        cost += turning_cost(rollouts, weights)
        near = path.index(config.horizon_m) + 1
        if free[:near].all():  # a path through obstacles shows the direction, but is not to be kept to
            cost += align_cost(rollouts, path.points_m[:near], weights)
        return cost

    def _free(self, path: ReferencePath, field: DistanceField) -> NDArray[np.bool_]:
        """Return (P,): whether the robot fits on each path point."""
        points = path.points_m.astype(np.float32)
        return field.at(points[:, 0], points[:, 1]) > np.float32(self._config.footprint.circle_radius_m)

    def _target(self, path: ReferencePath, free: NDArray[np.bool_]) -> int:
        """Return the index of the path point to make for: a horizon ahead, or the next free one after it."""
        reach = path.index(self._config.horizon_m)
        beyond = np.flatnonzero(free[reach:])
        return reach + int(beyond[0]) if len(beyond) else reach

    def _average(self, rollouts: Rollouts, cost: Array32) -> tuple[int, Array32]:
        """Return the index of the best sample, and the smoothed softmax average of all (2, T)."""
        best = int(np.argmin(cost))
        weight = np.exp((cost[best] - cost) / np.float32(self._config.temperature))
        weight /= weight.sum()
        mean = np.stack([weight @ rollouts.v_mps, weight @ rollouts.w_radps])
        return best, mean @ self._smoother.T


def _keep_freed_memory() -> None:
    """Make glibc's malloc reuse the arrays of a tick, where it would fetch them from the kernel every time.

    Page faults cost as much as the sums. To free one large block raises the sizes from which malloc maps memory
    and gives it back (mallopt(3), M_MMAP_THRESHOLD); other allocators do not mind. The block is never touched.
    """
    np.empty(1 << 24, dtype=np.uint8)
