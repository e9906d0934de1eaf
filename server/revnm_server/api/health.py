"""Health for whoever runs the server: the process, and whether it could drive."""

from __future__ import annotations

from fastapi import APIRouter, Response
from pydantic import BaseModel

from revnm_server.api.problems import problem, responses
from revnm_server.service import NavigationService


class Health(BaseModel):
    """An answer that all is well."""

    status: str


def health_router(service: NavigationService) -> APIRouter:
    """Return ``/healthz`` and ``/readyz``."""
    router = APIRouter(tags=["health"])

    @router.get("/healthz")
    async def healthz() -> Health:
        """Say that the process answers; asks for no token."""
        return Health(status="ok")

    @router.get("/readyz", response_model=Health, responses=responses(503))
    async def readyz() -> Health | Response:
        """Say whether the camera is fresh, the models work and a robot reports; else why not."""
        reasons = service.view().reasons
        if reasons:
            return problem(503, "; ".join(reasons), reasons=reasons)
        return Health(status="ready")

    return router
