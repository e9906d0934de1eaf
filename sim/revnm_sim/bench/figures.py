"""Pictures of a benchmark, like the paper's: where the robots drove, and what exo2ego imagined."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from revnm_client.geometry import FloatArray
from revnm_sim.bench.metrics import Results
from revnm_sim.bench.protocol import Setting, draw_setting
from revnm_sim.bench.trial import TrialKey, TrialResult
from revnm_sim.camera import Camera
from revnm_sim.render import CameraRenderer
from revnm_sim.robot import RobotSpec
from revnm_sim.scenario import at_height
from revnm_sim.top_view import draw_top_view

_COLOURS = ("#d62728", "#1f77b4", "#2ca02c", "#9467bd", "#ff7f0e", "#17becf", "#e377c2", "#8c564b")
_FINE_M = 0.05

Tracks = Mapping[str, TrialResult]


def draw_trajectories(results: Results, path: Path) -> None:
    """Draw one condition of each world: over the camera's view and from the top, a line for each method.

    It is the condition in which the methods' outcomes differ most; of several, the first.

    Args:
        results: All trials.
        path: The PNG.
    """
    worlds = list(dict.fromkeys(key.world for key in results))
    figure = Figure(figsize=(6.0 * len(worlds), 10.5), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, len(worlds), squeeze=False)
    methods = list(dict.fromkeys(key.method for key in results))
    colours = {method: _COLOURS[number % len(_COLOURS)] for number, method in enumerate(methods)}
    for (seen, above), world in zip(axes.T, worlds, strict=True):
        key, tracks = most_telling(results, world)
        setting = draw_setting(key.world, seed=key.seed, pair=key.pair, cameras=key.cameras, rule=key.rule)
        _draw_over_view(seen, setting, setting.cameras[key.camera], tracks, colours)
        _draw_from_top(above, setting, setting.cameras[key.camera], tracks, colours)
        seen.set_title(f"{setting.site.world.name}, pair {key.pair}, camera {key.camera}")
    axes[0, 0].legend(loc="upper left", fontsize="small")
    figure.savefig(path, format="png")


def most_telling(results: Results, world: str) -> tuple[TrialKey, Tracks]:
    """Return the trial of a world in which the methods' outcomes differ most, and every method's result there."""
    groups: dict[tuple[int, int, int], dict[TrialKey, TrialResult]] = {}
    for key, result in results.items():
        if key.world == world:
            groups.setdefault((key.pair, key.camera, key.repeat), {})[key] = result

    def variance(group: Mapping[TrialKey, TrialResult]) -> float:
        return float(np.var([result.success for result in group.values()]))

    best = max(groups.values(), key=variance)
    return next(iter(best)), {key.method: result for key, result in best.items()}


def _draw_over_view(axes: Axes, setting: Setting, camera: Camera, tracks: Tracks, colours: Mapping[str, str]) -> None:
    with CameraRenderer(setting.site.world, camera, RobotSpec(), tag_id=0) as renderer:
        axes.imshow(renderer.picture(setting.pair.start))
    for method, result in tracks.items():
        _draw_track(axes, _pixels(camera, _fine(result.track_m)), result, colours[method], method)
    ends = _pixels(camera, np.array([setting.pair.start[:2], setting.pair.goal_m]))
    _draw_ends(axes, ends)
    axes.set_xlim(0, camera.width_px - 1)
    axes.set_ylim(camera.height_px - 1, 0)
    axes.set_axis_off()


def _draw_from_top(axes: Axes, setting: Setting, camera: Camera, tracks: Tracks, colours: Mapping[str, str]) -> None:
    draw_top_view(axes, setting.site.world)
    for method, result in tracks.items():
        _draw_track(axes, np.array(result.track_m), result, colours[method], method)
    _draw_ends(axes, np.array([setting.pair.start[:2], setting.pair.goal_m]))
    x, y, _ = camera.position_m
    axes.plot(x, y, marker=(3, 0, np.degrees(camera.yaw_rad) - 90.0), markersize=12, color="black")


def _draw_track(axes: Axes, points: FloatArray, result: TrialResult, colour: str, label: str) -> None:
    axes.plot(*points.T, color=colour, linewidth=1.5, alpha=0.85, label=label)
    if not result.success:
        axes.plot(*points[-1], marker="x", markersize=9, markeredgewidth=2.5, color=colour, zorder=3)


def _draw_ends(axes: Axes, points: FloatArray) -> None:
    for name, (x, y) in zip("SG", points, strict=True):
        box = {"boxstyle": "circle", "facecolor": "white", "alpha": 0.85}
        axes.text(x, y, name, ha="center", va="center", fontweight="bold", fontsize=9, bbox=box)


def _pixels(camera: Camera, points_m: FloatArray) -> FloatArray:
    """Return the pixels (M, 2) of floor points; NaN for those behind the camera."""
    pixels, depths = camera.project(at_height(points_m, 0.0))
    return np.where(depths[:, None] > 0.1, pixels, np.nan)


def _fine(track_m: Sequence[Sequence[float]]) -> FloatArray:
    """Return the track with points at most 5 cm apart: straight on the floor is not straight in steps of pixels."""
    points = np.array(track_m)
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    at = np.linspace(0.0, lengths[-1], max(2, int(lengths[-1] / _FINE_M)))
    return np.stack([np.interp(at, lengths, points[:, axis]) for axis in (0, 1)], axis=1)
