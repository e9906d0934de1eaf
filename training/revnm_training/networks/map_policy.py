"""The navigation policy over the lifted map: an ACT-style conditional VAE beside dense heads.

It corrects what a planner does with the same map. The planner's way comes in, and waypoints go out as that way plus a
learnt difference; two dense heads make every sample teach thousands of cells: what truly stands in each cell, seen or
hidden, and what the expert's way from there costs. The first of them also serves the planner, which else knows nothing
of floor that nobody has seen.

B batch, P points of the way, H waypoints, d channels, s side of the window, e side of the ego picture.
Sources: Zhao et al., 2023, arXiv:2304.13705 (ACT); Yonetani et al., 2021, arXiv:2009.07476 (a network that guides a
planner by dense costs).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from revnm_server.mapping.map_window import LAYERS, WAY_POINTS, WindowSpec
from revnm_server.observation import ObservationSpec
from revnm_training.networks.act import LatentEncoder
from revnm_training.networks.resnet import BasicBlock, ResNet, stages
from revnm_training.networks.transformer import DecoderLayer, EncoderLayer, sine_position_2d
from revnm_training.preset import MapPolicyConfig

_BLOB_M = 0.2
_GOAL_RANGE_M = 5.0
_STATE_TOKENS = 3


@dataclass(frozen=True, slots=True)
class MapPolicyOutput:
    """What the policy returns.

    Attributes:
        waypoints: (B, H, 2) metres, robot frame.
        occupied: (B, s, s) logits that something stands in a cell.
        cost: (B, s / 2, s / 2) cost of the way from a cell less that from the robot, in units of the range of labels.
        mean: (B, latent) of q(z | goal, w*); None without target waypoints.
        logvar: (B, latent) of the same.
    """

    waypoints: Tensor
    occupied: Tensor
    cost: Tensor
    mean: Tensor | None
    logvar: Tensor | None


class Dense(NamedTuple):
    """Targets of the dense heads: ``occupied`` (B, s, s) in {0, 1}; ``cost`` (B, s/2, s/2) and where it counts."""

    occupied: Tensor
    cost: Tensor
    reached: Tensor


class MapPolicy(nn.Module):
    """The map around the robot, the planner's way, the goal and the ego depth → H waypoints and what stands where."""

    def __init__(self, config: MapPolicyConfig, spec: ObservationSpec) -> None:
        super().__init__()
        self.config, self.waypoints = config, spec.waypoints
        d, window = config.width, WindowSpec()
        backbone = config.backbone
        self.stem = nn.Sequential(
            nn.Conv2d(len(LAYERS) + 2, backbone.width, 3, 2, 1, bias=False), nn.BatchNorm2d(backbone.width), nn.ReLU()
        )
        self.stages = stages(backbone)
        widths = [backbone.width * 2**i for i in range(len(backbone.blocks))]
        self.project = nn.Conv2d(widths[-1], d, 1)
        self.ego = ResNet(config.ego_backbone, 1)
        self.ego_project = nn.Conv2d(self.ego.out_channels, d, 1)
        self._register_grids(window, spec, d, strides=(2 ** len(widths), 2 ** (len(config.ego_backbone.blocks) + 1)))
        self.latent_encoder = LatentEncoder(config, spec.waypoints)
        self.latent = nn.Linear(config.latent, d)
        self.goal, self.way = nn.Linear(3, d), nn.Linear(2 * WAY_POINTS, d)
        self.state_position = nn.Parameter(torch.randn(_STATE_TOKENS, d) * 0.02)
        size = (d, config.heads, config.feedforward, config.dropout)
        self.encoder = nn.ModuleList(EncoderLayer(*size) for _ in range(config.encoder_layers))
        self.memory_norm = nn.LayerNorm(d)
        self.queries = nn.Parameter(torch.randn(spec.waypoints, d) * 0.02)
        self.decoder = nn.ModuleList(DecoderLayer(*size) for _ in range(config.decoder_layers))
        self.out_norm, self.out = nn.LayerNorm(d), nn.Linear(d, 2)
        nn.init.zeros_(self.out.weight)  # it begins as the planner
        nn.init.zeros_(self.out.bias)
        self.rise = nn.ModuleList(
            Rise(deep, flat) for deep, flat in zip([d, *widths[:0:-1]], widths[::-1], strict=True)
        )
        self.occupied = nn.Conv2d(widths[0], 4, 1)
        self.cost = nn.Conv2d(widths[0], 1, 1)

    def forward(
        self, window: Tensor, way: Tensor, goal: Tensor, ego: Tensor, actions: Tensor | None = None
    ) -> MapPolicyOutput:
        """Predict waypoints.

        Args:
            window: (B, 4, s, s) the map around the robot, in [0, 1]: :data:`revnm_server.mapping.map_window.LAYERS`.
            way: (B, P, 2) the planner's way, robot frame, metres, points as far apart as waypoints.
            goal: (B, 2) robot frame, metres.
            ego: (B, 1, e, e) ego depth in [−1, 1].
            actions: (B, H, 2) target waypoints, metres; given in training, when z is sampled from the CVAE
                encoder; without them z is the prior's mean.
        """
        mean = logvar = None
        z = goal.new_zeros(goal.shape[0], self.config.latent)
        if actions is not None:
            mean, logvar = self.latent_encoder(goal / _GOAL_RANGE_M, actions)
            z = mean + torch.exp(logvar / 2.0) * torch.randn_like(mean)
        levels = self._levels(torch.cat([window * 2.0 - 1.0, self._painted(way, goal)], dim=1))
        tokens = self.project(levels[-1])  # (B, d, s', s')
        state = torch.stack([self.latent(z), self.goal(_polar(goal)), self.way(way.flatten(1) / _GOAL_RANGE_M)], dim=1)
        ego_tokens = self.ego_project(self.ego(ego)).flatten(2).transpose(1, 2)
        memory = torch.cat([state, tokens.flatten(2).transpose(1, 2), ego_tokens], dim=1)
        position = torch.cat([self.state_position, self.get_buffer("map_grid"), self.get_buffer("ego_grid")])
        for layer in self.encoder:
            memory = layer(memory, position)
        memory = self.memory_norm(memory)
        x = torch.zeros_like(self.queries).expand(goal.shape[0], -1, -1)
        for layer in self.decoder:
            x = layer(x, self.queries, memory, position)
        waypoints = way[:, : self.waypoints] + self.out(self.out_norm(x))
        side = tokens.shape[-1]
        fused = memory[:, _STATE_TOKENS : _STATE_TOKENS + side * side].transpose(1, 2).unflatten(2, (side, side))
        occupied, cost = self._dense(fused, levels)
        return MapPolicyOutput(waypoints, occupied, cost, mean, logvar)

    def _register_grids(self, window: WindowSpec, spec: ObservationSpec, width: int, strides: tuple[int, int]) -> None:
        side, ego_side = -(-window.side // strides[0]), -(-spec.ego_px // strides[1])
        self.register_buffer("map_grid", sine_position_2d(side, side, width), persistent=False)
        self.register_buffer("ego_grid", sine_position_2d(ego_side, ego_side, width), persistent=False)
        along = (0.5 * (window.side - 1) - torch.arange(window.side)) * window.cell_m
        points = torch.stack(torch.meshgrid(along, along, indexing="ij"), dim=-1)
        self.register_buffer("points", points, persistent=False)  # (s, s, 2) metres, robot frame

    def _painted(self, way: Tensor, goal: Tensor) -> Tensor:
        """Return (B, 2, s, s): the way as a line of blobs, and how much nearer to the goal a cell is than the robot."""
        points = self.get_buffer("points")
        line = torch.exp(-_apart(points, way).amin(dim=1) / (2.0 * _BLOB_M**2))
        to_goal = _apart(points, goal[:, None])[:, 0].sqrt()
        nearer = goal.square().sum(-1).add(1e-6).sqrt()[:, None, None] - to_goal
        return torch.stack([line, nearer / _GOAL_RANGE_M], dim=1)

    def _levels(self, x: Tensor) -> list[Tensor]:
        x = self.stem(x)
        levels = []
        for stage in self.stages:
            x = stage(x)
            levels.append(x)
        return levels

    def _dense(self, fused: Tensor, levels: list[Tensor]) -> tuple[Tensor, Tensor]:
        x = fused
        for rise, level in zip(self.rise, reversed(levels), strict=True):
            x = rise(x, level)
        return functional.pixel_shuffle(self.occupied(x), 2)[:, 0], self.cost(x)[:, 0]


class Rise(nn.Module):
    """Brings deeper features up to a level of the encoder and joins both."""

    def __init__(self, deep: int, flat: int) -> None:
        super().__init__()
        self.narrow = nn.Conv2d(deep, flat, 1)
        self.block = BasicBlock(flat, flat, 1)

    def forward(self, deep: Tensor, level: Tensor) -> Tensor:
        """Join (B, deep, h', w') with (B, flat, h, w), h a multiple of h'."""
        factor = level.shape[-1] // deep.shape[-1]
        x = self.narrow(deep)
        if factor > 1:
            x = functional.interpolate(x, scale_factor=factor, mode="nearest")
        joined: Tensor = self.block(x + level)
        return joined


def _apart(points: Tensor, marks: Tensor) -> Tensor:
    """Return the squared distances (B, M, s, s) of points (s, s, 2) from marks (B, M, 2)."""
    flat = points.flatten(0, 1)
    product = marks @ flat.T  # (B, M, s · s): a difference would need as much memory for each of the axes
    apart = flat.square().sum(-1) + marks.square().sum(-1, keepdim=True) - 2.0 * product
    return apart.clamp(min=1e-6).unflatten(2, points.shape[:2])


def _polar(goal: Tensor) -> Tensor:
    """Return (B, 3): direction and distance of the goal."""
    distance = goal.square().sum(1, keepdim=True).add(1e-6).sqrt()
    return torch.cat([goal / distance, distance / _GOAL_RANGE_M], dim=1)


def map_policy_loss(
    output: MapPolicyOutput, target: Tensor, dense: Dense, config: MapPolicyConfig, *, kl_weight: float
) -> dict[str, Tensor]:
    """Return ``loss`` = L1 + β·KL (paper, eq. 3) + the dense heads' losses, and the parts.

    Args:
        output: Of the policy.
        target: (B, H, 2) waypoints, metres.
        dense: Of the dense heads.
        config: Their weights.
        kl_weight: β.
    """
    l1 = functional.l1_loss(output.waypoints, target)
    kl = l1.new_zeros(())
    if output.mean is not None and output.logvar is not None:
        kl = -0.5 * (1.0 + output.logvar - output.mean**2 - output.logvar.exp()).sum(dim=1).mean()
    occupied = functional.binary_cross_entropy_with_logits(output.occupied.float(), dense.occupied)
    cost = ((output.cost.float() - dense.cost).abs() * dense.reached).sum() / dense.reached.sum().clamp(min=1.0)
    total = l1 + kl_weight * kl + config.occupied_weight * occupied + config.cost_weight * cost
    return {"loss": total, "l1": l1, "kl": kl, "occupied": occupied, "cost": cost}
