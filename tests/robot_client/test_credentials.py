"""What the robot shows its server: where it is wrong, and what the doctor says when it is not taken."""

from __future__ import annotations

import datetime
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import trustme

from revnm_client.credentials import Credentials, read_password
from revnm_client.doctor import unreachable
from revnm_client.errors import FileError
from revnm_client.settings import BadSettingsError, RobotSettings, load_settings

BASE = "robot: rover\nprofile: megarover\n"
GOOD = "security: {authority: a.pem, certificate: r.pem, key: r.key}\nserver: [tls/10.0.0.1:7447, tls/10.0.0.2:7447]\n"


@pytest.fixture(autouse=True)
def _in_a_folder(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)


def load(text: str) -> RobotSettings:
    Path("robot.yaml").write_text(BASE + text)
    return load_settings(Path("robot.yaml"))


def test_certificates_are_read_and_shown_as_they_were_set():
    settings = load(GOOD)
    credentials = settings.security.credentials(settings.robot)
    assert (credentials.authority, credentials.certificate, credentials.key) == (
        Path("a.pem"),
        Path("r.pem"),
        Path("r.key"),
    )
    Path("shown.yaml").write_text(settings.as_yaml())
    shown = load_settings(Path("shown.yaml"))
    assert shown.security.certificate == Path("r.pem").absolute()
    assert shown.as_yaml() == settings.as_yaml()


def test_paths_count_from_the_folder_of_the_settings(monkeypatch, tmp_path):
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/robot.yaml").write_text(BASE + GOOD)
    assert load_settings(Path("etc/robot.yaml")).security.key == Path("etc/r.key")
    monkeypatch.setenv("REVNM_ROBOT__SECURITY__KEY", "/run/r.key")
    assert load_settings(Path("etc/robot.yaml")).security.key == Path("/run/r.key")


def test_a_password_is_read_and_never_shown():
    Path("password.txt").write_text("open sesame\n")
    settings = load("security: {password_file: password.txt}\nserver: tcp/10.0.0.1:7447\n")
    credentials = settings.security.credentials(settings.robot)
    assert credentials.zenoh_settings() == {
        "transport/auth/usrpwd/user": "rover",
        "transport/auth/usrpwd/password": "open sesame",
    }
    assert "sesame" not in repr(credentials) + repr(settings) + settings.as_yaml()


@pytest.mark.parametrize("text", ["", "\n", "two\nlines\n", "a\tb\n", "x" * 257])
def test_a_password_file_that_holds_none_is_told(text):
    Path("password.txt").write_text(text)
    with pytest.raises(FileError, match=r"^security\.password_file: password\.txt: expected the password on one line"):
        read_password(Path("password.txt"))
    with pytest.raises(FileError, match=r"^security\.password_file: nothing\.txt: cannot be read"):
        read_password(Path("nothing.txt"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("server: tls/h:1\n", "robot.yaml:3: server: tls/h:1: expected tls/HOST:PORT with security.authority"),
        (GOOD.replace("tls/10.0.0.2", "tcp/10.0.0.2"), "robot.yaml:4: server: tcp/10.0.0.2:7447: expected tls/"),
        (GOOD.replace(", key: r.key", ""), "robot.yaml:3: security: expected certificate and key, or neither"),
        (GOOD.replace("authority: a.pem, ", ""), "robot.yaml:3: security: expected the authority with the certificate"),
        (GOOD.replace("r.key", "r.key, password_file: p"), "security: expected a certificate or a password, not both"),
        (GOOD.replace("key:", "kee:"), "security.kee: unknown key: expected one of authority, certificate, key, passw"),
        ("security: {authority: ''}\nserver: tls/h:1", "security.authority: '': expected the path of a file"),
    ],
)
def test_what_contradicts_itself_is_told_with_its_place(text, said):
    with pytest.raises(BadSettingsError) as caught:
        load(text)
    assert any(said in problem for problem in caught.value.problems), caught.value.problems


@contextmanager
def tls_server(server: trustme.LeafCert, robots: trustme.CA) -> Iterator[str]:
    """Serve as Zenoh does: who shows no good certificate is refused after the handshake."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    server.configure_cert(context)
    robots.configure_trust(context)
    context.verify_mode = ssl.CERT_REQUIRED

    def serve(listener: socket.socket) -> None:
        try:
            accepted, _ = listener.accept()
            with context.wrap_socket(accepted, server_side=True) as link:
                link.recv(1)
        except OSError:  # the robot, or this server, has refused
            return

    with socket.create_server(("127.0.0.1", 0)) as listener, ExitStack() as stack:
        thread = threading.Thread(target=serve, args=(listener,))
        thread.start()
        stack.callback(thread.join, 5.0)
        yield f"tls/127.0.0.1:{listener.getsockname()[1]}"


def shown(ca: trustme.CA, by: trustme.CA | None) -> Credentials:
    ca.cert_pem.write_to_path("authority.pem")
    if by is None:
        return Credentials(Path("authority.pem"))
    leaf = by.issue_cert(common_name="rover")
    leaf.cert_chain_pems[0].write_to_path("robot.pem")
    leaf.private_key_pem.write_to_path("robot.key")
    return Credentials(Path("authority.pem"), Path("robot.pem"), Path("robot.key"))


def test_the_doctor_says_why_a_server_and_a_robot_do_not_trust_each_other():
    ours, other = trustme.CA(), trustme.CA()
    yesterday = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=1)
    cases = [
        (ours.issue_cert("127.0.0.1"), shown(ours, ours), None),
        (other.issue_cert("127.0.0.1"), shown(ours, ours), "its certificate is not to be trusted: "),
        (ours.issue_cert("10.0.0.9"), shown(ours, ours), "IP address mismatch"),
        (ours.issue_cert("127.0.0.1", not_after=yesterday), shown(ours, ours), "certificate has expired"),
    ]
    for server, credentials, said in cases:
        with tls_server(server, ours) as endpoint:
            problem = unreachable([endpoint], credentials)
        assert (problem is None) if said is None else (said in problem), problem


@pytest.mark.parametrize("by_another", [True, False])
def test_the_doctor_says_that_the_server_does_not_take_the_robots_certificate(by_another):
    ours = trustme.CA()
    credentials = shown(ours, trustme.CA() if by_another else None)
    with tls_server(ours.issue_cert("127.0.0.1"), ours) as endpoint:
        problem = unreachable([endpoint], credentials)
    assert "it does not take what this robot shows" in problem


def test_a_file_that_is_no_certificate_is_told():
    Path("authority.pem").write_text("junk")
    with pytest.raises(FileError, match=r"authority\.pem"):
        unreachable(["tls/127.0.0.1:1"], Credentials(Path("authority.pem")))
