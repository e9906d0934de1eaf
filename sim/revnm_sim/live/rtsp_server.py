"""An IP camera made of software: H.264 inside the RTSP connection (RFC 2326), with the faults that real ones have.

One thread accepts, one a connection answers requests, one a viewer encodes: a slow viewer skips pictures and delays
nobody. Not there: UDP, TLS, digest authentication, sound.
"""

from __future__ import annotations

import base64
import contextlib
import hmac
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from io import BufferedIOBase
from typing import Self

from revnm_client.errors import ConfigError
from revnm_sim.live.h264_rtp import CLOCK_HZ, PAYLOAD_TYPE, H264Encoder, Picture, RtpStream, size_px

_METHODS = "OPTIONS, DESCRIBE, SETUP, PLAY, GET_PARAMETER, TEARDOWN"
_LONGEST_LINE = 4096
_MOST_HEADERS = 64


class Fault(StrEnum):
    """What is wrong with the camera."""

    NONE = "none"
    """Nothing."""
    FROZEN = "frozen"
    """It answers, and sends no picture."""
    REFUSED = "refused"
    """Nothing listens at its port."""
    BLACKHOLE = "blackhole"
    """It accepts connections and says nothing."""
    WRONG_CODEC = "wrong_codec"
    """It announces H.265 and sends H.264."""


class RtspServer:
    """Serves the pictures that it is shown.

    Args:
        address: Host and port to listen at; port 0 is a free one.
        fps: About how many pictures a second are shown.
        login: User and password (basic authentication); None lets anyone see.

    Raises:
        ConfigError: The address cannot be had.

    Attributes:
        connected: How many connections there have been.
    """

    def __init__(
        self, *, address: tuple[str, int] = ("127.0.0.1", 0), fps: float = 15.0, login: tuple[str, str] | None = None
    ) -> None:
        self.connected = 0
        self._fps, self._login, self._fault = fps, login, Fault.NONE
        self._changed = threading.Condition()  # guards what follows
        self._picture: tuple[Picture, int] | None = None  # and when it was taken, monotonic clock, nanoseconds
        self._connections: set[socket.socket] = set()
        self._closed = False
        self._threads: list[threading.Thread] = []
        self._listen(address)

    @property
    def url(self) -> str:
        """Where the stream is, credentials included."""
        user = f"{self._login[0]}:{self._login[1]}@" if self._login is not None else ""
        host, port = self._address
        return f"rtsp://{user}{f'[{host}]' if ':' in host else host}:{port}/stream"

    def show(self, picture: Picture, *, taken_ns: int | None = None) -> None:
        """Send a picture to whoever watches.

        Args:
            picture: (H, W, 3) RGB or (H·3/2, W) YUV 4:2:0 planar, sides even; it must not be changed afterwards.
            taken_ns: When it was taken, monotonic clock, later than the one before; None is now.
        """
        with self._changed:
            self._picture = picture, time.monotonic_ns() if taken_ns is None else taken_ns
            self._changed.notify_all()

    def set_fault(self, fault: Fault) -> None:
        """Break in this way from now on, or be whole again."""
        with self._changed:
            before, self._fault = self._fault, fault
            self._changed.notify_all()
        if fault is Fault.REFUSED:
            _shut(self._listener)
        if fault in (Fault.REFUSED, Fault.WRONG_CODEC) or before is Fault.WRONG_CODEC:
            self.drop()  # a camera whose codec was changed begins anew
        if before is Fault.REFUSED:
            self._listen(self._address)

    def drop(self) -> None:
        """Close all connections; new ones are served."""
        with self._changed:
            connections = list(self._connections)
        for connection in connections:
            _shut(connection)

    def close(self) -> None:
        """Stop serving."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        _shut(self._listener)
        self.drop()
        for thread in self._threads:
            thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _listen(self, address: tuple[str, int]) -> None:
        family = socket.AF_INET6 if ":" in address[0] else socket.AF_INET
        try:
            self._listener = socket.create_server(address, family=family)
        except OSError as error:
            raise ConfigError(f"cannot serve RTSP on {address[0]}:{address[1]}: {error.strerror}") from error
        self._address = self._listener.getsockname()[:2]
        self._start(self._accept, self._listener)

    def _start(self, target: object, *arguments: object) -> None:
        thread = threading.Thread(target=target, args=arguments, name="rtsp", daemon=True)  # type: ignore[arg-type]
        self._threads = [*(each for each in self._threads if each.is_alive()), thread]
        thread.start()

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:  # closed
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with self._changed:
                self.connected += 1
                self._connections.add(connection)
            self._start(self._serve, connection)

    def _serve(self, connection: socket.socket) -> None:
        """Answer one connection's requests until it is closed."""
        sending = threading.Lock()
        try:
            with connection, connection.makefile("rb") as lines, contextlib.suppress(OSError):
                for method, headers in _requests(lines):
                    if self._fault is Fault.BLACKHOLE:
                        continue
                    allowed = self._allows(headers)
                    with sending:
                        connection.sendall(self._answer(method, headers.get("cseq", "0"), allowed=allowed))
                    if method == "PLAY" and allowed:
                        self._start(self._stream, connection, sending)
                    if method == "TEARDOWN":
                        return
        finally:
            with self._changed:
                self._connections.discard(connection)
                self._changed.notify_all()

    def _stream(self, connection: socket.socket, sending: threading.Lock) -> None:
        """Send pictures to one viewer until it is gone."""
        encoder, stream, size, shown_ns = None, RtpStream(), (0, 0), -1
        with contextlib.suppress(OSError):
            while (shown := self._wait_newer(connection, shown_ns)) is not None:
                picture, shown_ns = shown
                if encoder is None or size != size_px(picture):
                    size = size_px(picture)
                    encoder = H264Encoder(size, fps=self._fps)
                packets = stream.packets(encoder.encode(picture), taken_ns=shown_ns)
                with sending:
                    connection.sendall(packets)

    def _wait_newer(self, connection: socket.socket, shown_ns: int) -> tuple[Picture, int] | None:
        """Return the newest picture as soon as it may be sent; None where the viewer is gone."""

        def gone() -> bool:
            return self._closed or connection not in self._connections

        def ready() -> bool:
            flowing = self._fault not in (Fault.FROZEN, Fault.BLACKHOLE)
            return gone() or (flowing and self._picture is not None and self._picture[1] != shown_ns)

        with self._changed:
            self._changed.wait_for(ready)
            return None if gone() else self._picture

    def _allows(self, headers: dict[str, str]) -> bool:
        if self._login is None:
            return True
        expected = base64.b64encode(":".join(self._login).encode()).decode()
        return hmac.compare_digest(headers.get("authorization", "").encode(), f"Basic {expected}".encode())

    def _answer(self, method: str, sequence: str, *, allowed: bool) -> bytes:
        status, headers, body = "200 OK", [f"CSeq: {sequence}", "Session: 1"], ""
        if not allowed:
            status = "401 Unauthorized"
            headers.append('WWW-Authenticate: Basic realm="camera"')
        elif method == "OPTIONS":
            headers.append(f"Public: {_METHODS}")
        elif method == "DESCRIBE":
            body = _description("H265" if self._fault is Fault.WRONG_CODEC else "H264")
            headers += ["Content-Type: application/sdp", f"Content-Length: {len(body)}"]
        elif method == "SETUP":
            headers.append("Transport: RTP/AVP/TCP;unicast;interleaved=0-1")
        return (f"RTSP/1.0 {status}\r\n" + "\r\n".join(headers) + "\r\n\r\n" + body).encode()


@contextmanager
def filming(server: RtspServer, picture: Callable[[int], Picture], *, fps: float) -> Iterator[RtspServer]:
    """Show ``picture(0)``, ``picture(1)`` and so on, at that rate, until the context is left.

    Args:
        server: Who serves them.
        picture: Gives the picture of a number, as :meth:`RtspServer.show` takes it.
        fps: Pictures a second; fewer where they take longer to make.
    """
    stop = threading.Event()

    def film() -> None:
        began_s, index = time.monotonic(), 0
        while not stop.wait(began_s + index / fps - time.monotonic()):
            server.show(picture(index))
            index = max(index + 1, int((time.monotonic() - began_s) * fps))

    thread = threading.Thread(target=film, name="filming", daemon=True)
    thread.start()
    try:
        yield server
    finally:
        stop.set()
        thread.join()


def _description(codec: str) -> str:
    """Return the session's description (RFC 8866)."""
    return (
        "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=revnm\r\nt=0 0\r\n"
        f"m=video 0 RTP/AVP {PAYLOAD_TYPE}\r\na=rtpmap:{PAYLOAD_TYPE} {codec}/{CLOCK_HZ}\r\n"
        f"a=fmtp:{PAYLOAD_TYPE} packetization-mode=1\r\na=control:track\r\n"
    )


def _requests(stream: BufferedIOBase) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield method and headers of each request, names in lower case; skip what is framed, such as RTCP."""
    while first := stream.read(1):
        if first == b"$":
            stream.read(int.from_bytes(stream.read(3)[1:]))
            continue
        method = (first + stream.readline(_LONGEST_LINE)).decode("latin-1").split(" ")[0].strip()
        headers = {}
        for _ in range(_MOST_HEADERS):
            line = stream.readline(_LONGEST_LINE).decode("latin-1").strip()
            if not line:
                break
            name, _, value = line.partition(":")
            headers[name.strip().lower()] = value.strip()
        if method:
            yield method, headers


def _shut(listener_or_connection: socket.socket) -> None:
    with contextlib.suppress(OSError):  # the other end was faster
        listener_or_connection.shutdown(socket.SHUT_RDWR)
    listener_or_connection.close()
