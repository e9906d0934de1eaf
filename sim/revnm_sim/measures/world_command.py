"""``revnm-sim world``: look at a world, and check it against the layout that it was measured from."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from revnm_client.errors import FileError
from revnm_sim.bench.protocol import CAMERA_HEIGHTS_M
from revnm_sim.camera import Camera
from revnm_sim.generation.placement import sample_camera
from revnm_sim.render import CameraRenderer
from revnm_sim.robot import RobotSpec
from revnm_sim.site import Pair, Site
from revnm_sim.top_view import draw_top_view
from revnm_sim.world_check import LEAST_IOU, agreement_table, compare, load_layout
from revnm_sim.worlds import WORLDS, named_site

_ARROW_M = 0.8
_WORLD_HELP = f"{', '.join(WORLDS)}, or the path of a world file"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the subcommands."""
    actions = parser.add_subparsers(dest="action", required=True)
    show = actions.add_parser("show", help="draw a world from above and from a camera into a PNG")
    show.add_argument("world", metavar="NAME|PATH", help=_WORLD_HELP)
    show.add_argument("--seed", type=int, default=0, help="which world of a generated family, and camera (default: 0)")
    show.add_argument("--out", type=Path, metavar="FILE.png", help="default: NAME.png in this folder")
    show.set_defaults(act=_show)
    check = actions.add_parser("check", help="compare a world with a measured layout; exit status 1 if they differ")
    check.add_argument("world", metavar="FILE", help=_WORLD_HELP)
    check.add_argument("--against", type=Path, required=True, metavar="JSON", help="the measured layout")
    check.set_defaults(act=_check)


def run(args: argparse.Namespace) -> int:
    """Draw or check; return 0, or 1 where a world differs from its layout."""
    return int(args.act(args))


def _show(args: argparse.Namespace) -> int:
    site = named_site(args.world, args.seed)
    cameras = site.cameras or (_drawn_camera(site, args.seed),)
    out = args.out or Path(f"{site.world.name}.png")
    figure = Figure(figsize=(15.0, 7.0), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    above, seen = figure.subplots(1, 2)
    draw_top_view(above, site.world)
    for camera in cameras:
        _draw_camera(above, camera)
    for i, pair in enumerate(site.pairs):
        _draw_pair(above, pair, str(i))
    above.set_title(f"{site.world.name}: {len(site.world.primitives)} boxes and cylinders")
    x, y, z = cameras[0].position_m
    seen.imshow(_picture(site, cameras[0]))
    seen.set_title(f"camera at ({x:.1f}, {y:.1f}, {z:.1f}) m, {math.degrees(cameras[0].hfov_rad):.0f}°")
    seen.set_axis_off()
    try:
        figure.savefig(out, format="png")
    except OSError as error:
        raise FileError(f"{out}: cannot be written: {error.strerror}") from error
    print(out)
    return 0


def _check(args: argparse.Namespace) -> int:
    layout = load_layout(args.against)
    agreement = compare(named_site(args.world, 0).world, layout)
    print(agreement_table(agreement))
    if agreement.iou >= LEAST_IOU:
        return 0
    print(f"the free floors agree to {agreement.iou:.4f}: expected at least {LEAST_IOU}")
    return 1


def _drawn_camera(site: Site, seed: int) -> Camera:
    rng = np.random.default_rng(seed)
    return sample_camera(
        site.world,
        rng,
        width_px=640,
        height_px=480,
        hfov_rad=math.radians(120.0),
        height_range_m=CAMERA_HEIGHTS_M,
    )


def _picture(site: Site, camera: Camera) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return what the camera sees, with the robot at the first pair's start if there is one."""
    with CameraRenderer(site.world, camera, RobotSpec(), tag_id=0) as renderer:
        return renderer.picture(site.pairs[0].start if site.pairs else None)


def _draw_camera(axes: Axes, camera: Camera) -> None:
    """Mark a camera and the edges of its view."""
    x, y, _ = camera.position_m
    axes.plot(x, y, marker="o", color="red", markeredgecolor="white", zorder=5)
    for side in (-0.5, 0.5):
        edge = camera.yaw_rad + side * camera.hfov_rad
        axes.plot([x, x + 2.0 * math.cos(edge)], [y, y + 2.0 * math.sin(edge)], color="red", zorder=5)


def _draw_pair(axes: Axes, pair: Pair, name: str) -> None:
    """Mark a start with its heading, and its goal."""
    x, y, yaw = pair.start
    ahead = (x + _ARROW_M * math.cos(yaw), y + _ARROW_M * math.sin(yaw))
    axes.annotate("", ahead, (x, y), arrowprops={"arrowstyle": "->", "color": "blue", "linewidth": 2.0}, zorder=5)
    axes.plot(*pair.goal_m, marker="*", markersize=12.0, color="gold", markeredgecolor="black", zorder=5)
    for place in ((x, y), pair.goal_m):
        axes.annotate(name, place, xytext=(4.0, 4.0), textcoords="offset points", zorder=5)
