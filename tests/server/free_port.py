"""A TCP port of this machine that nobody uses."""

from __future__ import annotations

import socket


def free_port() -> int:
    """Return the port; somebody else may take it before you do, which is unlikely."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])
