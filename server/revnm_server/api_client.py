"""Calls the HTTP API of a server that runs; for other commands, and for the simulator's demo."""

from __future__ import annotations

import http.client
import ipaddress
import json
import ssl
import urllib.error
import urllib.request
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal

from revnm_client.errors import ConfigError, LinkError
from revnm_server.settings import HttpSettings

_UNAUTHORIZED = "expected the token that the running server was started with: REVNM_HTTP__TOKEN"


class NoServerError(LinkError):
    """Nothing listens at the address."""


@dataclass(frozen=True, slots=True)
class ServerAddress:
    """Where a server is, and how it is spoken to.

    Attributes:
        url: ``http://HOST:PORT`` or ``https://HOST:PORT``.
        token: The operator's or a viewer's; None for a server without.
        certificate: The one to trust, PEM, whatever name it was made for; None trusts the usual authorities.
    """

    url: str
    token: str | None = None
    certificate: Path | None = None

    @classmethod
    def of(cls, settings: HttpSettings) -> ServerAddress:
        """Return where the server of these settings is, seen from its own machine."""
        host = _own(settings.host)
        host = f"[{host}]" if ":" in host else host
        scheme = "http" if settings.certificate is None else "https"
        token = settings.token.get_secret_value() if settings.token is not None else None
        return cls(f"{scheme}://{host}:{settings.port}", token, settings.certificate)


def _own(host: str) -> str:
    """Return where this machine reaches a server that listens at a host: of all addresses, the loopback's."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host  # a name
    return {4: "127.0.0.1", 6: "::1"}[address.version] if address.is_unspecified else host


def call(
    address: ServerAddress, method: Literal["GET", "POST", "PUT"], path: str, *, body: Any = None, within_s: float = 2.0
) -> Any:
    """Return the JSON document that the server answers with.

    Args:
        address: The server.
        method: What to do...
        path: ...with what, such as ``/api/v1/state``.
        body: Is sent as JSON; None sends nothing.
        within_s: Longest wait for the answer.

    Raises:
        ConfigError: The URL is none of HTTP, or the certificate cannot be read.
        NoServerError: Nothing listens there.
        LinkError: What answers refuses, or is no server of ours.
    """
    url = f"{address.url.rstrip('/')}{path}"
    if not url.startswith(("http://", "https://")):
        raise ConfigError(f"{address.url}: expected http://HOST:PORT or https://HOST:PORT")
    if address.token is not None and not (address.token.isascii() and address.token.isalnum()):
        raise ConfigError("the token: expected ASCII letters and digits only")
    headers = {"Authorization": f"Bearer {address.token}"} if address.token else {}
    try:
        data = json.dumps(body).encode() if body is not None else None
        headers |= {"Content-Type": "application/json"} if data is not None else {}
        request = urllib.request.Request(url, data, headers, method=method)  # noqa: S310 - checked above
        with _opener(address).open(request, timeout=within_s) as answer:
            return json.loads(answer.read())
    except urllib.error.HTTPError as error:
        with error:
            advice = f" ({_UNAUTHORIZED})" if error.code == HTTPStatus.UNAUTHORIZED else ""
            raise LinkError(f"{url} answers {error.code}: {_detail(error.read())}{advice}") from error
    except (ValueError, http.client.HTTPException) as error:
        raise LinkError(f"{url} is no ReVNM server: {error}") from error
    except OSError as error:  # URLError is one
        reason = error.reason if isinstance(error, urllib.error.URLError) else error
        kind = NoServerError if isinstance(reason, ConnectionRefusedError) else LinkError
        raise kind(f"{url}: {reason}") from error


def _opener(address: ServerAddress) -> urllib.request.OpenerDirector:
    direct = urllib.request.ProxyHandler({})  # the server is near
    if address.url.startswith("http://"):  # reading the usual authorities takes longer than the call
        return urllib.request.build_opener(direct, _Nowhere())
    try:
        context = ssl.create_default_context(cafile=address.certificate)
    except OSError as error:
        raise ConfigError(f"certificate {address.certificate}: {error}") from error
    context.check_hostname = address.certificate is None
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # the certificate itself, not the authority behind it
    return urllib.request.build_opener(direct, _Nowhere(), urllib.request.HTTPSHandler(context=context))


class _Nowhere(urllib.request.HTTPRedirectHandler):
    """Follows no redirect: the token is for the server that was asked."""

    def redirect_request(self, *_: Any) -> None:
        return None


def _detail(problem: bytes) -> str:
    """Return what a problem document (RFC 9457) says."""
    try:
        return str(json.loads(problem)["detail"])
    except (ValueError, KeyError, TypeError):
        return problem[:200].decode(errors="replace")
