"""pytorch_mppi on the robot's problem: the same costs as the client's critics, and a controller that drives."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from revnm_client.messages import Velocity
from revnm_client.mppi import MppiConfig
from revnm_client.mppi.critics import align_cost, follow_cost, heading_cost, obstacle_cost, turning_cost
from revnm_client.mppi.distance_field import DistanceField
from revnm_client.mppi.reference_path import path_ahead
from revnm_client.mppi.rollout import clearance, clearance_now, roll_out
from revnm_client.mppi.sampling import Sampler
from revnm_client.speed import course
from revnm_training.torch_mppi import Scene, TorchMppi, rollout_cost, torch_mppi

CONFIG = MppiConfig(samples=200)


def test_a_rollout_costs_what_the_client_says() -> None:
    state = course.inputs(8, 0.4)[7]
    start, weights = state.velocity, CONFIG.weights
    rollouts = roll_out(*Sampler(CONFIG, 0).draw(np.zeros((2, 30), dtype=np.float32)), start, CONFIG)
    grid = {"half_m": CONFIG.field_half_m, "resolution_m": CONFIG.field_resolution_m, "reach_m": CONFIG.field_reach_m}
    field = DistanceField.from_points(state.points_m, **grid)
    path = path_ahead(state.waypoints_m)
    reach = path.index(CONFIG.horizon_m)
    expected = obstacle_cost(
        clearance(rollouts, field, CONFIG.footprint), clearance_now(field, CONFIG.footprint), weights
    )
    expected += follow_cost(rollouts, path.points_m[reach], weights) + turning_cost(rollouts, weights)
    expected += heading_cost(rollouts, path.points_m[reach], weights)
    expected += align_cost(rollouts, path.points_m[: reach + 1], weights)

    controls = torch.from_numpy(np.stack([rollouts.v_mps, rollouts.w_radps], axis=2))
    dynamics = TorchMppi(CONFIG, lambda *_, **__: None)._dynamics
    at = torch.tensor([0.0, 0.0, 0.0, start.v_mps, start.w_radps]).expand(200, 5)
    states = torch.stack([at := dynamics(at, controls[:, step]) for step in range(30)], dim=1)
    np.testing.assert_allclose(states[:, :, 0].numpy(), rollouts.x_m, atol=1e-5)
    found = rollout_cost(states, Scene.of(state, CONFIG), CONFIG).numpy()
    assert (expected > 100.0).any()  # some collide
    # A place on the border of two cells may fall into either: a few rollouts differ by a cell's distance in a step.
    assert (np.abs(found - expected) < 1e-3 * (1.0 + expected)).mean() > 0.95


def test_it_drives() -> None:
    pytest.importorskip("pytorch_mppi")
    torch.manual_seed(0)
    controller = torch_mppi(CONFIG)
    for state in course.inputs(10, 0.05):
        velocity = controller.plan(state)
    assert isinstance(velocity, Velocity)
    assert 0.1 < velocity.v_mps <= CONFIG.max_v_mps
    assert 0.0 < velocity.w_radps <= CONFIG.max_w_radps
