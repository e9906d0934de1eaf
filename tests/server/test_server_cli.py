from __future__ import annotations

import json
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


def test_settings_are_checked_without_a_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "server.yaml"
    config.write_text("camera: {url: 'rtsp://u:hush@cam/live', name: hall}\nrobots: {rover: 3}\n")
    assert main(["config", "check", str(config)]) == 0
    said = capsys.readouterr().out
    assert "hall" in said
    assert "rover (tag 3)" in said
    assert "hush" not in said
    config.write_text("camera: {url: 'ftp://u:hush@cam'}\nrobots: {rover: x}\nhttp:\n  prot: 1\n")
    assert main(["config", "check", str(config)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(": ")[0] for line in lines] == [f"{config}:1", f"{config}:4", f"{config}:2"]
    assert "hush" not in "".join(lines)


def test_certificates_are_looked_at_without_a_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    config = Path("server.yaml")
    files = (
        "{listen: ['tls/0.0.0.0:7447'], certificate: pki/server.pem, key: pki/server.key, authority: pki/authority.pem}"
    )
    config.write_text(f"robots: {{rover: 3}}\nzenoh: {files}\n")
    assert main(["config", "check", str(config)]) == 2
    assert capsys.readouterr().err == (
        "revnm-server: server.yaml: zenoh.certificate: pki/server.pem: cannot be read: there is no such file "
        "(revnm-server pki can make it)\n"
    )
    assert main(["pki", "init", "--host", "edge.local"]) == 0
    assert main(["config", "check", str(config)]) == 0
    assert capsys.readouterr().err == ""
    Path("pki/server.pem").write_text("nothing")
    assert main(["config", "check", str(config)]) == 2
    assert "server.yaml: pki/server.pem: expected a certificate in PEM" in capsys.readouterr().err
    config.write_text("robots: {}\n")
    assert main(["config", "check", str(config)]) == 2
    assert capsys.readouterr().err == "server.yaml:1: robots: expected at least one robot, each with a tag of its own\n"


def test_the_schema_knows_every_section(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert {"camera", "http", "perception", "robots", "zenoh"} <= schema["properties"].keys()
    assert schema["additionalProperties"] is False
