"""Puts models and pipelines together: which implementation each stage has; for the server, its bench and replays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from revnm_server.calibration.keeper import CalibrationKeeper
from revnm_server.calibration.keyframes import TagMount
from revnm_server.calibration.places import PlaceKeeper
from revnm_server.networks.bundle import (
    Bundle,
    DepthBundle,
    default_bundle_path,
    load_bundle,
    load_depth_bundle,
    missing_models,
)
from revnm_server.networks.configured_depth import load_depth_network
from revnm_server.ports import Senses
from revnm_server.settings import DepthSettings, PerceptionSettings
from revnm_server.stages.depth import OnnxDepth
from revnm_server.stages.exo2ego import OnnxExo2Ego
from revnm_server.stages.policy import OnnxFloorPolicy, OnnxPolicy
from revnm_server.tag import TagDetector, TagLibrary, open_tag_library
from revnm_server.tick.map_beliefs import MapBeliefs
from revnm_server.tick.map_pipeline import MapPipeline
from revnm_server.tick.map_robot import RobotShape
from revnm_server.tick.pipeline import Pipeline


def load_models(settings: PerceptionSettings, depth: DepthSettings) -> Bundle | DepthBundle:
    """Return the models that the planner needs; without those of the policy only depth, for a search on the map.

    Args:
        settings: Which bundle, and how to run it.
        depth: A depth network that takes the place of the bundle's, if it names one.

    Raises:
        FileError: A file of the bundle or the depth network is altered or does not fit, or one that either planner
            needs is missing.
        ConfigError: A setting does not fit the depth network, or the provider is not installed or cannot start.
    """
    folder, threads, provider = settings.bundle or default_bundle_path(), settings.threads, settings.provider
    alone = settings.planner == "bev" or missing_models(folder)
    bundle = (load_depth_bundle if alone else load_bundle)(folder, threads=threads, provider=provider)
    if depth.model is None:
        return bundle
    return replace(bundle, depth=load_depth_network(depth, threads=threads, provider=provider))


def build_pipeline(
    bundle: Bundle,
    settings: PerceptionSettings,
    robots: Mapping[str, int],
    *,
    tag_library: TagLibrary | None = None,
) -> Pipeline:
    """Return the paper's pipeline.

    Args:
        bundle: The models.
        settings: How to run them.
        robots: Tag id of each robot.
        tag_library: Finds the tags, if the one that ``settings`` name is open already.
    """
    return Pipeline(
        bundle.spec,
        depth=OnnxDepth(bundle),
        tags=_tag_detector(settings, robots, tag_library),
        exo2ego=OnnxExo2Ego(bundle),
        planner=OnnxPolicy(bundle),
        max_sighting_age_s=settings.max_sighting_age_s,
    )


def build_map_pipeline(
    bundle: Bundle | DepthBundle,
    settings: PerceptionSettings,
    robots: Mapping[str, int],
    senses: Mapping[str, Senses],
    *,
    camera: str,
    tag_library: TagLibrary | None = None,
) -> MapPipeline:
    """Return the pipeline that plans on the map.

    Args:
        bundle: The depth network, and perhaps a policy that sees the map.
        settings: How to run them, and what robots look like.
        robots: Tag id of each robot.
        senses: What each robot measures itself.
        camera: Name of the camera, under which its calibration is kept.
        tag_library: Finds the tags, if the one that ``settings`` name is open already.
    """
    folder = settings.calibration_dir
    mount = TagMount(settings.tag_size_m, settings.tag_height_m)
    beliefs = None
    if isinstance(bundle, Bundle):
        policy = OnnxFloorPolicy(bundle)
        beliefs = MapBeliefs(bundle.spec, exo2ego=OnnxExo2Ego(bundle), policy=policy, tag_height_m=mount.height_m)
    return MapPipeline(
        depth=OnnxDepth(bundle),
        disparity_hw=bundle.spec.disparity_hw,
        tags=_tag_detector(settings, robots, tag_library),
        senses=senses,
        shape=RobotShape(mount, settings.robot_length_m, settings.robot_width_m),
        beliefs=beliefs,
        keeper=CalibrationKeeper(folder, camera) if folder is not None else None,
        place_keeper=PlaceKeeper(folder, camera) if folder is not None else None,
        max_sighting_age_s=settings.max_sighting_age_s,
    )


def plans_on_map(models: Bundle | DepthBundle) -> bool:
    """Return whether these models need :func:`build_map_pipeline`."""
    return isinstance(models, DepthBundle) or models.sees == "map"


def _tag_detector(settings: PerceptionSettings, robots: Mapping[str, int], library: TagLibrary | None) -> TagDetector:
    return TagDetector(
        {tag: robot for robot, tag in robots.items()},
        library=library or open_tag_library(settings.tag_library).library,
    )
