"""Which planner the server puts together, and that it says so."""

from __future__ import annotations

import ssl
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import trustme

from revnm_client.errors import ConfigError, FileError
from revnm_client.link import open_client
from revnm_server.app import running_server
from revnm_server.settings import load_settings

from .free_port import free_port
from .service_parts import CameraFeed
from .tiny_bundle import write_tiny_bundle
from .waiting import eventually

TOKEN = "0123456789abcdefXYZ"


@contextmanager
def states(bundle: Path, **perception: object) -> Iterator[Any]:
    """Run a server and a camera; yields a function that asks for the state."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    overrides = {
        "zenoh": {"listen": [endpoint]},
        "http": {"port": 0},
        "perception": {"bundle": bundle, **perception},
    }
    with (
        running_server(load_settings(overrides=overrides)) as server,
        open_client([endpoint]) as client,
        CameraFeed(client),
        httpx.Client(base_url=server.url, timeout=5.0, trust_env=False) as http,
    ):

        def state() -> Any:
            document = http.get("/api/v1/state").json()
            return document if document["timings_ms"] else None

        yield state


def test_the_policy_is_the_usual_planner(tiny_bundle: Path) -> None:
    with states(tiny_bundle) as state:
        shown = eventually(state)
    assert "policy" in shown["timings_ms"]
    assert shown["camera"]["calibration"] is None
    assert shown["warnings"] == []


def test_the_map_planner_runs_where_it_is_asked_for(tiny_bundle: Path) -> None:
    with states(tiny_bundle, planner="bev") as state:
        shown = eventually(state)
    assert set(shown["timings_ms"]) - {"learn"} == {"depth", "tag", "map", "tick"}  # learning comes after the tick
    calibration = {"status": "unknown", "progress": 0.0, "spread_1_m_cm": None, "spread_2_m_cm": None, "event": None}
    assert shown["camera"]["calibration"] == calibration | {"camera": None}
    assert shown["warnings"] == []
    assert {"rover/odom", "rover/scan"} <= set(shown["rejected"])


def test_a_policy_that_sees_the_map_gets_one(tmp_path: Path) -> None:
    with states(write_tiny_bundle(tmp_path / "tiny", sees="map")) as state:
        shown = eventually(state)
    assert set(shown["timings_ms"]) - {"learn"} == {"depth", "tag", "map", "tick"}  # no robot has a goal
    assert shown["camera"]["calibration"]["status"] == "unknown"
    assert shown["warnings"] == []


@pytest.mark.parametrize("missing", ["policy.onnx", "exo2ego.onnx"])
def test_a_bundle_without_its_policy_falls_back_to_the_map_and_says_so(
    tiny_bundle: Path, missing: str, caplog: pytest.LogCaptureFixture
) -> None:
    (tiny_bundle / missing).unlink()
    with states(tiny_bundle) as state:
        shown = eventually(state)
    assert "map" in shown["timings_ms"]
    assert f"the bundle lacks {missing}" in shown["warnings"][0]
    assert f"the bundle lacks {missing}" in caplog.text


def test_an_altered_policy_is_no_reason_to_fall_back(tiny_bundle: Path) -> None:
    (tiny_bundle / "policy.onnx").write_bytes(b"altered")
    with pytest.raises(FileError, match=r"policy\.onnx: altered"), states(tiny_bundle):
        pass


def test_the_page_comes_by_https_where_there_is_a_certificate(tiny_bundle: Path, tmp_path: Path) -> None:
    authority = trustme.CA()
    authority.cert_pem.write_to_path(str(tmp_path / "ca.pem"))
    issued = authority.issue_cert("127.0.0.1")
    issued.cert_chain_pems[0].write_to_path(str(tmp_path / "cert.pem"))
    issued.private_key_pem.write_to_path(str(tmp_path / "key.pem"))
    http = {"port": 0, "token": TOKEN, "certificate": tmp_path / "cert.pem", "key": tmp_path / "key.pem"}
    overrides = {"zenoh": {"listen": ["tcp/127.0.0.1:0"]}, "http": http, "perception": {"bundle": tiny_bundle}}
    trusted = ssl.create_default_context(cafile=str(tmp_path / "ca.pem"))
    with running_server(load_settings(overrides=overrides)) as server:
        assert server.url.startswith("https://127.0.0.1:")
        with httpx.Client(base_url=server.url, verify=trusted, trust_env=False) as client:
            assert "; Secure" in client.get(f"/?token={TOKEN}").headers["set-cookie"]
            assert client.get("/api/v1/state").status_code == 200  # the client sends the cookie back
        with pytest.raises(httpx.RemoteProtocolError):
            httpx.get(server.url.replace("https", "http"), trust_env=False)


def test_a_certificate_of_another_key_is_refused(tiny_bundle: Path, tmp_path: Path) -> None:
    first, second = (trustme.CA().issue_cert("127.0.0.1") for _ in range(2))
    first.cert_chain_pems[0].write_to_path(str(tmp_path / "cert.pem"))
    second.private_key_pem.write_to_path(str(tmp_path / "key.pem"))
    http = {"port": 0, "certificate": tmp_path / "cert.pem", "key": tmp_path / "key.pem"}
    overrides = {"zenoh": {"listen": ["tcp/127.0.0.1:0"]}, "http": http, "perception": {"bundle": tiny_bundle}}
    with pytest.raises(ConfigError, match=r"cert\.pem"), running_server(load_settings(overrides=overrides)):
        pass


def test_a_server_without_the_april_tag_library_runs_on_opencv_and_says_so(
    tiny_bundle: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "pyapriltags", None)
    monkeypatch.delitem(sys.modules, "revnm_server.tag.apriltag", raising=False)
    with states(tiny_bundle) as state:
        shown = eventually(state)
    assert "the AprilTag library does not load" in shown["warnings"][0]
    assert "the AprilTag library does not load" in caplog.text
