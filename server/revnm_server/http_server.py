"""Serves the application by uvicorn, in a thread of its own, where it leaves the process's signals alone."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import uvicorn

from revnm_client.errors import ConfigError
from revnm_server.api import create_application
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings

_CLOSE_S = 2


def listen(settings: HttpSettings) -> socket.socket:
    """Return a socket that listens at the settings' address.

    Raises:
        ConfigError: The address is taken, or none of this machine's.
    """
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        listener = socket.create_server((settings.host, settings.port), family=family)
    except OSError as error:
        place = f"{settings.host}:{settings.port}"
        raise ConfigError(f"cannot serve HTTP on {place}: {error.strerror} (--http takes another)") from error
    # Only where the protocol is named does asyncio let answers go at once (TCP_NODELAY).
    return socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP, fileno=listener.detach())


@contextmanager
def serving_http(
    service: NavigationService, settings: HttpSettings, listener: socket.socket
) -> Iterator[Callable[[], bool]]:
    """Serve until this is left; yields what tells whether it still runs.

    Raises:
        ConfigError: Certificate or key cannot be used.
    """
    config = uvicorn.Config(
        create_application(service, settings),
        log_config=None,  # its records go where ours go
        log_level="warning",
        access_log=False,  # addresses can hold the token
        lifespan="off",
        timeout_graceful_shutdown=_CLOSE_S,
        timeout_keep_alive=5,
        http="httptools",
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


def page_url(settings: HttpSettings, listener: socket.socket) -> str:
    """Return the address of the page."""
    host, port = listener.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    scheme = "https" if settings.certificate is not None else "http"
    return f"{scheme}://{shown}:{port}/"
