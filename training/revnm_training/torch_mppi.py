"""pytorch_mppi on the robot's problem: what ``revnm-robot bench`` compares the client's controller with.

The same unicycle within the same limits, the same distance field, the same critics; samples, rollout and average are
the library's own (github.com/UM-ARM-Lab/pytorch_mppi). ``revnm-robot bench`` finds this by its entry point.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from revnm_client.errors import ConfigError
from revnm_client.messages import Velocity
from revnm_client.mppi import MppiConfig, MppiInput
from revnm_client.mppi.distance_field import DistanceField
from revnm_client.mppi.reference_path import path_ahead
from revnm_client.mppi.rollout import clearance_now

_STRIDE = 3  # as the client's critics
_NEAR_M = 0.3
_NOISE_M = 0.01


def torch_mppi(config: MppiConfig) -> TorchMppi:
    """Build the controller.

    Raises:
        ConfigError: The library is not installed.
    """
    try:
        from pytorch_mppi import MPPI
    except ImportError as error:
        raise ConfigError(f"pytorch_mppi cannot be imported: expected pip install pytorch_mppi ({error})") from error
    return TorchMppi(config, MPPI)


@dataclass(frozen=True, slots=True)
class Scene:
    """What the critics look at in one tick, robot frame.

    Attributes:
        distance_m: (side, side), the distance field.
        now_m: Clearance where the robot stands.
        target_m: (2,), the path point to make for.
        align_m: (P, 2), the path to keep to; None where it leads through obstacles.
    """

    distance_m: Tensor
    now_m: float
    target_m: Tensor
    align_m: Tensor | None

    @classmethod
    def of(cls, state: MppiInput, config: MppiConfig) -> Scene:
        """Return the scene that the client's controller sees, too."""
        grid = {
            "half_m": config.field_half_m,
            "resolution_m": config.field_resolution_m,
            "reach_m": config.field_reach_m,
        }
        field, path = DistanceField.from_points(state.points_m, **grid), path_ahead(state.waypoints_m)
        free = field.at(*path.points_m.astype(np.float32).T) > config.footprint.circle_radius_m
        reach = path.index(config.horizon_m)
        beyond = np.flatnonzero(free[reach:])
        target = path.points_m[reach + int(beyond[0]) if len(beyond) else reach]
        align = _tensor(path.points_m[: reach + 1]) if free[: reach + 1].all() else None
        return cls(_tensor(field.distance_m), clearance_now(field, config.footprint), _tensor(target), align)


class TorchMppi:
    """A controller as :class:`revnm_client.mppi.Mppi` is."""

    def __init__(self, config: MppiConfig, library: Any) -> None:
        """Set the library up."""
        self._config = config
        self._scene: Scene  # of the tick under way
        top = torch.tensor([config.max_v_mps, config.max_w_radps])
        sigma = torch.tensor([config.sigma_v_mps, config.sigma_w_radps])
        self._controller = library(
            self._dynamics,
            lambda state, _: torch.zeros(len(state)),
            nx=5,
            noise_sigma=torch.diag(sigma**2),
            num_samples=config.samples,
            horizon=config.steps,
            terminal_state_cost=lambda states, _: rollout_cost(states[0], self._scene, config),
            lambda_=config.temperature,
            u_min=top * torch.tensor([0.0, -1.0]),
            u_max=top,
            U_init=torch.zeros(config.steps, 2),
        )

    @torch.inference_mode()
    def plan(self, state: MppiInput) -> Velocity:
        """Return the velocity for the next control period."""
        self._scene = Scene.of(state, self._config)
        now = torch.tensor([0.0, 0.0, 0.0, state.velocity.v_mps, state.velocity.w_radps])
        return Velocity(*self._controller.command(now).tolist())

    def _dynamics(self, state: Tensor, action: Tensor) -> Tensor:
        """Return (K, 5), x, y, yaw, v, w, one step later."""
        dt, before = self._config.dt_s, state[:, 3:]
        change = torch.tensor([self._config.max_a_mps2, self._config.max_alpha_radps2]) * dt
        v, w = torch.minimum(torch.maximum(action, before - change), before + change).T
        middle = state[:, 2] + 0.5 * dt * w
        x, y = state[:, 0] + dt * v * middle.cos(), state[:, 1] + dt * v * middle.sin()
        return torch.stack([x, y, state[:, 2] + dt * w, v, w], dim=1)


def rollout_cost(states: Tensor, scene: Scene, config: MppiConfig) -> Tensor:
    """Return the cost (K,) of rollouts (K, T, 5): the client's critics, all steps at once."""
    x, y, yaw, _, w = states.unbind(dim=2)
    middle, weights = yaw - 0.5 * config.dt_s * w, config.weights
    cos, sin = middle.cos(), middle.sin()
    clear = _clearance(x, y, cos, sin, scene, config)
    collides = clear.amin(dim=1) < min(0.0, scene.now_m) - _NOISE_M
    cost = weights.collision * collides
    cost = cost + weights.critical * (weights.critical_margin_m - clear).clamp_min(0.0).sum(dim=1)
    cost += weights.repulsion * (weights.repulsion_margin_m - clear).clamp_min(0.0).mean(dim=1)
    dx, dy = scene.target_m[0] - x, scene.target_m[1] - y
    distance = torch.hypot(dx, dy)
    cost += 0.5 * weights.follow * (distance[:, -1] + distance.mean(dim=1))
    some = slice(_STRIDE - 1, None, _STRIDE)
    ahead = dx[:, some] * cos[:, some] + dy[:, some] * sin[:, some]
    cost += weights.heading * ((distance[:, some] - ahead) / distance[:, some].clamp_min(_NEAR_M)).mean(dim=1)
    cost += weights.turning * w.square().mean(dim=1)
    if scene.align_m is not None:
        places = torch.stack([x[:, some], y[:, some]], dim=2)
        nearest = torch.cdist(places.reshape(-1, 2), scene.align_m).amin(dim=1)
        cost += weights.align * nearest.reshape(places.shape[:2]).mean(dim=1)
    return cost


def _clearance(x: Tensor, y: Tensor, cos: Tensor, sin: Tensor, scene: Scene, config: MppiConfig) -> Tensor:
    """Return (K, T), metres between the covering circles and the nearest obstacle."""
    circles = config.footprint.circles_x_m
    nearest = [_look_up(x + ahead * cos, y + ahead * sin, scene, config) for ahead in circles]
    return torch.stack(nearest).amin(dim=0) - config.footprint.circle_radius_m


def _look_up(x: Tensor, y: Tensor, scene: Scene, config: MppiConfig) -> Tensor:
    side = scene.distance_m.shape[0]
    row, column = (((at + config.field_half_m) / config.field_resolution_m).clamp(0, side - 1).int() for at in (x, y))
    return scene.distance_m.flatten()[row * side + column]


def _tensor(array: np.ndarray[Any, Any]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
