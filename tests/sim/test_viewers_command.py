"""The command that looks many times: against a small server of plain sockets, whose answers are known."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from revnm_sim.cli import main
from revnm_sim.live.server_api import ServerApi

STATE = json.dumps({"timings_ms": {"tick": {"p50": 20.0, "p95": 30.0}}}).encode()


class Answers(BaseHTTPRequestHandler):
    """A stream of three parts that then stays open, and the state."""

    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        closing: threading.Event = self.server.closing  # type: ignore[attr-defined]
        self.send_response(200)
        if self.path.endswith("stream.mjpg"):
            self.end_headers()
            for _ in range(3):
                self.wfile.write(b"--frame\r\nContent-Length: 2\r\n\r\nxy\r\n")
            closing.wait(20.0)
            self.close_connection = True
        else:
            self.send_header("Content-Length", str(len(STATE)))
            self.end_headers()
            self.wfile.write(STATE)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base class's name
        pass


@pytest.fixture
def address() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Answers)
    server.daemon_threads = True
    server.closing = threading.Event()  # type: ignore[attr-defined]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield f"127.0.0.1:{server.server_port}"
    server.closing.set()  # type: ignore[attr-defined]
    server.shutdown()
    thread.join()
    server.server_close()


def test_what_viewers_get_and_what_the_tick_takes_is_told(
    address: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ServerApi(f"http://{address}").state() == json.loads(STATE)
    options = ["--viewers", "4", "--requests", "20", "--seconds", "0.5", "--rounds", "1"]
    assert main(["viewers", "--http", address, *options, "--out", str(tmp_path)]) == 0
    quiet, loaded = json.loads((tmp_path / "report.json").read_text())["rows"]
    assert (quiet["viewers"], quiet["requests_per_s"], quiet["state_p50_ms"]) == (0, 0.0, None)
    assert (loaded["viewers"], loaded["tick_p50_ms"], loaded["tick_p95_ms"]) == (4, 20.0, 30.0)
    assert loaded["pictures_per_viewer_s"] == 6.0  # three parts each in half a second
    assert 0.0 < loaded["state_p50_ms"] <= loaded["state_p95_ms"]
    assert "tick_p95_ms" in capsys.readouterr().out


def test_an_absent_server_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--viewers", "1", "--requests", "1", "--seconds", "0.1", "--rounds", "1", "--out", str(tmp_path)]
    assert main(["viewers", "--http", "127.0.0.1:1", *options]) == 2
    assert "127.0.0.1:1" in capsys.readouterr().err
    assert main(["viewers", "--http", "nowhere", *options]) == 2
    assert "HOST:PORT" in capsys.readouterr().err
