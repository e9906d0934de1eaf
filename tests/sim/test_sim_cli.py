from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from tests.server.free_port import free_port

from revnm_client.errors import LinkError
from revnm_sim.cli import main
from revnm_sim.live.server_api import ServerApi
from revnm_sim.live.summary import DriveSummary, format_summary


@pytest.mark.parametrize(
    "words",
    [["run", "--seed", "-1"], ["run", "--fps", "0"], ["demo", "--timeout", "nan"], ["fly"], []],
)
def test_wrong_options_are_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert "usage: revnm-sim" in capsys.readouterr().err


def test_malformed_endpoint_is_an_error_that_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "--connect", "nonsense"]) == 2
    assert "nonsense" in capsys.readouterr().err


def test_a_robot_with_credentials_needs_a_camera_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "robot.yaml"
    config.write_text("robot: rover\nserver: tcp/127.0.0.1:1\nprofile: megarover\nsecurity: {password_file: none}\n")
    assert main(["run", "--config", str(config)]) == 2
    assert f"security.password_file: {tmp_path}/none: cannot be read" in capsys.readouterr().err
    (tmp_path / "none").write_text("open sesame")
    for words in ([], ["--rtsp", "127.0.0.1:8554", "--camera", "hall"]):
        assert main(["run", "--config", str(config), *words]) == 2
        assert "lets no camera in" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_command_ends_when_it_is_told_to_or_its_terminal_is_closed(number: signal.Signals) -> None:
    command = [Path(sys.executable).with_name("revnm-sim"), "run", "--connect", f"tcp/127.0.0.1:{free_port()}"]
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # these tests may run under nohup
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        signal.signal(signal.SIGHUP, before)
        try:
            assert process.stderr is not None
            assert any("waiting for" in line for line in process.stderr)
            process.send_signal(number)
            assert process.wait(20.0) == 0
        finally:
            process.kill()


def test_bench_shows_its_own_options(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["bench", "--help"])
    assert ended.value.code == 0
    assert "--protocol" in capsys.readouterr().out


class Answers(BaseHTTPRequestHandler):
    """Answers as a server that is not ready, has a state, and knows one robot."""

    def do_GET(self) -> None:
        if self.path == "/api/v1/state":
            self._reply(200, {"ready": False})
        else:
            self._reply(503, {"detail": "camera init: no picture yet"})

    def do_PUT(self) -> None:
        body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
        known = self.path == "/api/v1/robots/rover/goal" and body == {"u": 1.5, "v": 2.0}
        self._reply(200 if known else 404, {"goal": {"id": "g1"}} if known else {"detail": "no robot of that name"})

    def do_POST(self) -> None:
        known = self.path == "/api/v1/robots/rover/stop"
        self._reply(200 if known else 404, {} if known else {"detail": "no such order"})

    def log_message(self, *_: object) -> None:
        pass

    def _reply(self, status: int, document: dict[str, object]) -> None:
        self.send_response(status)
        self.end_headers()
        self.wfile.write(json.dumps(document).encode())


@pytest.fixture
def api() -> Iterator[ServerApi]:
    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield ServerApi(f"http://127.0.0.1:{server.server_address[1]}")
        server.shutdown()
        thread.join()


def test_api_says_why_the_server_is_not_ready(api: ServerApi) -> None:
    assert "503: camera init: no picture yet" in str(api.not_ready())
    assert api.state() == {"ready": False}


def test_api_passes_refusals_on(api: ServerApi) -> None:
    assert api.set_goal("rover", u=1.5, v=2.0) == "g1"
    with pytest.raises(LinkError, match="404: no robot of that name"):
        api.set_goal("walker", u=1.5, v=2.0)
    api.order("rover", "stop")
    with pytest.raises(LinkError, match="404: no such order"):
        api.order("rover", "resume")


def test_no_server_is_not_ready() -> None:
    assert "refused" in str(ServerApi("http://127.0.0.1:9").not_ready())


def test_summary_table() -> None:
    summary = DriveSummary(
        arrived=True,
        duration_s=12.34,
        path_m=5.678,
        goal_error_m=0.21,
        closest_m=1.0,
        contact=False,
        stages_ms={"depth": (10.04, 20.0)},
        robot_tick_ms=(4.0, None),
    )
    lines = format_summary(summary).splitlines()
    assert lines[0].split() == ["arrived", "yes"]
    assert lines[2].split() == ["time", "12.3", "s"]
    assert lines[5].split() == ["closest", "obstacle", "over", "1.00", "m"]
    assert lines[-2].split() == ["server", "depth", "10.0", "20.0"]
    assert lines[-1].split() == ["robot", "tick", "4.0", "–"]
