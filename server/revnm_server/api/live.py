"""What changes all the time: state, events, pictures."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from typing import Annotated, Literal

from fastapi import APIRouter, HTTPException, Query, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import StreamingResponse
from pydantic import TypeAdapter
from starlette.concurrency import run_in_threadpool

from revnm_server.api.problems import responses
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.frame import Frame
from revnm_server.service import NavigationService
from revnm_server.view import ServerView

_PERIOD_S = 0.1
_SEND_S = 5.0
_BOUNDARY = "frame"


class _Encoder:
    """Encodes each picture once, however many look at it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seq = -1
        self._jpeg = b""

    def jpeg(self, frame: Frame) -> bytes:
        with self._lock:
            if frame.seq != self._seq:
                self._jpeg, self._seq = encode_jpeg(frame.image), frame.seq
            return self._jpeg


def live_router(service: NavigationService) -> APIRouter:
    """Return the routes for state, events and pictures."""
    router = APIRouter(prefix="/api/v1", tags=["live"])
    encoder = _Encoder()
    view_adapter = TypeAdapter(ServerView)

    @router.get("/state", responses=responses(401))
    async def state() -> ServerView:
        """Return everything that the page shows."""
        return service.view()

    @router.websocket("/events")
    async def events(socket: WebSocket) -> None:
        """Send the state ten times a second."""
        await socket.accept()
        gone = asyncio.create_task(_disconnected(socket))
        try:
            while not (gone.done() or service.closing):
                text = view_adapter.dump_json(service.view()).decode()
                await asyncio.wait_for(socket.send_text(text), _SEND_S)
                await asyncio.wait({gone}, timeout=_PERIOD_S)
            if not gone.done():
                await socket.close(1001)
        except (WebSocketDisconnect, TimeoutError, OSError, RuntimeError):
            pass  # the client has gone
        finally:
            gone.cancel()

    @router.get("/frame.jpg", response_class=Response, responses=responses(401, 409))
    async def frame_jpg() -> Response:
        """Return the newest picture, however old: see the camera's state."""
        frame = service.camera.latest()
        if frame is None:
            raise HTTPException(409, "the camera has not given a picture yet")
        data = await run_in_threadpool(encoder.jpeg, frame)
        headers = {"X-Frame-Seq": str(frame.seq), "X-Frame-Stamp-Ns": str(frame.stamp_ns)}
        return Response(data, media_type="image/jpeg", headers=headers)

    @router.get("/stream.mjpg", response_class=Response, responses=responses(401, 422))
    async def stream_mjpg(layer: Annotated[Literal["exo"], Query()] = "exo") -> StreamingResponse:  # noqa: ARG001
        """Stream pictures, at most ten a second; ``exo`` is the camera's own."""
        return StreamingResponse(
            _parts(service, encoder), media_type=f"multipart/x-mixed-replace; boundary={_BOUNDARY}"
        )

    return router


async def _disconnected(socket: WebSocket) -> None:
    """Return when the client has gone; what it sends is not looked at."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


async def _parts(service: NavigationService, encoder: _Encoder) -> AsyncIterator[bytes]:
    seq = -1
    while not service.closing:
        frame = service.camera.latest()
        if frame is not None and frame.seq != seq:
            seq = frame.seq
            data = await run_in_threadpool(encoder.jpeg, frame)
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            yield head.encode() + data + b"\r\n"
        await asyncio.sleep(_PERIOD_S)
