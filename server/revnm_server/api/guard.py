"""Who may speak to the server: everyone who reaches it, or who knows a token, each in a role.

A plain ASGI middleware, since streams pass through it.
"""

from __future__ import annotations

import hmac
import re
from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from revnm_server.api.problems import problem
from revnm_server.settings import is_loopback

MAX_BODY_BYTES = 16_384
COOKIE = "revnm_token"
REFUSALS = {
    401: "No token came, or an unknown one.",
    403: "A page of another site asks, or a viewer's token came with what only operators may do.",
    411: "The length of the body is not told.",
    413: f"The body has more than {MAX_BODY_BYTES} bytes.",
    421: "The server serves its own machine only, and was called by a name that is not that machine's.",
}
"""What the guard itself answers, and when, by status."""

_OPEN_PATHS = ("/healthz",)
_SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
_STOP_PATH = re.compile(r"/api/v1/robots/[^/]+/stop")
_SECURITY_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
}


class Role(StrEnum):
    """What somebody may do."""

    VIEWER = "viewer"
    """Look, and stop robots: whoever sees one about to hit something shall be able to."""
    OPERATOR = "operator"
    """Everything."""


def least_role(method: str, path: str) -> Role | None:
    """Return who may make a request, besides operators; None asks for no token at all.

    Args:
        method: Of HTTP; a WebSocket is opened by GET.
        path: Of the request, or of a route.
    """
    if path in _OPEN_PATHS:
        return None
    return Role.VIEWER if method in _SAFE_METHODS or _STOP_PATH.fullmatch(path) else Role.OPERATOR


def refusals(method: str, path: str) -> Iterable[int]:
    """Return the statuses with which the guard may answer a request."""
    if least_role(method, path) is None:
        return ()
    return (401, 421) if method in _SAFE_METHODS else REFUSALS


class _Refusal(NamedTuple):
    status: int
    detail: str


class Guard:
    """Checks origin, body size and token before the application sees a request, and tells it the caller's role.

    The role is ``request.state.role``.

    Args:
        app: The application.
        roles: By token: one of them is asked of everyone, as ``Authorization: Bearer``, as ``?token=`` or in the page's
            cookie; empty asks nothing, and everyone is an operator.
        encrypted: The page comes by HTTPS: its cookie must not go by any other way.
        local_names_only: Answer to names of this machine only, so that no web page elsewhere can reach the
            server under a name of its own (DNS rebinding).
    """

    def __init__(
        self, app: ASGIApp, *, roles: Mapping[str, Role], encrypted: bool = False, local_names_only: bool = False
    ) -> None:
        self._app = app
        self._roles = dict(roles)
        self._encrypted = encrypted
        self._local_names_only = local_names_only

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        token = self._known_token(scope, headers)
        role = self._roles[token] if token is not None else None if self._roles else Role.OPERATOR
        refusal = self._refusal(scope, headers, role)
        if refusal is None:
            scope.setdefault("state", {})["role"] = role
            await self._app(scope, receive, _with_headers(send, self._cookie(scope, token)))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal.detail})
        else:
            challenge = {"WWW-Authenticate": "Bearer"} if refusal.status == 401 else None
            answer = problem(refusal.status, refusal.detail, headers=challenge)
            await answer(scope, receive, _with_headers(send, None))

    def _refusal(self, scope: Scope, headers: Headers, role: Role | None) -> _Refusal | None:
        method = scope.get("method", "GET")
        least = least_role(method, scope["path"])
        if least is None:
            return None
        host = headers.get("host", "")
        if self._local_names_only and not _is_local(host):
            return _Refusal(421, "this server answers to names of its own machine only")
        origin = headers.get("origin")
        safe = scope["type"] == "http" and method in _SAFE_METHODS
        if origin is not None and not safe and not _is_same_site(origin, host):
            return _Refusal(403, "a page of another site may not do this")
        if scope["type"] == "http" and not safe:
            refusal = _body_refusal(headers)
            if refusal is not None:
                return refusal
        if role is None:
            return _Refusal(401, "a token is needed: as Authorization: Bearer, or for the page as ?token=")
        if role is Role.VIEWER and least is Role.OPERATOR:
            return _Refusal(403, "a viewer's token may look, and stop robots: this needs the operator's")
        return None

    def _known_token(self, scope: Scope, headers: Headers) -> str | None:
        """Return the first token with the request that is one of ours; all are compared, in constant time."""
        given = _given(scope, headers)
        compared = [(ours, _same(ours, each)) for each in given for ours in self._roles]
        return next((ours for ours, same in compared if same), None)

    def _cookie(self, scope: Scope, token: str | None) -> str | None:
        """Return the cookie that lets the page's own requests through, where the page is opened."""
        if token is None or scope["type"] != "http" or scope["path"] != "/":
            return None
        secure = "; Secure" if self._encrypted else ""
        return f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict{secure}"


def _is_local(host: str) -> bool:
    """Whether a Host header names this machine; hostile ones cannot even be split."""
    try:
        return is_loopback(urlsplit(f"//{host}").hostname or "")
    except ValueError:
        return False


def _is_same_site(origin: str, host: str) -> bool:
    """Whether an Origin header names the host that the request went to."""
    try:
        return urlsplit(origin).netloc == host
    except ValueError:
        return False


def _body_refusal(headers: Headers) -> _Refusal | None:
    if "transfer-encoding" in headers:
        return _Refusal(411, "the length of the body must be told")
    length = headers.get("content-length", "0")
    if not length.isdecimal() or len(length) > 12 or int(length) > MAX_BODY_BYTES:
        return _Refusal(413, f"the body may have {MAX_BODY_BYTES} bytes")
    return None


def _given(scope: Scope, headers: Headers) -> list[str]:
    """Return every token that came with the request."""
    given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])[:1]
    scheme, _, bearer = headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer":
        given.append(bearer.strip())
    # As browsers do, not as http.cookies: it gives up at the odd cookies of other servers on this machine.
    cookie = cookie_parser(headers.get("cookie", "")).get(COOKIE)
    return [*given, cookie] if cookie is not None else given


def _same(token: str, given: str) -> bool:
    return hmac.compare_digest(token.encode(), given.encode())


def _with_headers(send: Send, cookie: str | None) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            extra = [(name.encode(), value.encode()) for name, value in _SECURITY_HEADERS.items()]
            if cookie is not None and message["status"] == 200:
                extra.append((b"set-cookie", cookie.encode()))
            message = {**message, "headers": [*message.get("headers", []), *extra]}
        await send(message)

    return send_with_headers
