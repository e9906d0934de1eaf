"""The composition root: the only place that knows which implementation of each part is used."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

import uvicorn
import zenoh

from revnm_client.errors import ConfigError
from revnm_client.link import open_router
from revnm_server.api import create_application
from revnm_server.bundle import default_bundle_path, load_bundle
from revnm_server.camera import open_camera
from revnm_server.depth import OnnxDepth
from revnm_server.exo2ego import OnnxExo2Ego
from revnm_server.mission import Mission
from revnm_server.pipeline import Pipeline
from revnm_server.policy import OnnxPolicy
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings, PerceptionSettings, Settings
from revnm_server.tag import TagDetector

logger = logging.getLogger(__name__)

_HTTP_CLOSE_S = 2


@dataclass(frozen=True, slots=True)
class RunningServer:
    """A server at work.

    Attributes:
        url: Address of the page.
        service: Drives the robots.
        session: The router's Zenoh session.
    """

    url: str
    service: NavigationService
    session: zenoh.Session


def build_pipeline(settings: PerceptionSettings, robots: dict[str, int]) -> Pipeline:
    """Return the pipeline with the models of the bundle.

    Args:
        settings: Which bundle, and how to run it.
        robots: Tag id of each robot.

    Raises:
        FileError: A file of the bundle is missing, altered or does not fit.
    """
    bundle = load_bundle(settings.bundle or default_bundle_path(), threads=settings.threads)
    return Pipeline(
        bundle.spec,
        depth=OnnxDepth(bundle),
        tags=TagDetector({tag: robot for robot, tag in robots.items()}),
        exo2ego=OnnxExo2Ego(bundle),
        planner=OnnxPolicy(bundle),
        max_sighting_age_s=settings.max_sighting_age_s,
    )


@contextmanager
def running_server(settings: Settings) -> Iterator[RunningServer]:
    """Start a server, and on leaving stop the robots that it drives before anything else.

    Raises:
        FileError: The bundle or the state file is malformed.
        ConfigError: The HTTP address is taken.
        LinkError: A Zenoh endpoint is taken.
    """
    with ExitStack() as stack:
        pipeline = build_pipeline(settings.perception, settings.robots)
        mission = Mission(settings.robots, state_file=settings.state_file)
        listener = stack.enter_context(_listen(settings.http))
        session = stack.enter_context(open_router(settings.zenoh.listen))
        camera = open_camera(settings.camera.url, session)
        stack.callback(camera.close)
        service = NavigationService(
            session,
            camera=camera,
            pipeline=pipeline,
            mission=mission,
            tick_hz=settings.perception.tick_hz,
            tag_size_m=settings.perception.tag_size_m,
        )
        stack.enter_context(_serving_http(service, settings.http, listener))
        stack.callback(service.close)
        service.start()
        host, port = listener.getsockname()[:2]
        shown = f"[{host}]" if ":" in host else host
        yield RunningServer(f"http://{shown}:{port}/", service, session)


def _listen(settings: HttpSettings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        return socket.create_server((settings.host, settings.port), family=family)
    except OSError as error:
        raise ConfigError(f"cannot serve HTTP on {settings.host}:{settings.port}: {error.strerror}") from error


@contextmanager
def _serving_http(service: NavigationService, settings: HttpSettings, listener: socket.socket) -> Iterator[None]:
    """Run uvicorn in a thread of its own, where it leaves the process's signals alone."""
    config = uvicorn.Config(
        create_application(service, settings),
        log_level="warning",
        access_log=False,  # addresses can hold the token
        lifespan="off",
        timeout_graceful_shutdown=_HTTP_CLOSE_S,
        timeout_keep_alive=5,
        ws_max_size=1024,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, name="http", daemon=True)
    thread.start()
    try:
        yield
    finally:
        server.should_exit = True
        thread.join()
