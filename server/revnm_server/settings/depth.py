"""Settings of a depth network that takes the place of the bundle's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

import pydantic

from revnm_server.networks.depth_input import MAX_SIDE_PX, Mode, Range
from revnm_server.networks.depth_output import Kind
from revnm_server.networks.manifest import FileName, PerChannel, Sha256
from revnm_server.settings.section import Section

_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_STD = (0.229, 0.224, 0.225)

_Side = Annotated[int, pydantic.Field(ge=1, le=MAX_SIDE_PX)]
_Positive = Annotated[float, pydantic.Field(gt=0.0, le=1000.0)]


class DepthInputSettings(Section):
    """What the network takes; its rank and its type of numbers are read from the model.

    ``name`` ``auto`` is its only input. ``size`` is a length or ``[height, width]``, and may be left out where the
    model fixes it. ``mode``: ``fixed`` squeezes the picture into the size, ``letterbox`` keeps its shape and adds a
    border, ``longest`` and ``shortest`` give that side of the picture the length ``size``. ``mean`` and ``std`` are
    ImageNet's for the range ``unit``, and 0 and 1 for ``byte``, where they are not given.
    """

    name: str = "auto"
    size: _Side | tuple[_Side, _Side] | None = None
    mode: Mode = "fixed"
    multiple_of: Annotated[int, pydantic.Field(ge=1, le=256)] = 1
    range: Range = "unit"
    mean: PerChannel | None = None
    std: tuple[_Positive, _Positive, _Positive] | None = None

    @property
    def mean_std(self) -> tuple[PerChannel, PerChannel]:
        """Mean and standard deviation, per channel, as set or as usual for the range."""
        usual = (_IMAGENET_MEAN, _IMAGENET_STD) if self.range == "unit" else ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
        return self.mean or usual[0], self.std or usual[1]

    @pydantic.model_validator(mode="after")
    def _whole(self) -> Self:
        free = self.mode in ("longest", "shortest")
        if free and not isinstance(self.size, int):
            raise ValueError(f"size: expected one length, that of the {self.mode} side")
        sides = () if self.size is None else (self.size,) if isinstance(self.size, int) else self.size
        if any(side % self.multiple_of for side in sides):
            raise ValueError(f"size: expected multiples of {self.multiple_of} (multiple_of), got {self.size}")
        return self


class DepthOutputSettings(Section):
    """What the network gives: the name of its image of depth or disparity, and of its sky, if it has one.

    ``auto`` is its only output, or the one that is named ``depth``, ``predicted_depth``, ``disparity`` or
    ``metric_depth``.
    """

    depth: str = "auto"
    sky: str | None = None


class DepthSettings(Section):
    """A depth network from a file, with the file's sha256; without ``model``, the bundle's own is used.

    ``data`` holds the sha256 of each file beside the model that it reads its weights from. ``kind`` is what the network
    says: ``disparity``, larger where things are nearer; ``depth``, larger where they are farther; ``metric_canonical``,
    metres of a camera with another focal length.
    """

    model: Path | None = None
    sha256: Sha256 | None = None
    data: dict[FileName, Sha256] = pydantic.Field(default_factory=dict)
    kind: Kind | None = None
    input: DepthInputSettings = DepthInputSettings()
    outputs: DepthOutputSettings = DepthOutputSettings()

    @pydantic.model_validator(mode="after")
    def _complete(self) -> Self:
        if self.model is None and self.model_fields_set - {"model"}:
            raise ValueError("model: expected the path of the network that the other settings are for")
        if self.model is not None and self.sha256 is None:
            raise ValueError("sha256: expected the sum of the model's file, which its publisher tells")
        if self.model is not None and self.kind is None:
            raise ValueError("kind: expected disparity, depth or metric_canonical; its publisher tells")
        return self
