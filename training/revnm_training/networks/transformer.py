"""Transformer layers as ACT uses them: positions are added to queries and keys in every layer, never to values.

Pre-norm, unlike ACT's default: trained from scratch it is the more stable of the two. B batch, L tokens, d channels.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn


def attend(query: Tensor, key: Tensor, value: Tensor) -> Tensor:
    """Scaled dot-product attention of (…, Lq, c) to (…, Lk, c).

    Written out: at these lengths PyTorch's fused CPU kernel takes several times as long in the backward pass.
    """
    weights = (query @ key.transpose(-2, -1) / math.sqrt(query.shape[-1])).softmax(dim=-1)
    return weights @ value


class Attention(nn.Module):
    """Multi-head attention with separate positions for queries and keys."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        self.out = nn.Linear(width, width)

    def forward(self, query: Tensor, key: Tensor, value: Tensor) -> Tensor:
        """Attend from (B, Lq, d) to (B, Lk, d)."""
        q, k, v = (self._split(x) for x in (self.query(query), self.key(key), self.value(value)))
        mixed = attend(q, k, v)  # (B, heads, Lq, d / heads)
        return self.out(mixed.transpose(1, 2).flatten(2))  # (B, Lq, d)

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(2, (self.heads, -1)).transpose(1, 2)


class FeedForward(nn.Sequential):
    """Linear, ReLU, dropout, linear."""

    def __init__(self, width: int, hidden: int, dropout: float) -> None:
        super().__init__(nn.Linear(width, hidden), nn.ReLU(), nn.Dropout(dropout), nn.Linear(hidden, width))


class EncoderLayer(nn.Module):
    """Self-attention and feed-forward."""

    def __init__(self, width: int, heads: int, feedforward: int, dropout: float) -> None:
        super().__init__()
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention = Attention(width, heads)
        self.feedforward = FeedForward(width, feedforward, dropout)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, position: Tensor) -> Tensor:
        """Map tokens (B, L, d) with positions (L, d)."""
        y = self.norm1(x)
        x = x + self.dropout(self.attention(y + position, y + position, y))
        return x + self.dropout(self.feedforward(self.norm2(x)))


class DecoderLayer(nn.Module):
    """Self-attention, cross-attention to the memory, feed-forward."""

    def __init__(self, width: int, heads: int, feedforward: int, dropout: float) -> None:
        super().__init__()
        self.norm1, self.norm2, self.norm3 = nn.LayerNorm(width), nn.LayerNorm(width), nn.LayerNorm(width)
        self.self_attention = Attention(width, heads)
        self.cross_attention = Attention(width, heads)
        self.feedforward = FeedForward(width, feedforward, dropout)
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, queries: Tensor, memory: Tensor, position: Tensor) -> Tensor:
        """Map tokens (B, H, d) with query positions (H, d), given memory (B, L, d) with positions (L, d)."""
        y = self.norm1(x)
        x = x + self.dropout(self.self_attention(y + queries, y + queries, y))
        y = self.norm2(x)
        x = x + self.dropout(self.cross_attention(y + queries, memory + position, memory))
        return x + self.dropout(self.feedforward(self.norm3(x)))


def sine_position_2d(height: int, width: int, channels: int) -> Tensor:
    """Return DETR's sine positions (height · width, channels), rows first, normalised to 2π.

    Source: Carion et al., 2020, arXiv:2005.12872, as used by ACT (temperature 10 000).
    """
    half = channels // 2
    frequency = 10000.0 ** (torch.arange(0, half, 2).float() / half)

    def encode(count: int) -> Tensor:
        angle = (torch.arange(1, count + 1).float() / count * 2.0 * math.pi)[:, None] / frequency
        return torch.stack([angle.sin(), angle.cos()], dim=2).flatten(1)  # (count, half)

    rows, columns = encode(height), encode(width)
    grid = torch.cat([rows[:, None].expand(-1, width, -1), columns[None].expand(height, -1, -1)], dim=2)
    return grid.flatten(0, 1)
