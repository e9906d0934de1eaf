"""The few calls of the server's HTTP interface that demo and measurements make."""

from __future__ import annotations

from typing import Any, Literal

from revnm_client.errors import LinkError
from revnm_server.api_client import ServerAddress, call

_TIMEOUT_S = 5.0


class ServerApi:
    """A client of one server at a base URL such as ``http://127.0.0.1:8000``."""

    def __init__(self, base_url: str) -> None:
        self._address = ServerAddress(base_url)

    def not_ready(self) -> str | None:
        """Return why the server is not ready, or None if it is."""
        try:
            call(self._address, "GET", "/readyz", within_s=_TIMEOUT_S)
        except LinkError as error:
            return str(error)
        return None

    def state(self) -> dict[str, Any]:
        """Return the document ``/api/v1/state``.

        Raises:
            LinkError: The server does not answer, or refuses.
        """
        document: dict[str, Any] = call(self._address, "GET", "/api/v1/state", within_s=_TIMEOUT_S)
        return document

    def set_goal(self, robot: str, *, u: float, v: float) -> str:
        """Send a robot to a pixel (u, v); return the goal's name.

        Raises:
            LinkError: The server does not answer, or refuses.
        """
        path = f"/api/v1/robots/{robot}/goal"
        reply = call(self._address, "PUT", path, body={"u": u, "v": v}, within_s=_TIMEOUT_S)
        return str(reply["goal"]["id"])

    def order(self, robot: str, order: Literal["stop", "resume"]) -> None:
        """Stop a robot, or let it go on.

        Raises:
            LinkError: The server does not answer, or refuses.
        """
        call(self._address, "POST", f"/api/v1/robots/{robot}/{order}", within_s=_TIMEOUT_S)
