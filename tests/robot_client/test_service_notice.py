"""What systemd hears, on a real socket."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from revnm_client.link import open_router
from revnm_client.service_notice import ServiceNotice

UNIT = Path(__file__).parents[2] / "robot_client/systemd/revnm-robot.service"


class Hand:
    """A clock that is moved by hand."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture(params=["file", "abstract"])
def manager(request, tmp_path):
    """Where systemd listens: the socket, and NOTIFY_SOCKET's value."""
    name = str(tmp_path / "notify") if request.param == "file" else f"@{tmp_path}/notify"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as inlet:
        inlet.bind(name.replace("@", "\0"))
        inlet.setblocking(False)
        yield inlet, name


def heard(inlet: socket.socket) -> list[str]:
    texts = []
    while True:
        try:
            texts.append(inlet.recv(4096).decode())
        except BlockingIOError:
            return texts


def test_systemd_hears_that_it_is_ready_alive_and_stopping(manager):
    inlet, address = manager
    clock = Hand()
    notice = ServiceNotice(address, clock)
    notice.ready("waiting for tcp/a:1")
    assert heard(inlet) == ["READY=1\nSTATUS=waiting for tcp/a:1"]
    notice.ticked(None)
    assert heard(inlet) == ["WATCHDOG_USEC=5000000", "WATCHDOG=1\nSTATUS=driving"]
    clock.now_s += 0.95
    notice.ticked(None)
    assert heard(inlet) == []
    clock.now_s += 0.05
    notice.ticked("scan is\n0.4 s old")
    assert heard(inlet) == ["WATCHDOG=1\nSTATUS=scan is 0.4 s old"]
    notice.stopping()
    assert heard(inlet) == ["STOPPING=1"]


def test_a_manager_that_does_not_read_holds_nothing_up(manager):
    _, address = manager
    notice = ServiceNotice(address)
    for _ in range(2000):  # far more than the socket's queue takes
        notice.ready("x" * 200)


def test_without_a_manager_nothing_happens(tmp_path):
    ServiceNotice(None).ready("")
    ServiceNotice("").ticked(None)
    ServiceNotice(str(tmp_path / "nobody")).ready("waiting")


def test_the_command_is_ready_before_its_server_is_and_watched_once_it_ticks(manager, endpoint, eventually):
    inlet, address = manager
    texts: list[str] = []

    def says(part: str) -> bool:
        texts.extend(heard(inlet))
        return any(part in text for text in texts)

    process = subprocess.Popen(
        [sys.executable, "-m", "revnm_client.cli", "run", "--robot", "rover", "--connect", endpoint],
        env=os.environ | {"NOTIFY_SOCKET": address},
        stderr=subprocess.DEVNULL,
    )
    try:
        eventually(lambda: says(f"READY=1\nSTATUS=waiting for {endpoint}"), within_s=20.0)
        assert not says("WATCHDOG")
        with open_router([endpoint]):
            eventually(lambda: says("WATCHDOG=1\nSTATUS=no odometry yet"))
            process.send_signal(signal.SIGTERM)
            eventually(lambda: says("STOPPING=1"))
            assert process.wait(10.0) == 0
    finally:
        process.kill()
        process.wait()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
def test_systemd_understands_the_unit(tmp_path):
    text = UNIT.read_text()
    assert "ExecStart=/opt/revnm/bin/revnm-robot run " in text
    unit = tmp_path / UNIT.name  # with a program that is there: verify looks
    unit.write_text(text.replace("/opt/revnm/bin/revnm-robot", str(Path(sys.executable).with_name("revnm-robot"))))
    verified = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=60)
    assert (verified.returncode, verified.stdout, verified.stderr) == (0, "", "")
