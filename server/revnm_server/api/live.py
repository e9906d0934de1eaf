"""What changes all the time: state, events, pictures."""

from __future__ import annotations

import asyncio
import threading
from typing import Annotated, Any, Literal

from fastapi import APIRouter, HTTPException, Query, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import StreamingResponse
from starlette.concurrency import run_in_threadpool

from revnm_server.api.between_ticks import BetweenTicks
from revnm_server.api.pictures import MEDIA_TYPE, Layers, SharedPictures
from revnm_server.api.problems import responses
from revnm_server.api.shared_state import PERIOD_S, SharedState
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.frame import Frame
from revnm_server.service import NavigationService
from revnm_server.views.view import ServerView

_SEND_S = 5.0
_NO_PICTURE = "the camera has not given a picture yet"
_FRAME: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "A JPEG, as large as the camera's pictures.",
        "content": {"image/jpeg": {}},
        "headers": {
            "X-Frame-Seq": {"description": "Its number.", "schema": {"type": "integer"}},
            "X-Frame-Stamp-Ns": {
                "description": "When it was taken: nanoseconds since the epoch, server's clock.",
                "schema": {"type": "integer"},
            },
        },
    },
    **responses({409: "The camera has not given a picture yet."}),
}
_STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "JPEGs, each with when it was taken in X-Frame-Stamp-Ms, as a browser's <img> shows them.",
        "content": {MEDIA_TYPE: {}},
    },
    **responses(
        {
            404: "There is no robot of that name.",
            409: "There is no such picture now: the detail says why.",
            422: "There is no such layer, or ego without a robot.",
        }
    ),
}


def live_router(service: NavigationService) -> APIRouter:
    """Return the routes for state, events and pictures."""
    router = APIRouter(prefix="/api/v1", tags=["live"])
    between_ticks = BetweenTicks(service.ticking)
    shared, layers, whole = SharedState(service), Layers(service, between_ticks), _WholeFrame()

    @router.get("/state", response_model=ServerView)
    async def state() -> Response:
        """Return everything that the page shows, at most 0.1 s old."""
        await between_ticks.wait()
        return Response(shared.document(), media_type="application/json")

    @router.websocket("/events")
    async def events(socket: WebSocket) -> None:
        """Send the state ten times a second."""
        await socket.accept()
        gone = asyncio.create_task(_disconnected(socket))
        try:
            while not (gone.done() or service.closing):
                await between_ticks.wait()
                await asyncio.wait_for(socket.send_text(shared.document().decode()), _SEND_S)
                await asyncio.wait({gone}, timeout=PERIOD_S)
            if not gone.done():
                await socket.close(1001)
        except (WebSocketDisconnect, TimeoutError, OSError, RuntimeError):
            pass  # the client has gone
        finally:
            gone.cancel()

    @router.get("/frame.jpg", response_class=Response, responses=_FRAME)
    async def frame_jpg() -> Response:
        """Return the newest picture, however old: see the camera's state."""
        frame = service.camera.latest()
        if frame is None:
            raise HTTPException(409, _NO_PICTURE)
        data = await run_in_threadpool(whole.jpeg, frame)
        headers = {"X-Frame-Seq": str(frame.seq), "X-Frame-Stamp-Ns": str(frame.stamp_ns)}
        return Response(data, media_type="image/jpeg", headers=headers)

    @router.get("/stream.mjpg", response_class=Response, responses=_STREAM)
    async def stream_mjpg(
        layer: Annotated[Literal["exo", "depth", "ego", "map"], Query(description="What to show.")] = "exo",
        robot: Annotated[str | None, Query(max_length=32, description="Whose view: for ``ego``.")] = None,
    ) -> StreamingResponse:
        """Stream pictures, at most ten a second, at most 1024 pixels wide.

        ``exo`` is the camera's own, ``depth`` how near its things are, ``map`` the floor from above, and ``ego`` what
        ``robot`` is thought to see.
        """
        pictures, missing = _chosen(service, layers, layer, robot)
        if not pictures.available:
            raise HTTPException(409, missing)
        return StreamingResponse(pictures.parts(), media_type=MEDIA_TYPE)

    return router


def _chosen(
    service: NavigationService, layers: Layers, layer: Literal["exo", "depth", "ego", "map"], robot: str | None
) -> tuple[SharedPictures, str]:
    """Return a layer, and what to say where it has no picture."""
    if layer == "exo":
        return layers.exo, _NO_PICTURE
    if layer == "depth":
        return layers.depth, "there is no depth picture: no picture was processed yet"
    if layer == "map":
        return layers.map, "there is no map: no picture came yet, or the planner makes none"
    if robot is None:
        raise HTTPException(422, "layer=ego needs robot=NAME")
    service.mission.of(robot)
    return layers.ego[robot], f"{robot} has no imagined view: it is made while a learnt policy leads it on the map"


async def _disconnected(socket: WebSocket) -> None:
    """Return when the client has gone; what it sends is not looked at."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


class _WholeFrame:
    """Encodes each picture of the camera once in its full size, however many ask for it. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seq = -1
        self._jpeg = b""

    def jpeg(self, frame: Frame) -> bytes:
        with self._lock:
            if frame.seq != self._seq:
                self._jpeg, self._seq = encode_jpeg(frame.image), frame.seq
            return self._jpeg
