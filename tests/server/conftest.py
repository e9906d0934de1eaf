from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from revnm_client.link import open_router

from .free_port import free_port
from .tiny_bundle import write_tiny_bundle


@pytest.fixture
def tiny_bundle(tmp_path: Path) -> Path:
    """A complete bundle that steers along the straight line in the picture."""
    return write_tiny_bundle(tmp_path / "tiny_bundle")


@pytest.fixture
def endpoint() -> str:
    """Where the router listens, so that others can connect."""
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def router(endpoint: str) -> Iterator[zenoh.Session]:
    with open_router([endpoint]) as session:
        yield session
