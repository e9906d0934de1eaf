"""A real relay before a real TCP server that sends back what it gets."""

from __future__ import annotations

import socket
import socketserver
import threading
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest
from tests.server.free_port import free_port

from revnm_sim.soak.relay import Relay


class Echo(socketserver.BaseRequestHandler):
    """Sends everything back."""

    def handle(self) -> None:
        with suppress(OSError):
            while data := self.request.recv(65536):
                self.request.sendall(data)


@pytest.fixture
def relay() -> Iterator[tuple[Relay, tuple[str, int]]]:
    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Echo) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        address = ("127.0.0.1", free_port())
        with Relay(f"127.0.0.1:{address[1]}", f"127.0.0.1:{server.server_address[1]}") as made:
            yield made, address
        server.shutdown()
        thread.join()


def connect(address: tuple[str, int]) -> socket.socket:
    return socket.create_connection(address, timeout=5.0)


def echo(connection: socket.socket, data: bytes) -> bytes:
    connection.sendall(data)
    return receive(connection, len(data))


def receive(connection: socket.socket, count: int) -> bytes:
    got = b""
    while len(got) < count and (part := connection.recv(65536)):
        got += part
    return got


def test_what_is_sent_arrives_whole_and_in_order(relay: tuple[Relay, tuple[str, int]]) -> None:
    data = bytes(range(256)) * 2000
    with connect(relay[1]) as connection:
        assert echo(connection, data) == data


def test_refused_connections_break_and_new_ones_are_refused_until_it_is_mended(
    relay: tuple[Relay, tuple[str, int]],
) -> None:
    network, address = relay
    with connect(address) as connection:
        assert echo(connection, b"before") == b"before"
        network.refuse()
        with suppress(ConnectionResetError):
            assert connection.recv(1) == b""
    with pytest.raises(ConnectionRefusedError):
        connect(address)
    network.mend()
    with connect(address) as connection:
        assert echo(connection, b"after") == b"after"


def test_stopped_up_nothing_passes_and_what_waited_comes_when_it_is_mended(
    relay: tuple[Relay, tuple[str, int]],
) -> None:
    network, address = relay
    with connect(address) as connection:
        assert echo(connection, b"before") == b"before"
        network.stop_up()
        connection.sendall(b"meanwhile")
        connection.settimeout(0.2)
        with pytest.raises(TimeoutError):
            connection.recv(1)
        network.mend()
        connection.settimeout(5.0)
        assert receive(connection, 9) == b"meanwhile"


def test_delayed_it_takes_the_delay_twice_there_and_back(relay: tuple[Relay, tuple[str, int]]) -> None:
    network, address = relay
    with connect(address) as connection:
        assert echo(connection, b"before") == b"before"
        network.delay(0.1)
        began_s = time.monotonic()
        assert echo(connection, b"slow") == b"slow"
        assert time.monotonic() - began_s >= 0.2
        network.mend()
        assert echo(connection, b"quick") == b"quick"


def test_a_far_end_that_is_gone_ends_the_connection() -> None:
    address = ("127.0.0.1", free_port())
    with (
        Relay(f"127.0.0.1:{address[1]}", f"127.0.0.1:{free_port()}"),
        connect(address) as connection,
        suppress(ConnectionResetError),
    ):
        assert connection.recv(1) == b""
