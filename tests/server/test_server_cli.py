from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from revnm_server.cli import main

from .free_port import free_port
from .waiting import eventually


def test_serve_runs_until_it_is_told_to_end(tiny_bundle: Path, tmp_path: Path) -> None:
    url = f"http://127.0.0.1:{free_port()}"
    command = [sys.executable, "-m", "revnm_server.cli", "serve", "--http", url.removeprefix("http://")]
    command += ["--listen", f"tcp/127.0.0.1:{free_port()}", "--bundle", str(tiny_bundle), "--robot", "rover=3"]
    command += ["--state-file", str(tmp_path / "state.json"), "--camera", "zenoh://hall"]
    with (tmp_path / "log").open("w") as log, subprocess.Popen(command, stdout=log, stderr=log) as server:

        def page_is_told() -> bool:
            assert server.poll() is None, (tmp_path / "log").read_text()
            return f"page at {url}/" in (tmp_path / "log").read_text()

        try:
            eventually(page_is_told, within_s=20.0)
            with httpx.Client(base_url=url, trust_env=False) as http:
                assert http.get("/readyz").json()["reasons"][0] == "camera init: no picture yet"
                with http.stream("GET", "/api/v1/stream.mjpg"):  # who watches does not keep it from ending
                    server.send_signal(signal.SIGTERM)
                    assert server.wait(10) == 0
        finally:
            server.kill()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--camera", "ftp://u:hush@x/y"], "ftp://***@x/y"),
        (["--http", "8000"], "expected HOST:PORT"),
        (["--http", "0.0.0.0:8000"], "--insecure-http"),
        (["--robot", "rover"], "expected NAME=TAG"),
        (["--robot", "a/b=3"], "a/b"),
        (["--config", "/nowhere.yaml"], "/nowhere.yaml"),
        (["--bundle", "/nowhere"], "/nowhere"),
    ],
)
def test_what_the_user_can_mend_is_said_in_one_line(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", *arguments]) == 2
    output = capsys.readouterr().err
    assert said in output
    assert "hush" not in output
    assert output.count("\n") == 1
