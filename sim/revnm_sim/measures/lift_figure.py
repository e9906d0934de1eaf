"""Pictures of the maps that ``revnm-sim lift`` scores, beside the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32
from revnm_sim.measures.lift_trial import WINDOW, View
from revnm_sim.measures.lift_truth import RADIUS_M, Truth

_UNSEEN, _FREE, _OBSTACLE = np.array([0.16, 0.18, 0.21]), np.array([0.78, 0.81, 0.83]), np.array([0.84, 0.27, 0.24])
_INCHES = 1.5


@dataclass(frozen=True, slots=True)
class Example:
    """One place of a drive.

    Attributes:
        world: Its name.
        view: The place.
        windows: By case, obstacle and floor (2, side, side) of the window; None where the picture was refused.
    """

    world: str
    view: View
    windows: Mapping[str, Image32 | None]


def draw_examples(examples: Sequence[Example], path: Path) -> None:
    """Draw a row for each example: the camera's disparity, the truth within 4 m, and every case's map.

    The robot stands in the middle, heading up; floor is bright, obstacles are red, unseen cells dark.

    Args:
        examples: At least one; all have the same cases.
        path: The PNG.
    """
    cases = list(examples[0].windows)
    size = (_INCHES * (2 + len(cases)), _INCHES * len(examples) + 0.4)
    figure = Figure(figsize=size, dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    rows = figure.subplots(len(examples), 2 + len(cases), squeeze=False)
    for axes, example in zip(rows, examples, strict=True):
        axes[0].imshow(example.view.disparity, cmap="magma")
        _draw(axes[1], _true_colours(example.view.truth))
        for each, window in zip(axes[2:], example.windows.values(), strict=True):
            _draw(each, None if window is None else _colours(window))
    for axes, title in zip(rows[0], ("disparity", "truth", *(case.replace("/", "\n") for case in cases)), strict=True):
        axes.set_title(title, fontsize=7)
    for axes, example in zip(rows[:, 0], examples, strict=True):
        axes.set_ylabel(example.world, fontsize=7)
    for axes in rows.ravel():
        axes.set_xticks([])
        axes.set_yticks([])
    figure.savefig(path, format="png")


def _draw(axes: Axes, colours: FloatArray | None) -> None:
    if colours is None:
        axes.text(0.5, 0.5, "refused", ha="center", va="center", transform=axes.transAxes, fontsize=7)
        return
    axes.imshow(colours, interpolation="nearest")
    middle = 0.5 * (len(colours) - 1)
    axes.plot([middle], [middle], marker="^", markersize=4, color="#16a34a")


def _true_colours(truth: Truth) -> FloatArray:
    seen = np.where(truth.occupied[..., None], _OBSTACLE, _FREE)
    return np.where(truth.visible[..., None], seen, _UNSEEN)


def _colours(layers: Image32) -> FloatArray:
    """Return the map's colours (side, side, 3) within the radius that is scored, else as unseen."""
    obstacle, floor = layers
    known = (floor > 0.5) | (obstacle > 0.5)
    share = np.where(obstacle > 0.5, 0.4 + 0.6 * (2.0 * obstacle - 1.0), 0.0)[..., None]
    along = np.arange(len(obstacle)) - 0.5 * (len(obstacle) - 1)
    near = np.hypot(along[:, None], along) * WINDOW.cell_m < RADIUS_M
    return np.where((known & near)[..., None], (1.0 - share) * _FREE + share * _OBSTACLE, _UNSEEN)
