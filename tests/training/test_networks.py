"""Networks: shapes, and the parts that training and run time must agree on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from revnm_server.observation import normalise_disparity
from revnm_server.stages.exo2ego import ddim_sample, ddim_schedule
from revnm_training.networks.act import ActPolicy, PolicyOutput, policy_loss
from revnm_training.networks.depth_net import DepthNet, depth_loss
from revnm_training.networks.dit import Denoiser, diffusion_loss
from revnm_training.networks.map_policy import Dense, MapPolicy, MapPolicyOutput, map_policy_loss
from revnm_training.networks.paint import aligned_goal, paint
from revnm_training.networks.transformer import Attention, attend
from revnm_training.preset import Preset, load_preset
from revnm_training.train_depth import normalised


@pytest.fixture
def edge() -> Preset:
    torch.manual_seed(0)
    return load_preset("edge")


@pytest.fixture
def picture() -> Preset:
    torch.manual_seed(0)
    return load_preset("picture")


def observation(preset: Preset, batch: int) -> tuple[torch.Tensor, ...]:
    spec = preset.observation
    exo = torch.rand(batch, spec.history, 1, *spec.exo_hw)
    ego = torch.rand(batch, spec.history, 1, spec.ego_px, spec.ego_px)
    return exo, ego, torch.rand(batch, 2), torch.tensor([[1.0, 0.0]]).repeat(batch, 1), torch.rand(batch, 2)


@pytest.mark.parametrize("history", [1, 3])
def test_policy_gives_waypoints_for_any_batch_and_history(picture: Preset, history: int) -> None:
    preset = dataclasses.replace(picture, observation=dataclasses.replace(picture.observation, history=history))
    policy = ActPolicy(preset.policy, preset.observation).eval()
    both = observation(preset, 2)
    output = policy(*both)
    assert output.waypoints.shape == (2, preset.observation.waypoints, 2)
    assert output.mean is None
    alone = policy(*(x[:1] for x in both))
    torch.testing.assert_close(alone.waypoints, output.waypoints[:1], atol=1e-5, rtol=1e-4)


def test_frames_of_the_history_are_told_apart(picture: Preset) -> None:
    preset = dataclasses.replace(picture, observation=dataclasses.replace(picture.observation, history=2))
    policy = ActPolicy(preset.policy, preset.observation).eval()
    exo, *rest = observation(preset, 1)
    swapped = policy(exo.flip(1), *rest).waypoints
    assert not torch.allclose(policy(exo, *rest).waypoints, swapped, atol=1e-5)


def test_the_decoder_returns_its_last_layer(picture: Preset) -> None:
    policy = ActPolicy(picture.policy, picture.observation).eval()
    inputs = observation(picture, 1)
    before = policy(*inputs).waypoints
    with torch.no_grad():
        policy.decoder[-1].feedforward[-1].bias.add_(torch.randn(picture.policy.width))
    assert not torch.allclose(policy(*inputs).waypoints, before, atol=1e-4)


def test_policy_loss_is_l1_plus_kl_by_hand() -> None:
    waypoints = torch.tensor([[[1.0, 0.0]]])
    target = torch.tensor([[[0.5, 0.5]]])
    output = PolicyOutput(waypoints, torch.tensor([[2.0]]), torch.zeros(1, 1))
    losses = policy_loss(output, target, kl_weight=0.1)
    assert losses["l1"].item() == pytest.approx(0.5)
    assert losses["kl"].item() == pytest.approx(2.0)  # −½ (1 + 0 − 2² − e⁰) = 2
    assert losses["loss"].item() == pytest.approx(0.7)


def test_attention_equals_torchs() -> None:
    q, k, v = (torch.randn(2, 3, length, 8) for length in (4, 5, 5))
    torch.testing.assert_close(attend(q, k, v), torch.nn.functional.scaled_dot_product_attention(q, k, v))
    assert Attention(8, 2)(torch.rand(1, 4, 8), torch.rand(1, 6, 8), torch.rand(1, 6, 8)).shape == (1, 4, 8)


def test_paint_marks_robot_goal_and_robot_aligned_axes() -> None:
    exo = torch.zeros(1, 1, 1, 30, 40)
    robot, goal = torch.tensor([[0.25, 0.5]]), torch.tensor([[0.75, 0.5]])
    up = torch.tensor([[0.0, -1.0]])
    picture = paint(exo, robot, up, goal)[0, 0]
    assert picture.shape == (6, 30, 40)
    peak = [divmod(int(channel.argmax()), 40) for channel in (picture[1], picture[2])]
    assert peak[0][1] in (9, 10)
    assert peak[1][1] in (29, 30)
    assert peak[0][0] in (14, 15)
    ahead, right = picture[3], picture[4]
    assert ahead[0, 10] > 0 > ahead[29, 10]  # the robot looks up: what is above it lies ahead
    assert right[15, 39] > 0 > right[15, 0]


def test_the_goal_turns_with_the_robot(edge: Preset) -> None:
    # The goal lies a quarter of the picture's width to the right of a robot that looks along +u: straight ahead.
    features = aligned_goal(
        torch.tensor([[0.5, 0.5]]), torch.tensor([[1.0, 0.0]]), torch.tensor([[0.75, 0.5]]), edge.observation
    )
    torch.testing.assert_close(features, torch.tensor([[0.75, 0.5, 0.25, 0.0, 0.25]]), atol=1e-4, rtol=0)


def test_an_untrained_denoiser_answers_zero_and_runs_in_the_servers_sampler(edge: Preset) -> None:
    spec = edge.observation
    denoiser = Denoiser(edge.exo2ego, spec).eval()
    crop = torch.rand(1, spec.history, spec.crop_px, spec.crop_px)
    pose, prior = torch.rand(1, 2), torch.rand(1, 2, spec.ego_px, spec.ego_px)

    def denoise(noisy: np.ndarray, step: int) -> np.ndarray:
        with torch.inference_mode():
            return denoiser(torch.from_numpy(noisy), crop, torch.tensor([step]), pose, pose, prior).numpy()

    noise = np.random.default_rng(0).standard_normal((1, 1, 32, 32), dtype=np.float32)
    np.testing.assert_array_equal(ddim_sample(denoise, noise, ddim_schedule(2)), np.zeros_like(noise))


def test_diffusion_loss_of_a_perfect_denoiser_is_zero() -> None:
    clean = torch.rand(4, 1, 32, 32)

    class Oracle(torch.nn.Module):
        def forward(self, **_: torch.Tensor) -> torch.Tensor:
            return clean

    for noise in (True, False):
        assert diffusion_loss(Oracle(), clean, {}, torch.Generator(), noise=noise)["loss"].item() == 0.0


def test_a_regression_sees_zeros_and_the_last_step() -> None:
    seen = {}

    class Spy(torch.nn.Module):
        def forward(self, **inputs: torch.Tensor) -> torch.Tensor:
            seen.update(inputs)
            return torch.zeros(4, 1, 8, 8)

    diffusion_loss(Spy(), torch.rand(4, 1, 8, 8), {"crop": torch.ones(4, 1, 8, 8)}, torch.Generator(), noise=False)
    assert not seen["noisy"].any()
    assert (seen["step"] == 999).all()
    assert set(seen) == {"noisy", "step", "crop"}


def test_depth_net_keeps_the_pictures_size(edge: Preset) -> None:
    assert edge.depth is not None
    network = DepthNet(edge.depth).eval()
    assert network(torch.rand(1, 3, 64, 96)).shape == (1, 64, 96)


def test_depth_loss_sees_values_and_edges_by_hand() -> None:
    target = torch.zeros(1, 8, 8)
    assert depth_loss(target + 0.25, target)["loss"].item() == pytest.approx(0.25)  # a constant has no edges
    assert depth_loss(target, target)["loss"].item() == 0.0


def test_disparity_is_normalised_on_the_device_as_on_the_server():
    disparity = np.random.default_rng(0).gamma(2.0, 0.2, (3, 20, 31)).astype(np.float32)
    expected = np.stack([normalise_disparity(each) for each in disparity])
    np.testing.assert_allclose(normalised(torch.from_numpy(disparity)).numpy(), expected, atol=1e-5)


def map_observation(preset: Preset, batch: int) -> tuple[torch.Tensor, ...]:
    side, ego = 96, preset.observation.ego_px
    window = torch.rand(batch, 4, side, side)
    return window, torch.randn(batch, 12, 2), 3.0 * torch.randn(batch, 2), torch.rand(batch, 1, ego, ego)


def test_the_map_policy_begins_as_the_planner(edge: Preset) -> None:
    assert edge.map_policy is not None
    policy = MapPolicy(edge.map_policy, edge.observation).eval()
    seen = map_observation(edge, 3)
    output = policy(*seen)
    torch.testing.assert_close(output.waypoints, seen[1][:, : edge.observation.waypoints])
    assert output.occupied.shape == (3, 96, 96)
    assert output.cost.shape == (3, 48, 48)
    alone = policy(*(x[:1] for x in seen))
    torch.testing.assert_close(alone.occupied, output.occupied[:1], atol=1e-4, rtol=1e-4)


def test_every_input_of_the_map_policy_counts(edge: Preset) -> None:
    assert edge.map_policy is not None
    policy = MapPolicy(edge.map_policy, edge.observation).eval()
    torch.nn.init.normal_(policy.out.weight)
    seen = map_observation(edge, 1)
    before = policy(*seen).waypoints - seen[1][:, :5]
    for number in range(len(seen)):
        changed = tuple(x + 0.5 if i == number else x for i, x in enumerate(seen))
        assert not torch.allclose(policy(*changed).waypoints - changed[1][:, :5], before, atol=1e-4)


def test_the_way_is_painted_where_it_lies(edge: Preset) -> None:
    assert edge.map_policy is not None
    policy = MapPolicy(edge.map_policy, edge.observation)
    way = torch.zeros(1, 12, 2)
    way[0, :, 0] = 2.05  # ahead
    line, nearer = policy._painted(way, torch.tensor([[0.0, 3.05]]))[0]
    assert divmod(int(line.argmax()), 96) in {(27, 47), (27, 48)}
    assert divmod(int(nearer.argmax()), 96) in {(47, 17), (48, 17)}  # the goal lies to the left


def test_map_policy_loss_by_hand(edge: Preset) -> None:
    assert edge.map_policy is not None
    output = MapPolicyOutput(torch.ones(1, 1, 2), torch.zeros(1, 2, 2), torch.full((1, 1, 2), 0.5), None, None)
    dense = Dense(torch.tensor([[[1.0, 0.0], [1.0, 0.0]]]), torch.zeros(1, 1, 2), torch.tensor([[[1.0, 0.0]]]))
    losses = map_policy_loss(output, torch.zeros(1, 1, 2), dense, edge.map_policy, kl_weight=1.0)
    assert losses["l1"].item() == pytest.approx(1.0)
    assert losses["occupied"].item() == pytest.approx(np.log(2.0))
    assert losses["cost"].item() == pytest.approx(0.5)  # the cell without a way does not count
    assert losses["loss"].item() == pytest.approx(1.0 + 2.0 * np.log(2.0) + 0.5 * 0.5)
