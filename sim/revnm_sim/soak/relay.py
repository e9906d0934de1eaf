"""The network between the robot and the server: a TCP relay that can be cut, stopped up and slowed down."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable, Coroutine
from typing import Any, Self

_CHUNK = 1 << 16
_WAITING = 64  # chunks; then the sender is held up


class Relay:
    """Passes connections on to another address, from a thread of its own; a context manager.

    Args:
        address: HOST:PORT at which it listens.
        target: HOST:PORT to which it passes them on.
    """

    def __init__(self, address: str, target: str) -> None:
        self._address, self._target = _parts(address), _parts(target)
        self._delay_s = 0.0
        self._server: asyncio.Server | None = None
        self._open = asyncio.Event()
        self._open.set()
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="relay")

    def __enter__(self) -> Self:
        self._thread.start()
        self._await(self._listen())
        return self

    def __exit__(self, *_: object) -> None:
        self._await(self._close())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def refuse(self) -> None:
        """Break all connections and refuse new ones."""
        self._await(self._shut())

    def stop_up(self) -> None:
        """Let nothing through; connections stay."""
        self._call(self._open.clear)

    def delay(self, delay_s: float) -> None:
        """Let everything through so much later, both ways."""
        self._delay_s = delay_s

    def mend(self) -> None:
        """Pass everything on at once again."""
        self._delay_s = 0.0
        self._call(self._open.set)
        self._await(self._listen())

    def _await(self, work: Coroutine[Any, Any, None]) -> None:
        asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _call(self, action: Callable[[], None]) -> None:
        self._loop.call_soon_threadsafe(action)

    async def _listen(self) -> None:
        if self._server is None:
            self._server = await asyncio.start_server(self._serve, *self._address)

    async def _shut(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in self._writers:
            writer.transport.abort()

    async def _close(self) -> None:
        await self._shut()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            with contextlib.suppress(OSError):
                await self._connect(reader, writer)
        finally:
            self._writers.discard(writer)
            writer.transport.abort()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Pass both ways on until one ends."""
        far_reader, far_writer = await asyncio.open_connection(*self._target)
        ways = [self._pass_on(reader, far_writer), self._pass_on(far_reader, writer)]
        tasks = [asyncio.ensure_future(way) for way in ways]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            far_writer.transport.abort()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        chunks: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(_WAITING)
        writing = asyncio.ensure_future(self._write(chunks, writer))
        try:
            while data := await reader.read(_CHUNK):
                await chunks.put((self._loop.time() + self._delay_s, data))
            await chunks.put((0.0, b""))
            await writing
        finally:
            writing.cancel()

    async def _write(self, chunks: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter) -> None:
        while True:
            due_s, data = await chunks.get()
            await asyncio.sleep(due_s - self._loop.time())
            await self._open.wait()
            if not data:
                return
            writer.write(data)
            await writer.drain()


def _parts(address: str) -> tuple[str, int]:
    host, _, port = address.rpartition(":")
    return host, int(port)
