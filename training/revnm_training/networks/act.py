"""The navigation policy: an ACT-style conditional VAE over waypoint chunks (paper, section III-C and Fig. 2 a).

B batch, N frames of history, H waypoints, d channels. Two facts that cost others dearly are heeded: the output is
that of the *last* decoder layer (the original ACT code takes the first), and every frame and view has its own
learned embedding, without which five frames cannot be told apart.
Source: Zhao et al., 2023, arXiv:2304.13705.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from revnm_server.observation import ObservationSpec
from revnm_training.networks.paint import aligned_goal, paint
from revnm_training.networks.resnet import ResNet
from revnm_training.networks.transformer import DecoderLayer, EncoderLayer, sine_position_2d
from revnm_training.preset import MapPolicyConfig, PolicyConfig

PAINTED_CHANNELS = 6
ALIGNED_GOAL_FEATURES = 5


@dataclass(frozen=True, slots=True)
class PolicyOutput:
    """What the policy returns.

    Attributes:
        waypoints: (B, H, 2) metres, robot frame.
        mean: (B, latent) of q(z | p_rob, w*); None without target waypoints.
        logvar: (B, latent) of the same.
    """

    waypoints: Tensor
    mean: Tensor | None
    logvar: Tensor | None


class ViewEncoder(nn.Module):
    """Depth images of one view → tokens with positions and frame embeddings."""

    def __init__(self, trunk: ResNet, image_hw: tuple[int, int], frames: int, width: int) -> None:
        super().__init__()
        self.trunk = trunk
        self.project = nn.Conv2d(trunk.out_channels, width, 1)
        self.frame_embedding = nn.Parameter(torch.randn(frames, 1, width) * 0.02)
        stride = 2 ** (len(trunk.stages) + 1)
        rows, columns = (-(-side // stride) for side in image_hw)
        self.register_buffer("grid", sine_position_2d(rows, columns, width), persistent=False)

    def features(self, images: Tensor) -> Tensor:
        """Encode images (K, c, h, w), each by itself, into (K, tokens, d)."""
        return self.project(self.trunk(images)).flatten(2).transpose(1, 2)

    def tokens(self, features: Tensor) -> Tensor:
        """Mark the features (B, N, tokens, d) of a history with their frames: (B, N · tokens, d)."""
        return (features + self.frame_embedding).flatten(1, 2)

    def positions(self) -> Tensor:
        """Return the positions (N · tokens, d) of the tokens."""
        return self.get_buffer("grid").repeat(self.frame_embedding.shape[0], 1)


class LatentEncoder(nn.Module):
    """The CVAE encoder q(z | p_rob, w*); used in training only."""

    def __init__(self, config: PolicyConfig | MapPolicyConfig, waypoints: int) -> None:
        super().__init__()
        d = config.width
        self.cls = nn.Parameter(torch.randn(1, 1, d) * 0.02)
        self.robot = nn.Linear(2, d)
        self.action = nn.Linear(2, d)
        self.position = nn.Parameter(torch.randn(2 + waypoints, d) * 0.02)
        self.layers = nn.ModuleList(
            EncoderLayer(d, config.heads, config.feedforward, config.dropout) for _ in range(config.vae_layers)
        )
        self.norm = nn.LayerNorm(d)
        self.out = nn.Linear(d, 2 * config.latent)

    def forward(self, robot: Tensor, actions: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and log-variance (B, latent) for p_rob (B, 2) and waypoints (B, H, 2)."""
        cls = self.cls.expand(robot.shape[0], -1, -1)
        x = torch.cat([cls, self.robot(robot)[:, None], self.action(actions)], dim=1)  # (B, 2 + H, d)
        for layer in self.layers:
            x = layer(x, self.position)
        mean, logvar = self.out(self.norm(x[:, 0])).chunk(2, dim=1)
        return mean, logvar


class ActPolicy(nn.Module):
    """Depth images, robot pixel, heading and goal pixel → H waypoints."""

    def __init__(self, config: PolicyConfig, spec: ObservationSpec) -> None:
        super().__init__()
        self.config, self.spec = config, spec
        d = config.width
        exo_trunk = ResNet(config.exo_backbone, PAINTED_CHANNELS if config.robot_aligned else 1)
        ego_trunk = ResNet(config.ego_backbone, 1) if config.ego_backbone else exo_trunk
        self.exo = ViewEncoder(exo_trunk, spec.exo_hw, spec.history, d)
        self.ego = ViewEncoder(ego_trunk, (config.ego_px, config.ego_px), spec.history, d)
        if config.ego_backbone is None:
            self.ego.project = self.exo.project  # one encoder for both views, as in ACT and in the paper
        self.robot, self.heading = nn.Linear(2, d), nn.Linear(2, d)
        self.goal = nn.Linear(ALIGNED_GOAL_FEATURES if config.robot_aligned else 2, d)
        self.latent = nn.Linear(config.latent, d)
        self.latent_encoder = LatentEncoder(config, spec.waypoints)
        self.state_position = nn.Parameter(torch.randn(4, d) * 0.02)
        self.queries = nn.Parameter(torch.randn(spec.waypoints, d) * 0.02)
        size = (d, config.heads, config.feedforward, config.dropout)
        self.encoder = nn.ModuleList(EncoderLayer(*size) for _ in range(config.encoder_layers))
        self.memory_norm = nn.LayerNorm(d)
        self.decoder = nn.ModuleList(DecoderLayer(*size) for _ in range(config.decoder_layers))
        self.out_norm = nn.LayerNorm(d)
        self.out = nn.Linear(d, 2)

    def forward(
        self,
        exo: Tensor,
        ego: Tensor,
        robot: Tensor,
        heading: Tensor,
        goal: Tensor,
        actions: Tensor | None = None,
    ) -> PolicyOutput:
        """Predict waypoints.

        Args:
            exo: (B, N, 1, h, w) normalised exo disparity in [0, 1].
            ego: (B, N, 1, e, e) ego depth in [−1, 1].
            robot: (B, 2) normalised pixel of the robot.
            heading: (B, 2) unit vector of its forward axis in the picture.
            goal: (B, 2) normalised pixel of the goal.
            actions: (B, H, 2) target waypoints, metres; given in training, when z is sampled from the CVAE
                encoder; without them z is the prior's mean.
        """
        mean = logvar = z = None
        if actions is not None:
            mean, logvar = self.latent_encoder(robot, actions)
            z = mean + torch.exp(logvar / 2.0) * torch.randn_like(mean)
        if self.config.robot_aligned:
            exo = paint(exo, robot, heading, goal)
        exo = _each(self.exo.features, exo)  # (B, N, tokens, d)
        ego = _each(self.ego.features, _each(self._enlarged, ego))
        return PolicyOutput(self.decide(exo, ego, robot, heading, goal, z), mean, logvar)

    @property
    def encodes_alone(self) -> bool:
        """Whether an image's features depend on that image alone, and one encoder makes those of both views."""
        config, side = self.config, self.config.ego_px
        return not config.robot_aligned and config.ego_backbone is None and self.spec.exo_hw == (side, side)

    def decide(
        self, exo: Tensor, ego: Tensor, robot: Tensor, heading: Tensor, goal: Tensor, z: Tensor | None = None
    ) -> Tensor:
        """Return waypoints (B, H, 2) from what :meth:`ViewEncoder.features` made of the images.

        Args:
            exo: (B, N, tokens, d).
            ego: (B, N, tokens, d).
            robot: As of :meth:`forward`, like ``heading`` and ``goal``.
            heading: See there.
            goal: See there.
            z: (B, latent); None for the prior's mean.
        """
        if z is None:
            z = robot.new_zeros(robot.shape[0], self.config.latent)
        memory, position = self._fuse(exo, ego, self._state_tokens(z, robot, heading, goal))
        x = torch.zeros_like(self.queries).expand(robot.shape[0], -1, -1)
        for layer in self.decoder:
            x = layer(x, self.queries, memory, position)
        return self.out(self.out_norm(x))

    def _state_tokens(self, z: Tensor, robot: Tensor, heading: Tensor, goal: Tensor) -> Tensor:
        """Return the tokens (B, 4, d) of z, robot, heading and goal."""
        goal_features = aligned_goal(robot, heading, goal, self.spec) if self.config.robot_aligned else goal
        tokens = [self.latent(z), self.robot(robot), self.heading(heading), self.goal(goal_features)]
        return torch.stack(tokens, dim=1)

    def _enlarged(self, ego: Tensor) -> Tensor:
        side = self.config.ego_px
        if ego.shape[-1] == side:
            return ego
        return functional.interpolate(ego, (side, side), mode="bilinear", align_corners=False)

    def _fuse(self, exo: Tensor, ego: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """Fuse features and state tokens into the memory (B, L, d); return it with its positions (L, d)."""
        memory = torch.cat([state, self.exo.tokens(exo), self.ego.tokens(ego)], dim=1)
        position = torch.cat([self.state_position, self.exo.positions(), self.ego.positions()])
        for layer in self.encoder:
            memory = layer(memory, position)
        return self.memory_norm(memory), position


def _each(change: Callable[[Tensor], Tensor], histories: Tensor) -> Tensor:
    """Apply a function of images (K, …) to the images of histories (B, N, …)."""
    return change(histories.flatten(0, 1)).unflatten(0, (-1, histories.shape[1]))


def policy_loss(output: PolicyOutput, target: Tensor, *, kl_weight: float) -> dict[str, Tensor]:
    """Return ``loss`` = L1 + β·KL (paper, eq. 3) and its parts ``l1`` and ``kl``.

    L1 is the mean over batch, waypoints and coordinates, metres; KL is summed over z and averaged over the batch.
    """
    l1 = functional.l1_loss(output.waypoints, target)
    kl = l1.new_zeros(())
    if output.mean is not None and output.logvar is not None:
        kl = -0.5 * (1.0 + output.logvar - output.mean**2 - output.logvar.exp()).sum(dim=1).mean()
    return {"loss": l1 + kl_weight * kl, "l1": l1, "kl": kl}
