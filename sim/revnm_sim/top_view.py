"""Draws a world from above."""

from __future__ import annotations

import math

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Patch, Rectangle

from revnm_sim.world import FLAT_M, Primitive, Shape, World

_DRIVEN_UNDER_M = 0.40
_BRIGHT_M = 2.5  # from this height on colours are as they are
_DARKEST = 0.55
_HANGING_ALPHA = 0.45


def draw_top_view(axes: Axes, world: World) -> None:
    """Draw bounds, floor and primitives of a world into axes in metres, x to the right and y up.

    Primitives have their colours, the lower the darker; what hangs, so that a robot passes under it, is translucent.
    """
    low_x, low_y, high_x, high_y = world.bounds
    floor = _shade(world.floor_colour, 1.0)
    axes.add_patch(Rectangle((low_x, low_y), high_x - low_x, high_y - low_y, facecolor=floor, edgecolor="black"))
    for primitive in sorted(world.primitives, key=lambda p: p.top_m):
        axes.add_patch(_footprint(primitive))
    axes.set_aspect("equal")
    axes.set_xlim(low_x - 0.4, high_x + 0.4)
    axes.set_ylim(low_y - 0.4, high_y + 0.4)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _footprint(primitive: Primitive) -> Patch:
    x, y, _ = primitive.centre_m
    length, width, _ = primitive.size_m
    flat = primitive.top_m <= FLAT_M
    brightness = 1.0 if flat else _DARKEST + (1.0 - _DARKEST) * min(primitive.top_m / _BRIGHT_M, 1.0)
    face = _shade(primitive.colour, brightness)
    alpha = _HANGING_ALPHA if primitive.bottom_m >= _DRIVEN_UNDER_M else 1.0
    line = 0.0 if flat else 0.4
    if primitive.shape is Shape.CYLINDER:
        return Circle((x, y), length / 2.0, facecolor=face, alpha=alpha, edgecolor="black", linewidth=line)
    corner = (x - length / 2.0, y - width / 2.0)
    yaw = math.degrees(primitive.yaw_rad)
    return Rectangle(
        corner,
        length,
        width,
        angle=yaw,
        rotation_point="center",
        facecolor=face,
        alpha=alpha,
        edgecolor="black",
        linewidth=line,
    )


def _shade(colour: tuple[int, int, int], brightness: float) -> tuple[float, float, float]:
    r, g, b = (channel / 255.0 * brightness for channel in colour)
    return r, g, b
