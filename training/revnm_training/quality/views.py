"""Views to measure on: robot states seen by a camera, in evaluation worlds, with the truth from ray casting.

States are drawn as for training, but only in evaluation seeds of a family or in fixed worlds, and by the benchmark's
camera: 640 × 480, 120° wide. Disparity, robot pixel, heading and calibration are exact, nothing is augmented: what is
measured is exo2ego alone. Imports neither torch nor PyBullet.

Symbols: M views, N frames of history.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import joblib
import numpy as np
from tqdm import tqdm

from revnm_client.errors import ContractError
from revnm_client.geometry import FloatArray, Pose2
from revnm_server.mapping.ego_prior import ego_prior
from revnm_server.observation import (
    Image32,
    ImagePose,
    ObservationSpec,
    crops_around,
    normalise_disparity,
    normalise_pixel,
)
from revnm_sim.expert.planner import Expert, UnreachableError
from revnm_sim.generation.generator import TRAINING_SEED_BASE
from revnm_sim.generation.placement import sample_camera
from revnm_sim.robot import RobotSpec
from revnm_sim.world import World
from revnm_sim.worlds import named_site
from revnm_training.map_scene import EXACT, MapScene
from revnm_training.samples import SceneRenderer
from revnm_training.states import Scene, draw_goals, draw_history, draw_states, make_scene

VIEWS_PER_CAMERA = 25
CAMERAS_PER_BLOCK = 4
_BLOCK = VIEWS_PER_CAMERA * CAMERAS_PER_BLOCK
_GOALS = 2
_STATES_PER_GOAL = 16
_ATTEMPTS = 50
SIZE_PX = (640, 480)
HFOV_RAD = math.radians(120.0)


@dataclass(frozen=True, slots=True)
class View:
    """One robot in one camera's picture.

    Attributes:
        pose: Where the robot is in the picture.
        crops: (N, crop_px, crop_px) in [0, 1], oldest first, all cut around ``pose``.
        ego: (ego_px, ego_px) in [−1, 1], what the robot sees in truth.
        prior: (2, ego_px, ego_px) as of :func:`revnm_server.mapping.ego_prior.ego_prior`, from the camera alone; None
            where nobody asked for it.
    """

    pose: ImagePose
    crops: Image32
    ego: Image32
    prior: Image32 | None


def make_views(
    world: str, spec: ObservationSpec, *, count: int, seed: int, jobs: int, prior: bool = False
) -> list[View]:
    """Make views of a world, 25 by each camera; a family gives another world every 100.

    Args:
        world: Name or path, see :func:`revnm_sim.worlds.named_site`.
        spec: What is observed.
        count: M.
        seed: Of everything random.
        jobs: Processes.
        prior: Whether the exo depth is wanted in the robot's view, too.

    Raises:
        ConfigError: No world has this name.
        FileError: The world's file is malformed.
        ContractError: The world has no place for a camera that sees a robot often enough.
    """
    named_site(world, 0)  # a wrong name is told before processes start
    starts = range(0, count, _BLOCK)
    tasks = (
        joblib.delayed(_block)(world, spec, seed, start // _BLOCK, min(_BLOCK, count - start), prior=prior)
        for start in starts
    )
    views: list[View] = []
    with tqdm(total=count, desc=f"render {world}", unit=" views") as bar:
        for part in joblib.Parallel(n_jobs=jobs, return_as="generator", batch_size=1)(tasks):
            views += part
            bar.update(len(part))
    return views


def evaluation_seed(sequence: np.random.SeedSequence) -> int:
    """Return the seed of a world that no training has seen."""
    return int(sequence.generate_state(1)[0]) % TRAINING_SEED_BASE


def _block(world: str, spec: ObservationSpec, seed: int, number: int, count: int, *, prior: bool) -> list[View]:
    failure: ContractError | None = None
    for attempt in range(_ATTEMPTS):
        sequence = np.random.SeedSequence([seed, number, attempt])
        site, rng = named_site(world, evaluation_seed(sequence)), np.random.default_rng(sequence)
        try:
            return _world_views(site.world, spec, count, rng, prior=prior)
        except ContractError as error:
            failure = error
    raise ContractError(f"world {world!r}: no views in {_ATTEMPTS} attempts; the last: {failure}")


def _world_views(
    world: World, spec: ObservationSpec, count: int, rng: np.random.Generator, *, prior: bool
) -> list[View]:
    """Return ``count`` views of a world.

    Raises:
        ContractError: Cameras see too little.
    """
    expert = Expert(world)
    views: list[View] = []
    for _ in range(2 * CAMERAS_PER_BLOCK):
        if len(views) < count:
            views += _camera_views(world, spec, expert, rng, prior=prior)
    if len(views) < count:
        raise ContractError(f"world {world.name!r}: cameras see {len(views)} of {count} states")
    return views[:count]


def _camera_views(
    world: World, spec: ObservationSpec, expert: Expert, rng: np.random.Generator, *, prior: bool
) -> list[View]:
    """Return up to 25 views by one camera."""
    width, height = SIZE_PX
    camera = sample_camera(world, rng, width_px=width, height_px=height, hfov_rad=HFOV_RAD)
    scene = make_scene(world, camera, expert.grid, RobotSpec(), rng)
    renderer = SceneRenderer(world, camera, spec)
    poses = rng.permutation(_states(scene, expert, rng))[:VIEWS_PER_CAMERA]
    priors = MapScene(world, camera, spec.disparity_hw, EXACT, rng) if prior else None
    return [_view(renderer, spec, _past(scene, spec, Pose2(*pose), rng), priors) for pose in poses]


def _states(scene: Scene, expert: Expert, rng: np.random.Generator) -> FloatArray:
    """Return poses (S, 3) drawn as for training: beside the expert's way, anywhere, and near obstacles."""
    poses = [np.empty((0, 3))]
    for goal in draw_goals(scene, _GOALS, rng):
        try:
            field = expert.field(goal)
        except UnreachableError:
            continue
        poses.append(draw_states(scene, field, _STATES_PER_GOAL, rng)[0])
    return np.concatenate(poses)


def _past(scene: Scene, spec: ObservationSpec, pose: Pose2, rng: np.random.Generator) -> list[Pose2]:
    past = draw_history(scene, pose, frames=spec.history, interval_s=spec.history_interval_s, rng=rng)
    return [Pose2(*earlier) for earlier in past]


def _view(renderer: SceneRenderer, spec: ObservationSpec, past: Sequence[Pose2], priors: MapScene | None) -> View:
    sighting = renderer.sighting(past[-1])
    pose = ImagePose(normalise_pixel(sighting.pixel, SIZE_PX), sighting.heading)
    disparities = np.stack([normalise_disparity(renderer.disparity(earlier)) for earlier in past])
    crops = crops_around(disparities, pose, SIZE_PX[0] / SIZE_PX[1], spec)
    return View(pose, crops, renderer.egos(past[-1:])[0], None if priors is None else _prior(priors, spec, past[-1]))


def _prior(scene: MapScene, spec: ObservationSpec, pose: Pose2) -> Image32:
    """Return the prior (2, ego_px, ego_px) of a robot that has not scanned anything yet."""
    place = scene.place(pose)
    return ego_prior(scene.lifted, scene.grid(place), place, spec)
