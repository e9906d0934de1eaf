"""A small monocular depth network, so that everything runs with nothing to download.

A ResNet encoder and a light decoder with skip connections. It predicts the disparity already normalised per picture
to [0, 1] (:func:`revnm_server.observation.normalise_disparity`), the form in which everything after it sees depth.
"""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional

from revnm_training.networks.resnet import Stem, stages
from revnm_training.preset import DepthConfig


class Merge(nn.Module):
    """Enlarge the coarse features, add the projected fine ones, mix."""

    def __init__(self, coarse: int, fine: int) -> None:
        super().__init__()
        self.coarse = nn.Conv2d(coarse, fine, 1)
        self.mix = nn.Sequential(nn.Conv2d(fine, fine, 3, 1, 1, bias=False), nn.BatchNorm2d(fine), nn.ReLU())

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """Return features of the shape of ``fine``."""
        up = functional.interpolate(self.coarse(coarse), size=fine.shape[-2:], mode="bilinear", align_corners=False)
        return self.mix(up + fine)


class DepthNet(nn.Module):
    """RGB (B, 3, h, w), normalised → disparity (B, h, w); h and w are multiples of 2^(stages + 1)."""

    def __init__(self, config: DepthConfig) -> None:
        super().__init__()
        width = config.backbone.width
        self.stem = Stem(3, width)
        self.pool = nn.MaxPool2d(3, 2, 1)
        self.stages = stages(config.backbone)
        channels = [width, *(width * 2**i for i in range(len(config.backbone.blocks)))]
        pairs = list(zip(channels[1:], channels[:-1], strict=True))
        self.merges = nn.ModuleList(Merge(coarse, fine) for coarse, fine in reversed(pairs))
        self.head = nn.Conv2d(width, 1, 3, 1, 1)

    def forward(self, image: Tensor) -> Tensor:
        """Predict the normalised disparity."""
        skips = [self.stem(image)]
        x = self.pool(skips[0])
        for stage in self.stages:
            x = stage(x)
            skips.append(x)
        x = skips.pop()
        for merge in self.merges:
            x = merge(x, skips.pop())
        full = functional.interpolate(self.head(x), size=image.shape[-2:], mode="bilinear", align_corners=False)
        return full[:, 0]


def depth_loss(predicted: Tensor, target: Tensor) -> dict[str, Tensor]:
    """Return ``loss``: L1 of the disparity plus L1 of its gradients at three scales, for (B, h, w) in [0, 1].

    The gradient term keeps edges, which is where obstacles end. Source of the idea: Li & Snavely, 2018,
    arXiv:1804.00607.
    """
    l1 = functional.l1_loss(predicted, target)
    gradient = l1.new_zeros(())
    error = predicted - target
    for stride in (1, 2, 4):
        e = error[:, ::stride, ::stride]
        gradient = gradient + e.diff(dim=1).abs().mean() + e.diff(dim=2).abs().mean()
    return {"loss": l1 + 0.5 * gradient, "l1": l1, "gradient": gradient.detach()}
