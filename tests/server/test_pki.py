"""The authority's folder: what is made, that nothing is lost, and that a TLS library that is not Zenoh's agrees."""

from __future__ import annotations

import datetime
import errno
import os
import socket
import ssl
import stat
import tempfile
import threading
from pathlib import Path

import pytest

from revnm_client.errors import ConfigError, FileError
from revnm_server.cli import main
from revnm_server.pki import CertificateWatch, create_authority, endings, issue_robot, issue_server, issued

DAY = datetime.timedelta(days=1)


@pytest.fixture
def pki(tmp_path: Path) -> Path:
    create_authority(tmp_path / "pki", ["127.0.0.1", "edge.local", "::1"])
    return tmp_path / "pki"


def modes(folder: Path) -> dict[str, int]:
    return {str(path.relative_to(folder)): stat.S_IMODE(path.stat().st_mode) for path in sorted(folder.rglob("*"))}


def tls_peer_names(server: tuple[Path, Path], authority: Path, robot: Path, host: str) -> tuple[str, str]:
    """Shake hands as server and robot would; return the common name that each saw of the other."""
    accept = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=authority)
    accept.load_cert_chain(*server)
    accept.verify_mode = ssl.CERT_REQUIRED
    connect = ssl.create_default_context(cafile=robot / "authority.pem")
    for context in (accept, connect):
        context.verify_flags |= ssl.VERIFY_X509_STRICT  # as Python 3.13 does by itself
    connect.load_cert_chain(robot / "robot.pem", robot / "robot.key")
    left, right = socket.socketpair()
    seen: list[str] = []

    def serve() -> None:
        with accept.wrap_socket(left, server_side=True) as link:
            seen.append(common_name(link))
            link.recv(1)

    thread = threading.Thread(target=serve)
    thread.start()
    with connect.wrap_socket(right, server_hostname=host) as link:
        name = common_name(link)
    thread.join(5.0)
    return name, seen[0]


def common_name(link: ssl.SSLSocket) -> str:
    certificate = link.getpeercert()
    assert certificate is not None
    return dict(pair for part in certificate["subject"] for pair in part)["commonName"]


@pytest.mark.parametrize("host", ["127.0.0.1", "edge.local", "::1"])
def test_server_and_robot_know_each_other(pki: Path, host: str) -> None:
    robot = issue_robot(pki, "rover")
    names = tls_peer_names((pki / "server.pem", pki / "server.key"), pki / "authority.pem", robot, host)
    assert names == ("ReVNM server", "rover")


def test_a_server_that_moved_gets_a_new_certificate_and_robots_need_none(pki: Path) -> None:
    robot = issue_robot(pki, "rover")
    before = (pki / "server.pem").read_bytes()
    issue_server(pki, ["10.0.0.9"])
    assert (pki / "server.pem").read_bytes() != before
    names = tls_peer_names((pki / "server.pem", pki / "server.key"), pki / "authority.pem", robot, "10.0.0.9")
    assert names == ("ReVNM server", "rover")
    assert sorted(path.name for path in pki.iterdir()) == [
        "authority.key",
        "authority.pem",
        "rover",
        "server.key",
        "server.pem",
    ]


def test_keys_are_for_their_owner_only(pki: Path) -> None:
    issue_robot(pki, "rover")
    issue_server(pki, ["10.0.0.9"])
    private = {name: mode for name, mode in modes(pki).items() if name.endswith(".key") or name == "rover"}
    assert private == {"authority.key": 0o600, "server.key": 0o600, "rover": 0o700, "rover/robot.key": 0o600}
    assert stat.S_IMODE(pki.stat().st_mode) == 0o700


def test_an_authority_is_never_written_over(pki: Path) -> None:
    before = (pki / "authority.key").read_bytes()
    with pytest.raises(FileError, match="is there, and is not written over"):
        create_authority(pki, ["10.0.0.9"])
    issue_robot(pki, "rover")
    certificate = (pki / "rover/robot.pem").read_bytes()
    with pytest.raises(FileError, match="is there, and is not written over"):
        issue_robot(pki, "rover")
    assert (pki / "authority.key").read_bytes() == before
    assert (pki / "rover/robot.pem").read_bytes() == certificate


@pytest.mark.parametrize(
    "host", ["", "edge local", "-edge", "edge..local", "http://edge", "a" * 64, "édge", "192.168.1.300"]
)
def test_a_host_that_is_none_leaves_nothing_behind(tmp_path: Path, host: str) -> None:
    with pytest.raises(ConfigError, match="expected a name or an address"):
        create_authority(tmp_path / "pki", ["127.0.0.1", host])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["", "..", "a/b", "x" * 33, "rover\n"])
def test_a_name_that_is_no_robots_leaves_nothing_behind(pki: Path, name: str) -> None:
    before = modes(pki)
    with pytest.raises(ConfigError, match="is no robot or camera name"):
        issue_robot(pki, name)
    assert modes(pki) == before


def test_a_folder_that_holds_no_authority_is_told(tmp_path: Path, pki: Path) -> None:
    with pytest.raises(FileError, match=r"authority\.pem: cannot be read"):
        issue_robot(tmp_path, "rover")
    (pki / "authority.key").write_bytes((pki / "server.key").read_bytes())
    with pytest.raises(FileError, match=r"authority\.key: is not the key of authority\.pem"):
        issue_robot(pki, "rover")
    (pki / "authority.key").write_text("no key")
    with pytest.raises(FileError, match=r"authority\.key: expected an unencrypted private key"):
        issue_robot(pki, "rover")
    assert not (pki / "rover").exists()


def test_certificates_are_told_of_before_they_end(pki: Path) -> None:
    paths = [pki / "server.pem", pki / "authority.pem", pki / "server.pem"]
    ends = issued(pki)[1].ends
    assert list(endings(paths, ends - 31 * DAY)) == []
    (soon,) = endings(paths, ends - 29 * DAY)
    assert (soon.over, soon.text) == (
        False,
        f"{pki}/server.pem ends on {ends:%Y-%m-%d}: make a new one (revnm-server pki)",
    )
    (over,) = endings(paths, ends)
    assert over.over


def test_a_server_that_runs_for_years_warns_in_time(pki: Path) -> None:
    ends, passed_s = issued(pki)[1].ends, [0.0]
    paths = [pki / "server.pem"]
    start = ends - 40 * DAY
    watch = CertificateWatch(
        lambda: paths,
        now=lambda: start + datetime.timedelta(seconds=passed_s[0]),
        clock_s=lambda: passed_s[0],
    )
    assert watch.notes() == []
    passed_s[0] = 11 * DAY.total_seconds()
    assert watch.notes() == [f"{pki}/server.pem ends on {ends:%Y-%m-%d}: make a new one (revnm-server pki)"]
    (pki / "server.pem").unlink()
    passed_s[0] += 3599.0
    assert "ends on" in watch.notes()[0]
    passed_s[0] += 1.0
    assert watch.notes() == [f"{pki}/server.pem: cannot be read: No such file or directory"]


def test_a_folder_that_cannot_be_written_to_is_told(pki: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (pki / "server.pem").read_bytes()
    monkeypatch.setattr(tempfile, "mkdtemp", refuse)
    with pytest.raises(FileError, match="pki: cannot be written to: Read-only file system"):
        issue_server(pki, ["10.0.0.9"])
    with pytest.raises(FileError, match="rover: cannot be made: Read-only file system"):
        issue_robot(pki, "rover")
    assert (pki / "server.pem").read_bytes() == before


def refuse(*_: object, **__: object) -> str:
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def test_the_command_makes_lists_and_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["pki", "init", "--host", "192.168.1.5", "--host", "edge.local"]) == 0
    said = capsys.readouterr().out
    assert "authority: pki/authority.pem" in said
    assert main(["pki", "robot", "rover"]) == 0
    assert "security: {authority: authority.pem" in capsys.readouterr().out
    assert main(["pki", "server", "--host", "192.168.1.6"]) == 0
    assert main(["pki", "list"]) == 0
    listed = capsys.readouterr().out.splitlines()[-3:]
    assert [line.split()[-1] for line in listed] == ["pki/authority.pem", "pki/server.pem", "pki/rover/robot.pem"]
    assert main(["pki", "init", "--host", "192.168.1.5"]) == 2
    assert "revnm-server: pki: is there" in capsys.readouterr().err
