from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator

import pytest
import zenoh

from revnm_client.link import open_client, open_router


@pytest.fixture
def endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture
def router(endpoint: str) -> Iterator[zenoh.Session]:
    with open_router([endpoint]) as session:
        yield session


@pytest.fixture
def client(endpoint: str, router: zenoh.Session) -> Iterator[zenoh.Session]:
    with open_client([endpoint]) as session:
        yield session


@pytest.fixture
def eventually() -> Callable[..., None]:
    """Wait until a condition holds, or fail when the deadline passes."""

    def wait(condition: Callable[[], object], *, within_s: float = 10.0, every_s: float = 0.005) -> None:
        pause = threading.Event()
        deadline_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline_s, f"condition did not hold within {within_s} s"
            pause.wait(every_s)

    return wait
