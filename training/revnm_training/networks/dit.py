"""exo2ego: a diffusion transformer that imagines the robot's depth picture (paper, section III-D and Fig. 2 b).

B batch, N frames of history, c side of the crop, e side of the ego picture. It predicts the clean picture (x0).
Source of the architecture: Peebles & Xie, 2023, arXiv:2212.09748 (adaLN-Zero, sine positions, zero-initialised
output).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional

from revnm_server.mapping.ego_prior import PRIOR_CHANNELS
from revnm_server.observation import ObservationSpec
from revnm_server.stages.exo2ego import DIFFUSION_STEPS, cosine_alpha_bar
from revnm_training.networks.transformer import attend, sine_position_2d
from revnm_training.preset import Exo2EgoConfig

_FREQUENCIES = 256
_LEAST_DEVIATION = 0.02


class Embedder(nn.Sequential):
    """Two-layer MLP into the conditioning space."""

    def __init__(self, features: int, width: int) -> None:
        super().__init__(nn.Linear(features, width), nn.SiLU(), nn.Linear(width, width))


class Block(nn.Module):
    """Self-attention and MLP, both shifted, scaled and gated by the condition (adaLN-Zero)."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1 = nn.LayerNorm(width, elementwise_affine=False, eps=1e-6)
        self.norm2 = nn.LayerNorm(width, elementwise_affine=False, eps=1e-6)
        self.qkv = nn.Linear(width, 3 * width)
        self.attention_out = nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 4 * width), nn.GELU(approximate="tanh"), nn.Linear(4 * width, width))
        self.modulation = nn.Sequential(nn.SiLU(), nn.Linear(width, 6 * width))
        _zero(self.modulation[1])

    def forward(self, x: Tensor, condition: Tensor) -> Tensor:
        """Map tokens (B, L, d) under the condition (B, d)."""
        shift1, scale1, gate1, shift2, scale2, gate2 = self.modulation(condition)[:, None].chunk(6, dim=2)
        x = x + gate1 * self._attend(self.norm1(x) * (1.0 + scale1) + shift1)
        return x + gate2 * self.mlp(self.norm2(x) * (1.0 + scale2) + shift2)

    def _attend(self, x: Tensor) -> Tensor:
        q, k, v = self.qkv(x).unflatten(2, (3, self.heads, -1)).permute(2, 0, 3, 1, 4).unbind(0)
        return self.attention_out(attend(q, k, v).transpose(1, 2).flatten(2))


class Denoiser(nn.Module):
    """Noisy ego depth, crops around the robot, step and pose → clean ego depth."""

    def __init__(self, config: Exo2EgoConfig, spec: ObservationSpec) -> None:
        super().__init__()
        self.patch, self.side, d = config.patch, spec.ego_px, config.width
        self.shuffle = spec.crop_px // spec.ego_px
        channels = 1 + spec.history * self.shuffle**2 + (PRIOR_CHANNELS if config.prior else 0)
        self.embed = nn.Conv2d(channels, d, config.patch, config.patch)
        tokens = spec.ego_px // config.patch
        self.register_buffer("position", sine_position_2d(tokens, tokens, d), persistent=False)
        self.step = Embedder(_FREQUENCIES, d)
        self.robot, self.heading = Embedder(2, d), Embedder(2, d)
        self.blocks = nn.ModuleList(Block(d, config.heads) for _ in range(config.depth))
        self.norm = nn.LayerNorm(d, elementwise_affine=False, eps=1e-6)
        self.modulation = nn.Sequential(nn.SiLU(), nn.Linear(d, 2 * d))
        self.out = nn.Linear(d, config.patch**2)
        _zero(self.modulation[1])
        _zero(self.out)

    def forward(
        self, noisy: Tensor, crop: Tensor, step: Tensor, robot: Tensor, heading: Tensor, prior: Tensor | None = None
    ) -> Tensor:
        """Predict the clean picture.

        Args:
            noisy: (B, 1, e, e) noisy ego depth.
            crop: (B, N, c, c) crops of the exo disparity in [0, 1], c a multiple of e.
            step: (B,) diffusion step, 0 to 999.
            robot: (B, 2) normalised pixel of the robot.
            heading: (B, 2) unit vector of its forward axis in the picture.
            prior: (B, 2, e, e) the exo depth reprojected into the robot's view and where it is known, of
                :func:`revnm_server.mapping.ego_prior.ego_prior`; given exactly if the network was built for it.

        Returns:
            (B, 1, e, e) clean ego depth in [−1, 1].
        """
        seen = [noisy, functional.pixel_unshuffle(_standardise(crop), self.shuffle)]
        x = torch.cat(seen if prior is None else [*seen, prior], dim=1)
        x = self.embed(x).flatten(2).transpose(1, 2) + self.position  # (B, L, d)
        condition = self.step(_step_features(step).to(x.dtype)) + self.robot(robot) + self.heading(heading)
        for block in self.blocks:
            x = block(x, condition)
        shift, scale = self.modulation(condition)[:, None].chunk(2, dim=2)
        x = self.out(self.norm(x) * (1.0 + scale) + shift)  # (B, L, patch²)
        side = self.side // self.patch
        return functional.pixel_shuffle(x.transpose(1, 2).unflatten(2, (side, side)), self.patch)


def _standardise(crop: Tensor) -> Tensor:
    """Give each crop mean 0 and deviation 1: far from the camera, floor and obstacles differ little in disparity."""
    mean = crop.mean(dim=(1, 2, 3), keepdim=True)
    deviation = (crop - mean).square().mean(dim=(1, 2, 3), keepdim=True).sqrt()
    return (crop - mean) / (deviation + _LEAST_DEVIATION)


def _zero(layer: nn.Module) -> None:
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)


def _step_features(step: Tensor) -> Tensor:
    """Return the sine features (B, 256) of diffusion steps (B,)."""
    half = _FREQUENCIES // 2
    frequency = torch.exp(-math.log(10000.0) * torch.arange(half, device=step.device).float() / half)
    angle = step.float()[:, None] * frequency
    return torch.cat([angle.cos(), angle.sin()], dim=1)


def diffusion_loss(
    model: nn.Module, clean: Tensor, condition: Mapping[str, Tensor], generator: torch.Generator, *, noise: bool
) -> dict[str, Tensor]:
    """Return ``loss``, the pixel-wise MSE of the predicted clean picture (paper, section III-E b).

    Half of the batch is at the last step, pure noise, so that one network serves one step as well as many (the
    single-step recipe of Lotus, arXiv:2409.18124); the rest is uniform over the steps.

    Args:
        model: A :class:`Denoiser`.
        clean: (B, 1, e, e) true ego depth in [−1, 1].
        condition: ``crop``, ``robot``, ``heading`` and perhaps ``prior`` of :meth:`Denoiser.forward`.
        generator: Source of steps and noise.
        noise: Diffuse; else the network gets zeros and the last step, and regresses.
    """
    batch = clean.shape[0]
    step = torch.randint(DIFFUSION_STEPS, (batch,), generator=generator, device=clean.device)
    drawn = torch.randn(clean.shape, generator=generator, dtype=clean.dtype, device=clean.device)
    step[: batch // 2 if noise else batch] = DIFFUSION_STEPS - 1
    signal = torch.as_tensor(cosine_alpha_bar(), dtype=clean.dtype, device=clean.device)[step][:, None, None, None]
    noisy = signal.sqrt() * clean + (1.0 - signal).sqrt() * drawn if noise else torch.zeros_like(clean)
    return {"loss": functional.mse_loss(model(noisy=noisy, step=step, **condition), clean)}
