"""Downloads from a local server that breaks off, changes its file, refuses, and leads astray."""

from __future__ import annotations

import fcntl
import hashlib
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import pytest

from revnm_client.errors import ConfigError, FileError, LinkError
from revnm_server.networks.download import RemoteFile, check_url, download

from .file_server import PATH, FileServer

CONTENT = np.random.default_rng(0).bytes(300_000)
HALF = 150_000


def sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def server() -> Iterator[FileServer]:
    with FileServer(CONTENT) as running:
        yield running


@pytest.fixture
def target(tmp_path: Path) -> Path:
    return tmp_path / "models" / "net.onnx"


def part_of(target: Path) -> Path:
    return target.with_name("net.onnx.part")


def fetch(
    url: str,
    target: Path,
    *,
    content: bytes = CONTENT,
    size_bytes: int | None = None,
    trusts: ssl.SSLContext | None = None,
    free: int = 10**9,
) -> bool:
    nobody = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    with httpx.Client(trust_env=False, verify=trusts or nobody, timeout=10.0) as client:
        return download(RemoteFile(url, sha256(content), size_bytes), target, client=client, free=lambda _: free)


def cut_in_half(server: FileServer, target: Path, *, error: str = "run it again to go on") -> None:
    server.does.sends = HALF
    with pytest.raises(LinkError, match=error):
        fetch(server.url, target)
    assert part_of(target).read_bytes() == CONTENT[:HALF]
    assert not target.exists()
    server.does.sends = None


def assert_only(target: Path) -> None:
    assert target.read_bytes() == CONTENT
    assert list(target.parent.iterdir()) == [target]


def test_a_file_is_downloaded_once(server: FileServer, target: Path) -> None:
    assert fetch(server.url, target, size_bytes=len(CONTENT))
    assert_only(target)
    assert not fetch(server.url, target)
    assert len(server.asked) == 1


def test_what_was_cut_goes_on_where_it_was(server: FileServer, target: Path) -> None:
    cut_in_half(server, target)
    assert fetch(server.url, target)
    assert_only(target)
    assert (server.asked[1]["Range"], server.asked[1]["If-Range"]) == (f"bytes={HALF}-", '"one"')


def test_a_file_that_changed_meanwhile_is_begun_anew(server: FileServer, target: Path) -> None:
    cut_in_half(server, target)
    other = CONTENT[::-1]
    server.does.content, server.does.headers = other, {"ETag": '"two"'}
    assert fetch(server.url, target, content=other)
    assert target.read_bytes() == other
    assert server.asked[1]["If-Range"] == '"one"'


def test_a_server_that_sends_no_parts_sends_all_of_it_again(server: FileServer, target: Path) -> None:
    cut_in_half(server, target)
    server.does.ranges = False
    assert fetch(server.url, target)
    assert_only(target)


@pytest.mark.parametrize("headers", [{}, {"ETag": 'W/"one"'}])
def test_what_cannot_be_told_from_a_later_version_is_begun_anew(
    server: FileServer, target: Path, headers: dict[str, str]
) -> None:
    server.does.headers = headers
    cut_in_half(server, target)
    assert fetch(server.url, target)
    assert_only(target)
    assert "Range" not in server.asked[1]


def test_a_date_serves_where_there_is_no_strong_etag(server: FileServer, target: Path) -> None:
    date = "Sun, 29 Nov 2026 00:00:00 GMT"
    server.does.headers = {"ETag": 'W/"one"', "Last-Modified": date}
    cut_in_half(server, target)
    assert fetch(server.url, target)
    assert_only(target)
    assert server.asked[1]["If-Range"] == date


def test_a_part_of_another_url_is_begun_anew(server: FileServer, target: Path) -> None:
    cut_in_half(server, target)
    assert fetch(server.url + "?v=2", target)
    assert_only(target)
    assert "Range" not in server.asked[1]


@pytest.mark.parametrize("size_bytes", [len(CONTENT), None])
def test_a_part_that_is_whole_needs_no_more_bytes(server: FileServer, target: Path, size_bytes: int | None) -> None:
    cut_in_half(server, target)
    part_of(target).write_bytes(CONTENT)
    server.does.sends = 0
    assert fetch(server.url, target, size_bytes=size_bytes)
    assert_only(target)


def test_a_part_that_is_too_long_is_begun_anew(server: FileServer, target: Path) -> None:
    cut_in_half(server, target)
    part_of(target).write_bytes(CONTENT + b"more")
    assert fetch(server.url, target, size_bytes=len(CONTENT))
    assert_only(target)


def test_a_server_with_another_file_does_not_cost_the_part(server: FileServer, target: Path) -> None:
    cut_in_half(server, target)
    server.does.content, server.does.headers = b"an excuse", {"ETag": '"two"'}
    with pytest.raises(LinkError, match="another file"):
        fetch(server.url, target, size_bytes=len(CONTENT))
    assert part_of(target).read_bytes() == CONTENT[:HALF]


def test_an_unknown_length_will_do(server: FileServer, target: Path) -> None:
    server.does.chunked = True
    assert fetch(server.url, target)
    assert_only(target)


def test_another_sum_is_told_and_nothing_is_left(server: FileServer, target: Path) -> None:
    with pytest.raises(FileError, match=rf"sha256 expected {sha256(b'x')}, got {sha256(CONTENT)}; it was deleted"):
        fetch(server.url, target, content=b"x")
    assert list(target.parent.iterdir()) == []


def test_another_size_is_told_before_the_download(server: FileServer, target: Path) -> None:
    with pytest.raises(LinkError, match=r"another file: expected 7 bytes, the server has 300000"):
        fetch(server.url, target, size_bytes=7)
    server.does.chunked = True
    with pytest.raises(LinkError, match=r"sends more than 7 bytes"):
        fetch(server.url, target, size_bytes=7)


def test_more_than_a_network_can_need_is_refused(server: FileServer, target: Path) -> None:
    server.does.headers = {"Content-Length": str(2**32 + 1)}
    with pytest.raises(LinkError, match="4294967297 bytes, more than 4294967296"):
        fetch(server.url, target)


def test_a_full_disk_is_told(server: FileServer, target: Path) -> None:
    target.parent.mkdir()
    part_of(target).symlink_to("/dev/full")
    with pytest.raises(FileError, match=r"net\.onnx\.part: No space left on device; .* is kept"):
        fetch(server.url, target)


def test_too_little_room_is_told_before_the_download(server: FileServer, target: Path) -> None:
    cut_in_half(server, target)
    needed = len(CONTENT) - HALF
    with pytest.raises(FileError, match=f"no room for {needed} bytes more: {needed - 1} are free"):
        fetch(server.url, target, free=needed - 1)
    assert fetch(server.url, target, free=needed)


def test_two_downloads_do_not_write_one_file(server: FileServer, target: Path) -> None:
    target.parent.mkdir()
    with part_of(target).open("ab") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(FileError, match="another download writes to it"):
            fetch(server.url, target)
    assert fetch(server.url, target)


def test_what_lies_there_under_the_name_is_left_alone(server: FileServer, target: Path) -> None:
    target.parent.mkdir()
    target.write_text("mine")
    with pytest.raises(FileError, match=r"is there, but with another sha256 .* move it away"):
        fetch(server.url, target)
    assert target.read_text() == "mine"
    with pytest.raises(FileError, match=r"models: Is a directory"):
        fetch(server.url, target.parent)


@pytest.mark.parametrize(("status", "said"), [(404, "404 Not Found"), (401, "401 Unauthorized"), (503, "503 Service")])
def test_a_refusal_is_told(server: FileServer, target: Path, status: int, said: str) -> None:
    server.does.status = status
    with pytest.raises(LinkError, match=f"the server says {said}"):
        fetch(server.url, target)


def test_no_server_is_told(target: Path) -> None:
    with pytest.raises(LinkError, match=r"http://127\.0\.0\.1:1/net\.onnx: .*refused"):
        fetch("http://127.0.0.1:1/net.onnx", target)


def test_redirects_are_followed_for_a_while(server: FileServer, target: Path) -> None:
    server.does.location = {"/there": PATH, "/round": "/round"}
    assert fetch(server.root + "/there", target)
    assert_only(target)
    with pytest.raises(LinkError, match="more than 5 redirects"):
        fetch(server.root + "/round", target.with_name("other"))


@pytest.mark.parametrize(
    "place", ["http://192.0.2.1/net.onnx", "ftp://localhost/net.onnx", "http://localhost.example/x"]
)
def test_redirects_to_where_anybody_could_answer_are_refused(server: FileServer, target: Path, place: str) -> None:
    server.does.location = {"/there": place}
    with pytest.raises(LinkError, match=r"leads away from https"):
        fetch(server.root + "/there", target)


@pytest.mark.parametrize(
    "url",
    ["http://example.com/x", "ftp://example.com/x", "file:///etc/passwd", "https:///x", "x.onnx", "http://[::1", ""],
)
def test_only_https_and_this_machine_are_asked(url: str) -> None:
    with pytest.raises(ConfigError):
        check_url(url)


def test_credentials_are_neither_taken_nor_told() -> None:
    with pytest.raises(ConfigError, match="without credentials") as caught:
        check_url("https://user:hush@example.com/x")
    assert "hush" not in str(caught.value)


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificate and key of localhost, signed by themselves, in one file."""
    path = tmp_path_factory.mktemp("tls") / "localhost.pem"
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=localhost"
    command += f" -addext subjectAltName=DNS:localhost -keyout {path}.key -out {path}"
    subprocess.run(command.split(), check=True, capture_output=True)
    path.write_text(path.read_text() + Path(f"{path}.key").read_text())
    return path


def test_over_tls_only_from_whom_is_known_and_never_down_to_http(certificate: Path, target: Path) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate)
    trusts = ssl.create_default_context(cafile=str(certificate))
    with FileServer(CONTENT, context=context) as secure, FileServer(CONTENT) as plain:
        with pytest.raises(LinkError, match="certificate verify failed"):
            fetch(secure.url, target)
        secure.does.location = {"/down": plain.url, "/up": PATH}
        with pytest.raises(LinkError, match="leads away from https, to http://localhost"):
            fetch(secure.root + "/down", target, trusts=trusts)
        plain.does.location = {"/up": secure.url}
        assert fetch(plain.root + "/up", target, trusts=trusts)
        assert_only(target)
        assert len(plain.asked) == 0
