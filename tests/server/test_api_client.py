from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import trustme

from revnm_client.errors import ConfigError, LinkError
from revnm_server.api_client import NoServerError, ServerAddress, call
from revnm_server.app import running_server
from revnm_server.settings import HttpSettings, load_settings

from .free_port import free_port

TOKEN = "0123456789abcdefXYZ"


class Elsewhere(http.server.BaseHTTPRequestHandler):
    """Sends everybody on, with whatever secrets they bring."""

    def do_GET(self) -> None:
        self.send_response(302)
        self.send_header("Location", "http://127.0.0.1:1/")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def elsewhere() -> Iterator[str]:
    with http.server.HTTPServer(("127.0.0.1", 0), Elsewhere) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def test_a_certificate_that_an_authority_issued_is_trusted_by_itself(tiny_bundle: Path, tmp_path: Path) -> None:
    issued = trustme.CA().issue_cert("camera.example")  # not the address that is asked
    issued.cert_chain_pems[0].write_to_path(str(tmp_path / "cert.pem"))
    issued.private_key_pem.write_to_path(str(tmp_path / "key.pem"))
    http_ = {"port": free_port(), "token": TOKEN, "certificate": tmp_path / "cert.pem", "key": tmp_path / "key.pem"}
    overrides = {"zenoh": {"listen": ["tcp/127.0.0.1:0"]}, "http": http_, "perception": {"bundle": tiny_bundle}}
    settings = load_settings(overrides=overrides)
    with running_server(settings):
        address = ServerAddress.of(settings.http)
        assert call(address, "GET", "/api/v1/session") == {"role": "operator"}
        with pytest.raises(LinkError, match="certificate"):
            call(ServerAddress(address.url, TOKEN), "GET", "/api/v1/session")
        with pytest.raises(LinkError, match="answers 401: a token is needed"):
            call(ServerAddress(address.url, "wrong" * 4, address.certificate), "GET", "/api/v1/session")


def test_nothing_follows_a_redirect(elsewhere: str) -> None:
    with pytest.raises(LinkError, match="answers 302"):
        call(ServerAddress(elsewhere, TOKEN), "GET", "/api/v1/state")


def test_where_nothing_listens_that_is_told_apart() -> None:
    with pytest.raises(NoServerError):
        call(ServerAddress(f"http://127.0.0.1:{free_port()}"), "GET", "/api/v1/state")


@pytest.mark.parametrize("token", ["two\nlines", "grün", "a b"])
def test_a_token_that_cannot_be_one_is_not_shown(token: str) -> None:
    with pytest.raises(ConfigError, match="letters and digits") as caught:
        call(ServerAddress("http://127.0.0.1:1", token), "GET", "/api/v1/state")
    assert token not in str(caught.value)


def test_where_a_server_is_asked_that_binds_every_address() -> None:
    assert ServerAddress.of(HttpSettings(host="0.0.0.0", port=1, insecure=True)).url == "http://127.0.0.1:1"
    assert ServerAddress.of(HttpSettings(host="::", port=1, insecure=True)).url == "http://[::1]:1"
