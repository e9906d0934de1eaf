"""The composition root: the only place that knows which implementation of each part is used."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

import uvicorn
import zenoh
from threadpoolctl import threadpool_limits

from revnm_client.errors import ConfigError
from revnm_client.link import open_router
from revnm_server.api import create_application
from revnm_server.bundle import (
    Bundle,
    DepthBundle,
    default_bundle_path,
    load_bundle,
    load_depth_bundle,
    missing_models,
)
from revnm_server.calibration.keeper import CalibrationKeeper
from revnm_server.calibration.keyframes import TagMount
from revnm_server.camera import open_camera
from revnm_server.configured_depth import load_depth_network
from revnm_server.depth import OnnxDepth
from revnm_server.exo2ego import OnnxExo2Ego
from revnm_server.map_beliefs import MapBeliefs
from revnm_server.map_navigator import RobotShape
from revnm_server.map_pipeline import MapPipeline
from revnm_server.mission import Mission
from revnm_server.pipeline import Pipeline
from revnm_server.policy import OnnxFloorPolicy, OnnxPolicy
from revnm_server.ports import Senses
from revnm_server.recording.about import describe
from revnm_server.recording.heard_log import HeardLog
from revnm_server.recording.recorder import Recorder
from revnm_server.restarts import RestartingPipeline
from revnm_server.robot_senses import RobotSenses
from revnm_server.service import NavigationService
from revnm_server.settings import DepthSettings, HttpSettings, PerceptionSettings, Settings
from revnm_server.tag import TagDetector, TagLibrary, open_tag_library

logger = logging.getLogger(__name__)

_HTTP_CLOSE_S = 2


@dataclass(frozen=True, slots=True)
class RunningServer:
    """A server at work.

    Attributes:
        url: Address of the page.
        service: Drives the robots.
        session: The router's Zenoh session.
        answers: Tells whether the page is still served; it should be as long as this is there.
    """

    url: str
    service: NavigationService
    session: zenoh.Session
    answers: Callable[[], bool]


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
        max_sighting_age_s=settings.max_sighting_age_s,
    )


@contextmanager
def running_server(settings: Settings) -> Iterator[RunningServer]:
    """Start a server, and on leaving stop the robots that it drives before anything else.

    While it runs, linear algebra in this process uses one thread.

    Raises:
        FileError: The bundle or the state file is malformed.
        ConfigError: The HTTP address is taken, or its certificate cannot be used.
        LinkError: A Zenoh endpoint is taken.
    """
    with ExitStack() as stack:
        # The matrices are small: handing half of one to a thread that waits for its core costs more than all of it.
        stack.enter_context(threadpool_limits(limits=1, user_api="blas"))
        models = load_models(settings.perception, settings.depth)
        tags = open_tag_library(settings.perception.tag_library)
        notes = _notes(models, settings.perception) + ([tags.note] if tags.note else [])
        mission = Mission(settings.robots, state_file=settings.state_file)
        listener = stack.enter_context(_listen(settings.http))
        session = stack.enter_context(open_router(settings.zenoh.listen))
        camera = open_camera(settings.camera.url, session)
        stack.callback(camera.close)
        heard = HeardLog()
        about = describe(settings, settings.perception.bundle or default_bundle_path())
        recorder = Recorder(
            settings.recording,
            session,
            camera=settings.camera.name,
            robots=tuple(settings.robots),
            about=about,
            heard=heard,
        )
        stack.callback(recorder.close)
        service = NavigationService(
            session,
            camera=camera,
            pipeline=_pipeline(models, settings, tags.library, session, heard, stack),
            mission=mission,
            tick_hz=settings.perception.tick_hz,
            tag_size_m=settings.perception.tag_size_m,
            robot_size_m=(settings.perception.robot_length_m, settings.perception.robot_width_m),
            notes=notes,
            recorder=recorder,
        )
        recorder.watch(service.view)
        answers = stack.enter_context(_serving_http(service, settings.http, listener))
        stack.callback(service.close)
        service.start()
        host, port = listener.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        scheme = "https" if settings.http.certificate is not None else "http"
        yield RunningServer(f"{scheme}://{shown}:{port}/", service, session, answers)


def _notes(models: Bundle | DepthBundle, settings: PerceptionSettings) -> list[str]:
    """Return what an operator should know of how the server was put together, and log it."""
    if isinstance(models, Bundle) or settings.planner == "bev":
        return []
    note = f"the bundle lacks {', '.join(models.missing)}: robots are led by a search on the map (planner bev)"
    logger.warning(note)
    return [note]


def _pipeline(
    models: Bundle | DepthBundle,
    settings: Settings,
    tags: TagLibrary,
    session: zenoh.Session,
    heard: HeardLog,
    stack: ExitStack,
) -> RestartingPipeline:
    own = {robot: RobotSenses(session, robot) for robot in settings.robots if _plans_on_map(models)}
    for each in own.values():
        stack.callback(each.close)
    senses = {robot: heard.along(robot, each) for robot, each in own.items()}
    loaded = [models]  # later ones are read again from their files
    perception, robots, camera = settings.perception, settings.robots, settings.camera.name

    def build() -> Pipeline | MapPipeline:
        models = loaded.pop() if loaded else load_models(perception, settings.depth)
        if isinstance(models, Bundle) and not _plans_on_map(models):
            return build_pipeline(models, perception, robots, tag_library=tags)
        return build_map_pipeline(models, perception, robots, senses, camera=camera, tag_library=tags)

    pipeline = RestartingPipeline(build)
    stack.callback(pipeline.close)
    return pipeline


def _plans_on_map(models: Bundle | DepthBundle) -> bool:
    return isinstance(models, DepthBundle) or models.sees == "map"


def _tag_detector(settings: PerceptionSettings, robots: Mapping[str, int], library: TagLibrary | None) -> TagDetector:
    return TagDetector(
        {tag: robot for robot, tag in robots.items()},
        library=library or open_tag_library(settings.tag_library).library,
    )


def _listen(settings: HttpSettings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        return socket.create_server((settings.host, settings.port), family=family)
    except OSError as error:
        raise ConfigError(f"cannot serve HTTP on {settings.host}:{settings.port}: {error.strerror}") from error


@contextmanager
def _serving_http(
    service: NavigationService, settings: HttpSettings, listener: socket.socket
) -> Iterator[Callable[[], bool]]:
    """Run uvicorn in a thread of its own, where it leaves the process's signals alone; yields whether it still runs.

    Raises:
        ConfigError: Certificate or key cannot be used.
    """
    config = uvicorn.Config(
        create_application(service, settings),
        log_config=None,  # its records go where ours go
        log_level="warning",
        access_log=False,  # addresses can hold the token
        lifespan="off",
        timeout_graceful_shutdown=_HTTP_CLOSE_S,
        timeout_keep_alive=5,
        ws_max_size=1024,
        ssl_certfile=settings.certificate,
        ssl_keyfile=settings.key,
        ws_per_message_deflate=False,  # it would pack the same state anew for each who looks
    )
    try:
        config.load()
    except OSError as error:  # ssl.SSLError is one
        raise ConfigError(f"HTTPS with {settings.certificate} and {settings.key}: {error}") from error
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="http", daemon=True)
    thread.start()
    try:
        yield thread.is_alive
    finally:
        server.should_exit = True
        thread.join()
