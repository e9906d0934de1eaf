"""Robot, heading and goal as pictures: the paper's poses, in the form that convolutions learn from fastest.

Linear tokens must learn where a coordinate lies in the picture; painted channels need not (Liu et al., 2018,
arXiv:1807.03247). Coordinates along and across the robot's heading tell every pixel where it lies as the robot
sees it, up to the unknown perspective. Part of the policy's graph, so the server still sends plain poses.
"""

from __future__ import annotations

import torch
from torch import Tensor

from revnm_server.observation import ObservationSpec

_BLOB = 0.03  # standard deviation of a painted point, fraction of the picture's width


def _relative(points: Tensor, robot: Tensor, heading: Tensor, ratio: float) -> tuple[Tensor, Tensor]:
    """Return how far normalised pixels (B, …, 2) lie ahead of and to the right of the robot, picture widths."""
    extra = points.ndim - robot.ndim
    shape = (robot.shape[0],) + (1,) * extra + (2,)
    offset = (points - robot.reshape(shape)) * points.new_tensor([1.0, ratio])
    hx, hy = heading[:, 0].reshape(shape[:-1]), heading[:, 1].reshape(shape[:-1])
    ahead = offset[..., 0] * hx + offset[..., 1] * hy
    right = offset[..., 1] * hx - offset[..., 0] * hy
    return ahead, right


def paint(exo: Tensor, robot: Tensor, heading: Tensor, goal: Tensor) -> Tensor:
    """Add to the exo disparity (B, N, 1, h, w) five channels: (B, N, 6, h, w).

    In order: disparity, blob at the robot, blob at the goal, ahead of the robot, right of the robot, row. Distances
    are in picture widths; the grid is taken as square pixels.
    """
    batch, frames, _, height, width = exo.shape
    rows = (torch.arange(height, device=exo.device, dtype=exo.dtype) + 0.5) / height
    columns = (torch.arange(width, device=exo.device, dtype=exo.dtype) + 0.5) / width
    grid = torch.stack([columns.expand(height, width), rows[:, None].expand(height, width)], dim=-1)
    grid = grid.expand(batch, -1, -1, -1)  # (B, h, w, 2)
    ratio = height / width
    ahead, right = _relative(grid, robot, heading, ratio)
    at_robot = torch.exp(-(ahead**2 + right**2) / (2.0 * _BLOB**2))
    along, across = _relative(grid, goal, heading, ratio)
    at_goal = torch.exp(-(along**2 + across**2) / (2.0 * _BLOB**2))
    painted = torch.stack([at_robot, at_goal, ahead, right, grid[..., 1]], dim=1)  # (B, 5, h, w)
    return torch.cat([exo, painted[:, None].expand(-1, frames, -1, -1, -1)], dim=2)


def aligned_goal(robot: Tensor, heading: Tensor, goal: Tensor, spec: ObservationSpec) -> Tensor:
    """Return (B, 5): goal pixel, how far it lies ahead of and right of the robot, and its distance."""
    ahead, right = _relative(goal, robot, heading, spec.exo_hw[0] / spec.exo_hw[1])
    distance = torch.sqrt(ahead**2 + right**2 + 1e-8)
    return torch.cat([goal, torch.stack([ahead, right, distance], dim=1)], dim=1)
