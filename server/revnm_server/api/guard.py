"""Who may speak to the server: everyone who reaches it, or who knows the token.

A plain ASGI middleware, since streams pass through it.
"""

from __future__ import annotations

import hmac
from urllib.parse import parse_qs, urlsplit

from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from revnm_server.api.problems import problem
from revnm_server.settings import is_loopback

MAX_BODY_BYTES = 16_384
COOKIE = "revnm_token"
_OPEN_PATHS = ("/healthz",)
_SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
_SECURITY_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cache-control": "no-store",
}


class Guard:
    """Checks origin, body size and token before the application sees a request.

    Args:
        app: The application.
        token: Asked of everyone, as ``Authorization: Bearer``, as ``?token=`` or in the page's cookie; None
            asks nothing.
        local_names_only: Answer to names of this machine only, so that no web page elsewhere can reach the
            server under a name of its own (DNS rebinding).
    """

    def __init__(self, app: ASGIApp, *, token: str | None, local_names_only: bool) -> None:
        self._app = app
        self._token = token
        self._local_names_only = local_names_only

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope, Headers(scope=scope))
        if refusal is None:
            await self._app(scope, receive, _with_headers(send, self._cookie(scope)))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": refusal[1]})
        else:
            status, detail = refusal
            headers = {"WWW-Authenticate": "Bearer"} if status == 401 else None
            await problem(status, detail, headers=headers)(scope, receive, _with_headers(send, None))

    def _refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        if scope["path"] in _OPEN_PATHS:
            return None
        host = headers.get("host", "")
        if self._local_names_only and not _is_local(host):
            return 421, "this server answers to names of its own machine only"
        origin = headers.get("origin")
        safe = scope["type"] == "http" and scope["method"] in _SAFE_METHODS
        if origin is not None and not safe and not _is_same_site(origin, host):
            return 403, "a page of another site may not do this"
        if scope["type"] == "http" and not safe:
            refusal = _body_refusal(headers)
            if refusal is not None:
                return refusal
        if self._token is not None and not any(_same(self._token, given) for given in _given(scope, headers)):
            return 401, "a token is needed: as Authorization: Bearer, or for the page as ?token="
        return None

    def _cookie(self, scope: Scope) -> str | None:
        """Return the cookie that lets the page's own requests through, where the page is opened."""
        if self._token is None or scope["type"] != "http" or scope["path"] != "/":
            return None
        return f"{COOKIE}={self._token}; Path=/; HttpOnly; SameSite=Strict"


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


def _body_refusal(headers: Headers) -> tuple[int, str] | None:
    if "transfer-encoding" in headers:
        return 411, "the length of the body must be told"
    length = headers.get("content-length", "0")
    if not length.isdecimal() or len(length) > 12 or int(length) > MAX_BODY_BYTES:
        return 413, f"the body may have {MAX_BODY_BYTES} bytes"
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
