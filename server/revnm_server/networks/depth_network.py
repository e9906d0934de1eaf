"""A depth network with what it takes and gives: one way to run all of them, the bundle's own included."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError
from revnm_server.networks.depth_input import DepthInput, batch, place
from revnm_server.networks.depth_output import DepthOutput, as_image, disparity_from_depth, without_border
from revnm_server.networks.inference import OnnxModel
from revnm_server.observation import Image32


@dataclass(frozen=True, slots=True)
class Seen:
    """What a network says of a picture, without the border of its input.

    Attributes:
        image: (h, w) depth or disparity, in the network's own numbers.
        sky: (h, w) its sky, if it has one.
    """

    image: Image32
    sky: Image32 | None = None


@dataclass(frozen=True, slots=True)
class DepthNetwork:
    """A loaded depth network.

    Attributes:
        model: Runs it.
        takes: What it takes.
        gives: What it gives.
    """

    model: OnnxModel
    takes: DepthInput
    gives: DepthOutput

    def disparity(self, image: NDArray[np.uint8]) -> Image32:
        """Return the disparity of a picture, of the size that the network has for it, up to scale and shift.

        Args:
            image: (h, w, 3) RGB, of any size.

        Raises:
            ContractError: The network gave something else than one image, or values that are not finite or no depth.
        """
        return self.meant(self.look(image))

    def look(self, image: NDArray[np.uint8]) -> Seen:
        """Return what the network itself says of a picture.

        Args:
            image: (h, w, 3) RGB, of any size.

        Raises:
            ContractError: It cannot run, or gave something else than one image.
        """
        placement = place((image.shape[0], image.shape[1]), self.takes)
        names = [self.gives.name] if self.gives.sky is None else [self.gives.name, self.gives.sky]
        arrays = self.model.compute(names, {self.takes.name: batch(image, placement, self.takes)})
        images = [
            without_border(as_image(f"{self.model.path}: output {name}", arrays[name]), placement) for name in names
        ]
        return Seen(*images)

    def meant(self, seen: Seen) -> Image32:
        """Return the disparity that is meant by what the network says.

        Raises:
            ContractError: Its values are not finite or no depth.
        """
        where = f"{self.model.path}: output {self.gives.name}"
        if self.gives.kind == "disparity":
            if not np.isfinite(seen.image).all():
                raise ContractError(f"{where} is not finite")
            return seen.image
        if seen.sky is not None and seen.sky.shape != seen.image.shape:
            raise ContractError(f"{where}: shape {seen.image.shape}, but that of the sky is {seen.sky.shape}")
        try:
            return disparity_from_depth(seen.image, seen.sky)
        except ContractError as error:
            raise ContractError(f"{where}: {error}") from error
