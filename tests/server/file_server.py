"""A small HTTP server with one file, that can do and refuse what servers of big files do."""

from __future__ import annotations

import ssl
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

PATH = "/net.onnx"


@dataclass
class Behaviour:
    """What the server does; may be changed between requests.

    Attributes:
        content: The file.
        headers: Sent with it, ETag and Last-Modified among them.
        ranges: Whether it sends a part of the file where that is asked for, and the mark is still right.
        sends: So many bytes of the body are sent, then the connection breaks; None sends all.
        stalls: Rather than to break the connection, it waits for the end of the server.
        chunked: Does not tell the length.
        status: Answers with it and nothing else, if it is not 200.
        location: Where each path other than the file's leads to.
    """

    content: bytes
    headers: dict[str, str] = field(default_factory=lambda: {"ETag": '"one"'})
    ranges: bool = True
    sends: int | None = None
    stalls: bool = False
    chunked: bool = False
    status: int = 200
    location: dict[str, str] = field(default_factory=dict)


class FileServer:
    """Serves a file at ``url``; ``asked`` holds the headers of each request for it."""

    def __init__(self, content: bytes, *, context: ssl.SSLContext | None = None) -> None:
        self.does = Behaviour(content)
        self.asked: list[dict[str, str]] = []
        self.closing = threading.Event()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(self))
        self._scheme = "http"
        if context is not None:
            self._server.socket = context.wrap_socket(self._server.socket, server_side=True)
            self._scheme = "https"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)
        self._thread.start()

    @property
    def root(self) -> str:
        """The server's URL, without a path."""
        return f"{self._scheme}://localhost:{self._server.server_port}"

    @property
    def url(self) -> str:
        """The file's URL."""
        return self.root + PATH

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _handler(server: FileServer) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            does = server.does
            self.close_connection = True
            if self.path in does.location:
                self._head(302, {"Location": does.location[self.path], "Content-Length": "0"})
                return
            server.asked.append(dict(self.headers))
            if does.status != 200:
                self._head(does.status, {"Content-Length": "0"})
                return
            start = self._start()
            if start is not None and start >= len(does.content):
                self._head(416, {"Content-Range": f"bytes */{len(does.content)}", "Content-Length": "0"})
                return
            self._body(does.content[start or 0 :], start)

        def _start(self) -> int | None:
            does, asked = server.does, self.headers
            marks = (does.headers.get("ETag"), does.headers.get("Last-Modified"))
            if not does.ranges or "Range" not in asked or asked.get("If-Range") not in (None, *marks):
                return None
            return int(asked["Range"].removeprefix("bytes=").removesuffix("-"))

        def _body(self, body: bytes, start: int | None) -> None:
            does, total = server.does, len(server.does.content)
            headers = dict(does.headers)
            if start is not None:
                headers["Content-Range"] = f"bytes {start}-{total - 1}/{total}"
            if does.chunked:
                headers["Transfer-Encoding"] = "chunked"
                body = b"%x\r\n%b\r\n0\r\n\r\n" % (len(body), body)
            else:
                headers.setdefault("Content-Length", str(len(body)))
            self._head(200 if start is None else 206, headers)
            self.wfile.write(body[: does.sends])
            self.wfile.flush()
            if does.stalls:
                server.closing.wait()

        def _head(self, status: int, headers: dict[str, str]) -> None:
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    return Handler
