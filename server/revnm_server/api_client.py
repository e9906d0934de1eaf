"""Asks a server that runs, by its HTTP API and its own settings; for commands on the same machine."""

from __future__ import annotations

import json
import ssl
import urllib.error
import urllib.request
from typing import Any

from revnm_client.errors import LinkError
from revnm_server.settings import HttpSettings

_ANSWER_S = 2.0
_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # noqa: S104 - what others bind, and where they are reached


def ask(http: HttpSettings, path: str) -> Any:
    """Return what the server answers to ``GET /api/v1/<path>``; None where nothing answers at its address.

    Args:
        http: The server's own settings: its address, token and certificate.
        path: What is asked for.

    Raises:
        LinkError: Something answers that is no server of ours, or does not take the token.
    """
    headers = {"Authorization": f"Bearer {http.token.get_secret_value()}"} if http.token is not None else {}
    url = f"{_address(http)}/api/v1/{path}"
    opener = urllib.request.build_opener(
        urllib.request.ProxyHandler({}), urllib.request.HTTPSHandler(context=_context(http))
    )
    try:
        with opener.open(urllib.request.Request(url, headers=headers), timeout=_ANSWER_S) as answer:  # noqa: S310
            return json.loads(answer.read())
    except urllib.error.HTTPError as error:
        raise LinkError(f"{url} answers {error.code}: is it the server of these settings?") from error
    except ValueError as error:
        raise LinkError(f"{url} is no ReVNM server: stop it, or choose another http.port") from error
    except OSError as error:  # URLError is one
        reason = error.reason if isinstance(error, urllib.error.URLError) else error
        if isinstance(reason, ConnectionRefusedError):
            return None
        raise LinkError(f"{url}: {reason}") from error


def _address(http: HttpSettings) -> str:
    host = _EVERYWHERE.get(http.host, http.host)
    scheme = "http" if http.certificate is None else "https"
    return f"{scheme}://[{host}]:{http.port}" if ":" in host else f"{scheme}://{host}:{http.port}"


def _context(http: HttpSettings) -> ssl.SSLContext:
    """Trust the server's own certificate, whatever name it was made for: it is asked by the address that it binds."""
    context = ssl.create_default_context(cafile=http.certificate)
    context.check_hostname = False
    return context
