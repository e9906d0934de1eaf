"""The few calls of the server's HTTP interface that the demo makes."""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from typing import Any

from revnm_client.errors import LinkError

_TIMEOUT_S = 5.0


class ServerApi:
    """A client of one server at a base URL such as ``http://127.0.0.1:8000``."""

    def __init__(self, base_url: str) -> None:
        self._base_url = base_url

    def not_ready(self) -> str | None:
        """Return why the server is not ready, or None if it is."""
        try:
            self._call("GET", "/readyz")
        except LinkError as error:
            return str(error)
        return None

    def state(self) -> dict[str, Any]:
        """Return the document ``/api/v1/state``.

        Raises:
            LinkError: The server does not answer, or refuses.
        """
        document: dict[str, Any] = self._call("GET", "/api/v1/state")
        return document

    def set_goal(self, robot: str, *, u: float, v: float) -> None:
        """Send a robot to a pixel (u, v).

        Raises:
            LinkError: The server does not answer, or refuses.
        """
        self._call("PUT", f"/api/v1/robots/{robot}/goal", {"u": u, "v": v})

    def _call(self, method: str, path: str, body: dict[str, float] | None = None) -> Any:
        request = urllib.request.Request(  # noqa: S310 - the address is made by the demo itself
            self._base_url + path,
            method=method,
            data=None if body is None else json.dumps(body).encode(),
            headers={"Content-Type": "application/json"},
        )
        try:
            with urllib.request.urlopen(request, timeout=_TIMEOUT_S) as reply:  # noqa: S310
                return json.loads(reply.read())
        except urllib.error.HTTPError as error:
            with error:
                raise LinkError(f"{method} {path}: {error.code}: {_detail(error.read())}") from error
        except (OSError, ValueError) as error:
            raise LinkError(f"{method} {self._base_url}{path}: {error}") from error


def _detail(problem: bytes) -> str:
    """Return what a problem document (RFC 9457) says."""
    try:
        return str(json.loads(problem)["detail"])
    except (ValueError, KeyError, TypeError):
        return problem[:200].decode(errors="replace")
