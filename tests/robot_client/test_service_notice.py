"""What systemd hears, on a real socket."""

from __future__ import annotations

import socket

import pytest

from revnm_client.service_notice import ServiceNotice


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
    assert heard(inlet) == ["WATCHDOG=1\nSTATUS=standing: scan is 0.4 s old"]
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
