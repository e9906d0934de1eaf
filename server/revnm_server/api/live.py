"""What changes all the time: state, events, pictures."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Literal, NamedTuple

import numpy as np
from fastapi import APIRouter, HTTPException, Query, Response, WebSocket, WebSocketDisconnect
from fastapi.responses import StreamingResponse
from numpy.typing import NDArray
from pydantic import TypeAdapter
from starlette.concurrency import run_in_threadpool

from revnm_server.api.problems import responses
from revnm_server.camera.jpeg import encode_jpeg
from revnm_server.map_picture import map_picture
from revnm_server.service import NavigationService
from revnm_server.view import ServerView

_PERIOD_S = 0.1
_SEND_S = 5.0
_BOUNDARY = "frame"


class _Picture(NamedTuple):
    """A picture that may have to be encoded: its number among those of its layer, and what gives it (h, w, 3)."""

    number: int
    draw: Callable[[], NDArray[np.uint8]]


class _Encoder:
    """Encodes each picture of a layer once, however many look at it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._number = -1
        self._jpeg = b""

    def jpeg(self, picture: _Picture) -> bytes:
        with self._lock:
            if picture.number != self._number:
                self._jpeg, self._number = encode_jpeg(picture.draw()), picture.number
            return self._jpeg


class _Layer:
    """What the camera shows (``exo``), or the map that was made of it (``map``)."""

    def __init__(self, service: NavigationService, name: Literal["exo", "map"]) -> None:
        self.encoder = _Encoder()
        self._service = service
        self.newest = self._seen if name == "exo" else self._mapped

    @property
    def closing(self) -> bool:
        """Whether no more pictures are to be sent."""
        return self._service.closing

    def _seen(self) -> _Picture | None:
        frame = self._service.camera.latest()
        return _Picture(frame.seq, lambda: frame.image) if frame is not None else None

    def _mapped(self) -> _Picture | None:
        report = self._service.site()
        return _Picture(report.stamp_ns, lambda: map_picture(report)) if report is not None else None


def live_router(service: NavigationService) -> APIRouter:
    """Return the routes for state, events and pictures."""
    router = APIRouter(prefix="/api/v1", tags=["live"])
    layers = {"exo": _Layer(service, "exo"), "map": _Layer(service, "map")}
    view_adapter = TypeAdapter(ServerView)

    @router.get("/state")
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

    @router.get("/frame.jpg", response_class=Response, responses=responses(409))
    async def frame_jpg() -> Response:
        """Return the newest picture, however old: see the camera's state."""
        frame = service.camera.latest()
        if frame is None:
            raise HTTPException(409, "the camera has not given a picture yet")
        data = await run_in_threadpool(layers["exo"].encoder.jpeg, _Picture(frame.seq, lambda: frame.image))
        headers = {"X-Frame-Seq": str(frame.seq), "X-Frame-Stamp-Ns": str(frame.stamp_ns)}
        return Response(data, media_type="image/jpeg", headers=headers)

    @router.get("/stream.mjpg", response_class=Response, responses=responses(409, 422))
    async def stream_mjpg(layer: Annotated[Literal["exo", "map"], Query()] = "exo") -> StreamingResponse:
        """Stream pictures, at most ten a second: ``exo`` is the camera's own, ``map`` the floor from above."""
        if layer == "map" and service.site() is None:
            raise HTTPException(409, "there is no map: no picture came yet, or the planner makes none")
        media_type = f"multipart/x-mixed-replace; boundary={_BOUNDARY}"
        return StreamingResponse(_parts(layers[layer]), media_type=media_type)

    return router


async def _disconnected(socket: WebSocket) -> None:
    """Return when the client has gone; what it sends is not looked at."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


async def _parts(layer: _Layer) -> AsyncIterator[bytes]:
    number = -1
    while not layer.closing:
        picture = layer.newest()
        if picture is not None and picture.number != number:
            number = picture.number
            data = await run_in_threadpool(layer.encoder.jpeg, picture)
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
            yield head.encode() + data + b"\r\n"
        await asyncio.sleep(_PERIOD_S)
