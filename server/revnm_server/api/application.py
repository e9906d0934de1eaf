"""Puts the HTTP application together."""

from __future__ import annotations

from importlib.metadata import version
from importlib.resources import files

from fastapi import APIRouter, FastAPI, HTTPException, Response

from revnm_server.api import problems
from revnm_server.api.guard import Guard
from revnm_server.api.health import health_router
from revnm_server.api.live import live_router
from revnm_server.api.recording import recording_router
from revnm_server.api.robots import robots_router
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings

_PAGE = {
    "index.html": "text/html; charset=utf-8",
    "app.js": "text/javascript; charset=utf-8",
    "overlay.js": "text/javascript; charset=utf-8",
    "style.css": "text/css; charset=utf-8",
}


def create_application(service: NavigationService, settings: HttpSettings) -> FastAPI:
    """Return the application: page, API, health, all behind the guard.

    Args:
        service: Does the work.
        settings: The token, and whether only this machine is served.
    """
    app = FastAPI(
        title="ReVNM server",
        version=version("revnm-server"),
        summary="A camera on the wall guides robots without cameras: click a pixel, the robot drives there.",
        docs_url=None,
        redoc_url=None,
        openapi_url="/api/v1/openapi.json",
    )
    problems.install(app)
    app.include_router(robots_router(service))
    app.include_router(live_router(service))
    app.include_router(recording_router(service))
    app.include_router(health_router(service))
    app.include_router(_page_router())
    token = settings.token.get_secret_value() if settings.token is not None else None
    app.add_middleware(Guard, token=token, local_names_only=settings.loopback and token is None)
    return app


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
