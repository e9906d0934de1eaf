"""Health for whoever runs the server: the process, and whether it could drive."""

from __future__ import annotations

from fastapi import APIRouter, Response
from fastapi.responses import PlainTextResponse
from prometheus_client import CONTENT_TYPE_LATEST, generate_latest
from pydantic import BaseModel

from revnm_server.api.problems import problem, responses
from revnm_server.service import NavigationService
from revnm_server.views.metrics import metrics_registry


class Health(BaseModel):
    """An answer that all is well.

    Attributes:
        status: ``ok`` or ``ready``.
    """

    status: str


def health_router(service: NavigationService, *, lost_s: float = 10.0) -> APIRouter:
    """Return ``/healthz``, ``/readyz`` and ``/metrics``.

    Args:
        service: The server.
        lost_s: A tick that has been at one picture for longer will not end by itself.
    """
    router = APIRouter(tags=["health"])
    registry = metrics_registry(service)

    @router.get("/healthz", response_model=Health, responses=responses({503: "A tick hangs: start the server again."}))
    async def healthz() -> Health | Response:
        """Say whether the process works, or should be started again: it answers, and its tick does not hang.

        Asks for no token.
        """
        hangs_s = service.hangs_s()
        if hangs_s is not None and hangs_s > lost_s:
            return problem(503, f"the tick has been at one picture for {hangs_s:.0f} s")
        return Health(status="ok")

    @router.get(
        "/readyz", response_model=Health, responses=responses({503: "No goal would be driven to: see reasons."})
    )
    async def readyz() -> Health | Response:
        """Say whether the camera is fresh, the models work and a robot reports; else why not."""
        reasons = service.view().reasons
        if reasons:
            return problem(503, "; ".join(reasons), reasons=reasons)
        return Health(status="ready")

    @router.get("/metrics", response_class=PlainTextResponse)
    def metrics() -> Response:
        """Return metrics in Prometheus' text format."""
        return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)

    return router
