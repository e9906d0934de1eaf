"""Puts the HTTP application together."""

from __future__ import annotations

from importlib.metadata import version
from importlib.resources import files

from fastapi import APIRouter, FastAPI, HTTPException, Response

from revnm_server.api import problems
from revnm_server.api.document import DocumentedApplication
from revnm_server.api.guard import Guard, Role
from revnm_server.api.health import health_router
from revnm_server.api.live import live_router
from revnm_server.api.recording import recording_router
from revnm_server.api.robots import robots_router
from revnm_server.api.session import session_router
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings

_SCRIPTS = ("app", "floor", "inset", "overlay", "panel", "picker", "server", "stream")
_PAGE = {
    "index.html": "text/html; charset=utf-8",
    "style.css": "text/css; charset=utf-8",
    **{f"{name}.js": "text/javascript; charset=utf-8" for name in _SCRIPTS},
}


def create_application(service: NavigationService, settings: HttpSettings) -> FastAPI:
    """Return the application: page, API, health, all behind the guard.

    Args:
        service: Does the work.
        settings: The tokens, and whether only this machine is served.
    """
    roles = _roles(settings)
    app = DocumentedApplication(version("revnm-server"), guarded=bool(roles))
    problems.install(app)
    for router in (
        robots_router(service),
        live_router(service),
        recording_router(service),
        health_router(service),
        session_router(),
    ):
        app.include_router(router)
    app.include_router(_page_router())
    app.add_middleware(
        Guard,
        roles=roles,
        encrypted=settings.certificate is not None,
        local_names_only=settings.loopback and not roles,
    )
    return app


def _roles(settings: HttpSettings) -> dict[str, Role]:
    given = {Role.OPERATOR: settings.token, Role.VIEWER: settings.viewer_token}
    return {token.get_secret_value(): role for role, token in given.items() if token is not None}


def _page_router() -> APIRouter:
    router = APIRouter(include_in_schema=False)
    folder = files("revnm_server").joinpath("page")
    contents = {name: folder.joinpath(name).read_bytes() for name in _PAGE}

    @router.get("/")
    async def index() -> Response:
        return Response(contents["index.html"], media_type=_PAGE["index.html"])

    @router.get("/page/{name}")
    async def asset(name: str) -> Response:
        if name not in contents:
            raise HTTPException(404)
        return Response(contents[name], media_type=_PAGE[name])

    return router
