"""Where depth images of episodes are cast: on the CPU, or on a graphics card."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from revnm_server.observation import Image32
from revnm_sim.camera import Camera
from revnm_sim.rays.raycast import cast_depths
from revnm_sim.world import PrimitiveArrays

RenderDevice = Literal["cpu", "cuda"]
DepthCaster = Callable[[PrimitiveArrays, Sequence[Camera], tuple[int, int]], Image32]
"""World, B cameras and (h, w) → depths (B, h, w), metres; inf for sky."""


def depth_caster(device: RenderDevice) -> DepthCaster:
    """Return the ray caster of a device; the graphics card's driver is loaded only where it is asked for.

    Raises:
        ConfigError: There is no such device; told when the caster is first called.
    """
    if device == "cpu":
        return cast_depths
    from revnm_sim.rays.cuda_raycast import cast_depths_cuda

    return cast_depths_cuda
