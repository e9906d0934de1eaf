"""The composition root: puts a server together, with :mod:`revnm_server.assembly` for its models and pipeline."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import zenoh
from threadpoolctl import threadpool_limits

from revnm_client.link import open_router
from revnm_server.assembly import build_map_pipeline, build_pipeline, load_models, plans_on_map
from revnm_server.camera import open_camera
from revnm_server.http_server import listen, page_url, serving_http
from revnm_server.networks.bundle import Bundle, DepthBundle, default_bundle_path
from revnm_server.recording.about import describe
from revnm_server.recording.heard_log import HeardLog
from revnm_server.recording.recorder import Recorder
from revnm_server.robots.access import security_of
from revnm_server.robots.mission import Mission
from revnm_server.robots.robot_link import server_name
from revnm_server.robots.robot_senses import RobotSenses
from revnm_server.service import NavigationService
from revnm_server.settings import PerceptionSettings, Settings
from revnm_server.tag import TagLibrary, open_tag_library
from revnm_server.tick.map_pipeline import MapPipeline
from revnm_server.tick.pipeline import Pipeline
from revnm_server.tick.restarts import RestartingPipeline

logger = logging.getLogger(__name__)


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


@contextmanager
def running_server(settings: Settings) -> Iterator[RunningServer]:
    """Start a server, and on leaving stop the robots that it drives before anything else.

    While it runs, linear algebra in this process uses one thread.

    Raises:
        FileError: The bundle or the state file is malformed, or a certificate or the passwords cannot be used.
        ConfigError: The HTTP address is taken, or its certificate cannot be used.
        LinkError: A Zenoh endpoint is taken.
    """
    with ExitStack() as stack:
        # The matrices are small: handing half of one to a thread that waits for its core costs more than all of it.
        stack.enter_context(threadpool_limits(limits=1, user_api="blas"))
        models = load_models(settings.perception, settings.depth)
        tags = open_tag_library(settings.perception.tag_library)
        notes = _notes(models, settings.perception) + ([tags.note] if tags.note else [])
        ending = _certificate_notes(settings)
        mission = Mission(settings.robots, state_file=settings.state_file)
        listener = stack.enter_context(listen(settings.http))
        session = stack.enter_context(open_router(settings.zenoh.listen, security=security_of(settings)))
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
            notes=lambda: [*notes, *ending()],
            recorder=recorder,
            name=server_name(settings.zenoh.listen),
        )
        recorder.watch(service.view)
        answers = stack.enter_context(serving_http(service, settings.http, listener))
        stack.callback(service.close)
        service.start()
        yield RunningServer(page_url(settings.http, listener), service, session, answers)


def _notes(models: Bundle | DepthBundle, settings: PerceptionSettings) -> list[str]:
    """Return what an operator should know of how the server was put together, and log it."""
    if isinstance(models, Bundle) or settings.planner == "bev":
        return []
    note = f"the bundle lacks {', '.join(models.missing)}: robots are led by a search on the map (planner bev)"
    logger.warning(note)
    return [note]


def _certificate_notes(settings: Settings) -> Callable[[], list[str]]:
    """Return what tells which certificates end soon."""
    if not settings.certificates:
        return list
    from revnm_server.pki import CertificateWatch  # takes a tenth of a second

    return CertificateWatch(lambda: settings.certificates).notes


def _pipeline(
    models: Bundle | DepthBundle,
    settings: Settings,
    tags: TagLibrary,
    session: zenoh.Session,
    heard: HeardLog,
    stack: ExitStack,
) -> RestartingPipeline:
    own = {robot: RobotSenses(session, robot) for robot in settings.robots if plans_on_map(models)}
    for each in own.values():
        stack.callback(each.close)
    senses = {robot: heard.along(robot, each) for robot, each in own.items()}
    perception, robots, camera = settings.perception, settings.robots, settings.camera.name

    def build(models: Bundle | DepthBundle) -> Pipeline | MapPipeline:
        if isinstance(models, Bundle) and not plans_on_map(models):
            return build_pipeline(models, perception, robots, tag_library=tags)
        return build_map_pipeline(models, perception, robots, senses, camera=camera, tag_library=tags)

    pipeline = RestartingPipeline(build(models), lambda: build(load_models(perception, settings.depth)))
    stack.callback(pipeline.close)
    return pipeline
