"""A strip of what the camera sees in depth, what exo2ego imagines from it, and what the robot would truly see."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.ego_prior import ego_prior
from revnm_server.mapping.floor_map import FloorMapper
from revnm_server.mapping.floor_view import floor_view
from revnm_server.mapping.lift import FloorLifter, NoFloor
from revnm_server.networks.bundle import Bundle, load_bundle
from revnm_server.observation import (
    Image32,
    ImagePose,
    ObservationSpec,
    crops_around,
    normalise_disparity,
    normalise_ego_depth,
    normalise_pixel,
)
from revnm_server.ports import EgoRequest
from revnm_server.stages.exo2ego import OnnxExo2Ego
from revnm_sim.bench.methods import WITH_MODELS
from revnm_sim.bench.metrics import Results
from revnm_sim.bench.protocol import Setting, draw_setting
from revnm_sim.bench.trial import TrialKey
from revnm_sim.camera import Camera
from revnm_sim.measures.lift_truth import exact_calibration, world_from_floor
from revnm_sim.rays.raycast import cast_depth, disparity_from_depth, ego_camera, robot_primitive
from revnm_sim.robot import RobotSpec, see_robot
from revnm_sim.scenario import tag_seen
from revnm_sim.world import primitive_arrays

_VIEWS = 4
_LOOK_M = 0.5  # the heading on the way is towards the point so far ahead


@dataclass(frozen=True, slots=True)
class EgoView:
    """One robot pose, in three pictures.

    Attributes:
        exo: (h, w) in [0, 1], normalised exo disparity.
        pixel: (2,) where the robot is in it, normalised.
        imagined: (ego_px, ego_px) in [−1, 1].
        true: The same, exact.
    """

    exo: Image32
    pixel: FloatArray
    imagined: Image32
    true: Image32


def draw_ego_strip(results: Results, path: Path) -> bool:
    """Draw views along the planner's way of the first trial of each world, with the first method's bundle.

    Args:
        results: All trials.
        path: The PNG.

    Returns:
        Whether there was a bundle to draw with.
    """
    keys = {key.world: key for key in reversed(list(results)) if key.method in WITH_MODELS}
    if not keys:
        return False
    worlds = list(dict.fromkeys(key.world for key in results))
    figure = Figure(figsize=(3.0 * _VIEWS, 6.6 * len(worlds)), dpi=60, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3 * len(worlds), _VIEWS, squeeze=False)
    for number, world in enumerate(worlds):
        views = _views(keys[world])
        for column in range(_VIEWS):
            view = views[column] if column < len(views) else None
            _draw_view(view, *axes[3 * number : 3 * number + 3, column])
        for row, label in enumerate(("exo depth", "imagined ego depth", "true ego depth")):
            axes[3 * number + row, 0].set_title(f"{Path(world).stem}: {label}", loc="left", fontsize=9)
    figure.savefig(path, format="png")
    return True


def _views(key: TrialKey) -> list[EgoView]:
    """Return the views of evenly spread poses on the way at which the camera sees the tag."""
    setting = draw_setting(key.world, seed=key.seed, pair=key.pair, cameras=key.cameras, rule=key.rule)
    camera, bundle = setting.cameras[key.camera], load_bundle(Path(key.bundle))
    way = setting.route.field.path(setting.pair.start[:2])
    arrays = primitive_arrays(setting.site.world.obstacles)
    seen = np.flatnonzero(tag_seen(arrays, camera, way, RobotSpec()))
    if not len(seen):
        return []
    chosen = seen[np.linspace(0, len(seen) - 1, _VIEWS).astype(int)]
    return [_view(setting, camera, bundle, _pose_on(way, index)) for index in dict.fromkeys(chosen.tolist())]


def _pose_on(way_m: FloatArray, index: int) -> Pose2:
    ahead = np.hypot(*(way_m[index:] - way_m[index]).T) >= _LOOK_M
    target = way_m[index + int(ahead.argmax())] if ahead.any() else way_m[-1]
    x, y = way_m[index]
    dx, dy = target - way_m[index] if ahead.any() else way_m[index] - way_m[max(index - 5, 0)]
    return Pose2(float(x), float(y), float(np.arctan2(dy, dx)))


def _view(setting: Setting, camera: Camera, bundle: Bundle, pose: Pose2) -> EgoView:
    spec, robot, world = bundle.spec, RobotSpec(), setting.site.world
    body = primitive_arrays((*world.primitives, robot_primitive(pose, robot)))
    exo = normalise_disparity(disparity_from_depth(cast_depth(body, camera, spec.disparity_hw)))
    sighting = see_robot(camera, pose, robot, robot="rover", stamp_ns=0)
    size = (camera.width_px, camera.height_px)
    place = ImagePose(normalise_pixel(sighting.pixel, size), sighting.heading)
    history = np.repeat(exo[None], spec.history, axis=0)
    crops = crops_around(history, place, size[0] / size[1], spec)
    prior = _prior(setting, camera, pose, spec) if bundle.exo2ego.prior else None
    request = EgoRequest("rover", 0, place, crops, prior)
    depth = cast_depth(primitive_arrays(world.primitives), ego_camera(pose, spec), (spec.ego_px, spec.ego_px))
    imagined = OnnxExo2Ego(bundle).synthesise([request])[0]
    return EgoView(exo, place.p_rob, imagined, normalise_ego_depth(depth, spec))


def _prior(setting: Setting, camera: Camera, pose: Pose2, spec: ObservationSpec) -> Image32:
    """Return what a map that is calibrated exactly says of the robot's view, (2, ego_px, ego_px)."""
    hw, view = spec.disparity_hw, floor_view(exact_calibration(camera), spec.disparity_hw)
    depth = cast_depth(primitive_arrays(setting.site.world.primitives), camera, hw)
    lifted = FloorLifter(view).lift(disparity_from_depth(depth), np.ones(hw, dtype=np.bool_))
    place, mapper = world_from_floor(camera).inverse() @ pose, FloorMapper(view)
    if isinstance(lifted, NoFloor):
        return ego_prior(None, mapper.spec.unknown(), place, spec)
    return ego_prior(lifted, mapper.draw(lifted, np.zeros(hw, dtype=np.float32)), place, spec)


def _draw_view(view: EgoView | None, exo: Axes, imagined: Axes, true: Axes) -> None:
    for axes in (exo, imagined, true):
        axes.set_axis_off()
    if view is None:
        return
    height, width = view.exo.shape
    exo.imshow(view.exo, cmap="magma", vmin=0.0, vmax=1.0)
    exo.plot(view.pixel[0] * width, view.pixel[1] * height, "o", color="cyan", markerfacecolor="none", markersize=9)
    for axes, depth in ((imagined, view.imagined), (true, view.true)):
        axes.imshow(depth, cmap="magma_r", vmin=-1.0, vmax=1.0)
