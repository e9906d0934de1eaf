"""ResNet trunks of basic blocks (He et al., 2016, doi:10.1109/CVPR.2016.90), any width and depth.

``width=64, blocks=(3, 4, 6, 3)`` is ResNet-34 without its classifier. Batch normalisation is trained: no pretrained
weights are at hand, and a frozen one would be an untrained one.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from revnm_training.preset import BackboneConfig


class BasicBlock(nn.Module):
    """Two 3×3 convolutions beside a shortcut; (B, c_in, h, w) → (B, c_out, h / stride, w / stride)."""

    def __init__(self, c_in: int, c_out: int, stride: int) -> None:
        super().__init__()
        self.stride = stride
        self.conv1 = nn.Conv2d(c_in, c_out, 3, stride, 1, bias=False)
        self.norm1 = nn.BatchNorm2d(c_out)
        self.conv2 = nn.Conv2d(c_out, c_out, 3, 1, 1, bias=False)
        self.norm2 = nn.BatchNorm2d(c_out)
        self.shortcut: nn.Module = nn.Identity()
        if stride != 1 or c_in != c_out:
            self.shortcut = nn.Sequential(nn.Conv2d(c_in, c_out, 1, bias=False), nn.BatchNorm2d(c_out))

    def forward(self, x: Tensor) -> Tensor:
        """Apply the block."""
        y = torch.relu(self.norm1(self.conv1(x)))
        y = self.norm2(self.conv2(y))
        # Not a convolution with a stride: with AVX-512, the backward pass of narrow ones in oneDNN 3.12 leaves its
        # arrays.
        return torch.relu(y + self.shortcut(x[..., :: self.stride, :: self.stride]))


class Stem(nn.Module):
    """7×7 convolution of stride 2; (B, c, h, w) → (B, width, h / 2, w / 2)."""

    def __init__(self, channels: int, width: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, width, 7, 2, 3, bias=False)
        self.norm = nn.BatchNorm2d(width)

    def forward(self, x: Tensor) -> Tensor:
        """Apply the stem."""
        return torch.relu(self.norm(self.conv(x)))


def stages(config: BackboneConfig) -> nn.ModuleList:
    """Return the stages: channels ``width · 2^i``, the grid halved by all but the first."""
    built = nn.ModuleList()
    c_in = config.width
    for index, count in enumerate(config.blocks):
        c_out = config.width * 2**index
        strides = [1 if index == 0 else 2] + [1] * (count - 1)
        built.append(nn.Sequential(*(BasicBlock(c_in if i == 0 else c_out, c_out, s) for i, s in enumerate(strides))))
        c_in = c_out
    return built


class ResNet(nn.Module):
    """Stem, max pool and stages; (B, channels, h, w) → (B, out_channels, h / 2^(S+1), w / 2^(S+1)) for S stages."""

    def __init__(self, config: BackboneConfig, channels: int) -> None:
        super().__init__()
        self.stem = Stem(channels, config.width)
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.stages = stages(config)
        self.out_channels = config.width * 2 ** (len(config.blocks) - 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return the features of the last stage."""
        x = self.pool(self.stem(x))
        for stage in self.stages:
            x = stage(x)
        return x
