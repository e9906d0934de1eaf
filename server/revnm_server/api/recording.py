"""The run record over HTTP: whether it is written, and the switch for it."""

from __future__ import annotations

from fastapi import APIRouter

from revnm_server.api.problems import responses
from revnm_server.recording.errors import RecordingError
from revnm_server.service import NavigationService
from revnm_server.tick.tick_recorder import TickRecorder
from revnm_server.views.view import RecordingView

_NO_RECORD = {409: "It cannot be done now: the detail says why."}


def recording_router(service: NavigationService) -> APIRouter:
    """Return the routes under ``/api/v1/recording``.

    Those that switch are plain functions, which FastAPI runs in threads: they wait for the disk.
    """
    router = APIRouter(prefix="/api/v1/recording", tags=["recording"])

    def recorder() -> TickRecorder:
        if service.recorder is None:
            raise RecordingError("this server was put together without a recorder")
        return service.recorder

    @router.get("", responses=responses(_NO_RECORD))
    async def recording() -> RecordingView:
        """Tell of the record that is being written, or of the last one."""
        return recorder().view()

    @router.post("/start", responses=responses(_NO_RECORD))
    def start() -> RecordingView:
        """Begin a record; where one is being written, it goes on."""
        return recorder().start()

    @router.post("/stop", responses=responses(_NO_RECORD))
    def stop() -> RecordingView:
        """End the record: its file is complete when this answers."""
        return recorder().stop()

    return router
