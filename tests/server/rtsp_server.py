"""A small RTSP server for tests: H.264 over RTP inside the RTSP connection (RFC 2326, RFC 6184)."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Self

import av
import numpy as np
from numpy.typing import NDArray

_CLOCK_HZ = 90_000
_MTU = 1400
_METHODS = "OPTIONS, DESCRIBE, SETUP, PLAY, GET_PARAMETER, TEARDOWN"

Picture = NDArray[np.uint8]


class RtspServer:
    """Serves one stream at ``url``; whoever connects sees it from now on.

    Args:
        picture: Gives the (H, W, 3) RGB picture of a frame's number.
        fps: Frames a second.
    """

    def __init__(self, picture: Callable[[int], Picture], *, fps: int = 15) -> None:
        self._picture = picture
        self._fps = fps
        self._closing = threading.Event()
        self._flowing = threading.Event()
        self._flowing.set()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._connections: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept, daemon=True)]
        self.connected = 0
        self._threads[0].start()

    @property
    def url(self) -> str:
        """Where the stream is, with credentials that nobody checks."""
        return f"rtsp://viewer:s3cret@127.0.0.1:{self._listener.getsockname()[1]}/stream"

    def freeze(self) -> None:
        """Send nothing more, and keep the connections."""
        self._flowing.clear()

    def thaw(self) -> None:
        """Send again."""
        self._flowing.set()

    def drop(self) -> None:
        """Close all connections; new ones are served."""
        while self._connections:
            connection = self._connections.pop()
            with contextlib.suppress(OSError):  # the client was faster
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()

    def close(self) -> None:
        """Stop serving."""
        self._closing.set()
        self._flowing.set()
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.drop()
        for thread in self._threads:
            thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _accept(self) -> None:
        while not self._closing.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self.connected += 1
            self._connections.append(connection)
            thread = threading.Thread(target=self._serve, args=(connection,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def _serve(self, connection: socket.socket) -> None:
        try:
            with connection, connection.makefile("rb") as requests:
                for method, sequence in _requests(requests):
                    connection.sendall(_answer(method, sequence, self.url))
                    if method == "PLAY":
                        self._stream(connection)
        except OSError:
            pass  # dropped

    def _stream(self, connection: socket.socket) -> None:
        first = self._picture(0)
        encoder = _encoder(first.shape[1], first.shape[0], self._fps)
        sequence = 0
        for index in range(1_000_000):
            self._closing.wait(1.0 / self._fps)
            self._flowing.wait()
            if self._closing.is_set():
                return
            frame = av.VideoFrame.from_ndarray(self._picture(index), format="rgb24").reformat(format="yuv420p")
            frame.pts = index
            for packet in encoder.encode(frame):
                stamp = index * _CLOCK_HZ // self._fps
                for payload, last in _payloads(bytes(packet)):
                    header = struct.pack("!BBHII", 0x80, 96 | (0x80 if last else 0), sequence, stamp, 0x1234)
                    data = header + payload
                    connection.sendall(b"$\x00" + struct.pack("!H", len(data)) + data)
                    sequence = (sequence + 1) % 65536


def _requests(lines: Iterator[bytes]) -> Iterator[tuple[str, str]]:
    """Yield method and CSeq of each request."""
    method, sequence = "", "0"
    for raw in lines:
        line = raw.decode("latin-1").strip()
        if not method:
            method = line.split(" ")[0]
        elif line.lower().startswith("cseq:"):
            sequence = line.partition(":")[2].strip()
        elif not line:
            yield method, sequence
            method = ""


def _answer(method: str, sequence: str, url: str) -> bytes:
    headers, body = [f"CSeq: {sequence}", "Session: 1"], ""
    if method == "OPTIONS":
        headers.append(f"Public: {_METHODS}")
    elif method == "DESCRIBE":
        body = (
            "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=test\r\nt=0 0\r\nm=video 0 RTP/AVP 96\r\n"
            f"a=rtpmap:96 H264/{_CLOCK_HZ}\r\na=fmtp:96 packetization-mode=1\r\na=control:track\r\n"
        )
        headers += [f"Content-Base: {url}/", "Content-Type: application/sdp", f"Content-Length: {len(body)}"]
    elif method == "SETUP":
        headers.append("Transport: RTP/AVP/TCP;unicast;interleaved=0-1")
    return ("RTSP/1.0 200 OK\r\n" + "\r\n".join(headers) + "\r\n\r\n" + body).encode()


def _encoder(width: int, height: int, fps: int) -> av.VideoCodecContext:
    encoder = av.CodecContext.create("libx264", "w")
    assert isinstance(encoder, av.VideoCodecContext)
    encoder.width, encoder.height, encoder.pix_fmt = width, height, "yuv420p"
    encoder.framerate, encoder.time_base = Fraction(fps), Fraction(1, fps)
    encoder.thread_count = 1
    parameters = f"repeat-headers=1:keyint={fps}:annexb=1"
    encoder.options = {"preset": "ultrafast", "tune": "zerolatency", "crf": "18", "x264-params": parameters}
    return encoder


def _payloads(packet: bytes) -> Iterator[tuple[bytes, bool]]:
    """Yield RTP payloads, and whether each is the last of its frame; big NAL units as FU-A."""
    units = [
        unit.rstrip(b"\x00") for unit in packet.replace(b"\x00\x00\x00\x01", b"\x00\x00\x01").split(b"\x00\x00\x01")
    ]
    units = [unit for unit in units if unit]
    for number, unit in enumerate(units):
        last_unit = number == len(units) - 1
        if len(unit) <= _MTU:
            yield unit, last_unit
            continue
        indicator, kind = (unit[0] & 0xE0) | 28, unit[0] & 0x1F
        pieces = [unit[start : start + _MTU] for start in range(1, len(unit), _MTU)]
        for index, piece in enumerate(pieces):
            last = index == len(pieces) - 1
            flags = (0x80 if index == 0 else 0) | (0x40 if last else 0)
            yield bytes([indicator, flags | kind]) + piece, last_unit and last
