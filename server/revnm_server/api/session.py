"""Who asks: the page shows what its visitor may do."""

from __future__ import annotations

from fastapi import APIRouter, Request
from pydantic import BaseModel

from revnm_server.api.guard import Role


class Session(BaseModel):
    """What the caller may do.

    Attributes:
        role: A viewer's or an operator's.
    """

    role: Role


def session_router() -> APIRouter:
    """Return ``/api/v1/session``."""
    router = APIRouter(prefix="/api/v1", tags=["session"])

    @router.get("/session")
    async def session(request: Request) -> Session:
        """Say what the caller's token lets it do: a viewer looks and may stop robots, an operator drives them."""
        return Session(role=request.state.role)

    return router
