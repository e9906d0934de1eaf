from __future__ import annotations

import socket
import threading
import time

import pytest
import zenoh

from revnm_client import cdr, link
from revnm_client.errors import ConfigError, LinkError
from revnm_client.messages import Velocity


def test_a_slow_consumer_gets_the_newest(router, client, eventually):
    with (
        link.LatestSubscriber(client, "rover/waypoints") as subscriber,
        link.LatestSubscriber(client, "rover/marker") as marker,
    ):
        block = zenoh.CongestionControl.BLOCK  # so that the writer in this test loses nothing
        publisher = router.declare_publisher("rover/waypoints", congestion_control=block)
        end = router.declare_publisher("rover/marker", congestion_control=block)
        eventually(lambda: publisher.matching_status.matching and end.matching_status.matching)
        for count in range(500):
            publisher.put(f"{count}")
        end.put("all 500 are sent")
        eventually(marker.take)
        sample = subscriber.take()
        assert sample is not None
        assert sample.payload.to_string() == "499"
        assert subscriber.take() is None


def test_taking_never_blocks(client):
    with link.LatestSubscriber(client, "rover/scan") as subscriber:
        begin_s = time.monotonic()
        assert all(subscriber.take() is None for _ in range(100))
        assert time.monotonic() - begin_s < 1.0


def test_garbage_is_counted_and_does_not_stop_the_inbox(router, client, eventually):
    with link.LatestSubscriber(client, "rover/cmd_vel") as subscriber:
        inbox = link.Inbox(subscriber, cdr.decode_velocity)
        publisher = link.control_publisher(router, "rover/cmd_vel")
        eventually(lambda: publisher.matching_status.matching)

        def polled_until_rejected(count: int) -> bool:
            assert inbox.take() is None
            return inbox.rejected == count

        for count, garbage in enumerate([b"", b"\0\1\0\0", b"\xff" * 5000, b"{}"], start=1):
            publisher.put(garbage)
            eventually(lambda: polled_until_rejected(count))  # noqa: B023
        publisher.delete()
        eventually(lambda: polled_until_rejected(5))
        assert inbox.last_error.startswith("rover/cmd_vel: geometry_msgs/msg/Twist")
        publisher.put(cdr.encode_velocity(Velocity(0.25, 0.5)))
        received = []
        eventually(lambda: received.append(inbox.take()) or received[-1])
        assert received[-1] == Velocity(0.25, 0.5)
        assert inbox.rejected == 5


def test_garbage_displaces_no_sound_message(router, client, eventually):
    with link.LatestSubscriber(client, "rover/cmd_vel") as subscriber, link.LatestSubscriber(client, "end") as end:
        inbox = link.Inbox(subscriber, cdr.decode_velocity)
        block = zenoh.CongestionControl.BLOCK
        publisher = router.declare_publisher("rover/cmd_vel", congestion_control=block)
        marker = router.declare_publisher("end", congestion_control=block)
        eventually(lambda: publisher.matching_status.matching and marker.matching_status.matching)
        for payload in [cdr.encode_velocity(Velocity(0.1, 0.0)), cdr.encode_velocity(Velocity(0.2, 0.0)), b"", b"{}"]:
            publisher.put(payload)
        marker.put("all is sent")
        eventually(end.take)
        assert inbox.take() == Velocity(0.2, 0.0)
        assert inbox.rejected == 2
        assert inbox.take() is None


def test_attachments_reach_the_decoder(router, client, eventually):
    with link.LatestSubscriber(client, "rover/waypoints") as subscriber:
        inbox = link.Inbox.with_attachment(subscriber, lambda payload, attachment: (payload, attachment))
        publisher = link.control_publisher(router, "rover/waypoints")
        eventually(lambda: publisher.matching_status.matching)
        received = []
        publisher.put(b"a", attachment=b"b")
        eventually(lambda: received.append(inbox.take()) or received[-1])
        publisher.put(b"c")
        eventually(lambda: received.append(inbox.take()) or received[-1])
        assert [pair for pair in received if pair] == [(b"a", b"b"), (b"c", b"")]


def test_pictures_of_megabytes_pass(router, client, eventually):
    with link.LatestSubscriber(client, "cam/image/compressed") as subscriber:
        publisher = link.image_publisher(router, "cam/image/compressed")
        eventually(lambda: publisher.matching_status.matching)
        publisher.put(bytes(4_000_000))
        received = []
        eventually(lambda: received.append(subscriber.take()) or received[-1])
        assert len(received[-1].payload) == 4_000_000


def test_a_taken_port_is_a_link_error(endpoint, router):
    with pytest.raises(LinkError, match=r"cannot listen on tcp/127.0.0.1:\d+: .*in use") as caught:
        link.open_router([endpoint])
    assert "cargo" not in str(caught.value)


def test_a_malformed_endpoint_is_a_config_error():
    with pytest.raises(ConfigError, match="junk"):
        link.open_client(["junk"])
    with pytest.raises(ConfigError, match="junk"):
        link.open_router(["junk"])


def test_the_client_waits_for_its_router(endpoint, eventually):
    opened: list[zenoh.Session] = []
    waiting = threading.Thread(target=lambda: opened.append(link.open_client([endpoint])))
    waiting.start()
    with link.open_router([endpoint]):
        waiting.join(timeout=10.0)
        assert opened
        opened[0].close()


def test_an_endpoint_that_says_nothing_does_not_keep_the_client_from_the_next(endpoint, router):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        begin_s = time.monotonic()
        with link.open_client([f"tcp/127.0.0.1:{silent.getsockname()[1]}", endpoint]):
            assert time.monotonic() - begin_s < 8.0  # Zenoh by itself waits ten


def test_waiting_for_a_router_can_be_given_up(endpoint):
    stop = threading.Event()
    outcome: list[Exception] = []

    def wait() -> None:
        try:
            link.open_client([endpoint], stop=stop)
        except LinkError as error:
            outcome.append(error)

    waiting = threading.Thread(target=wait)
    waiting.start()
    stop.set()
    waiting.join(timeout=5.0)
    assert "gave up connecting" in str(outcome[0])


def test_everything_comes_back_after_a_router_restart(endpoint, eventually):
    first = link.open_router([endpoint])
    with link.open_client([endpoint]) as client, link.LatestSubscriber(client, "a/scan") as subscriber:
        mine = link.control_publisher(client, "a/cmd_vel")
        publisher = link.control_publisher(first, "a/scan")
        eventually(lambda: publisher.matching_status.matching)
        first.close()
        eventually(lambda: not list(client.info.routers_zid()))
        mine.put(b"lost, but no error")
        begin_s = time.monotonic()
        with link.open_router([endpoint]) as second, link.LatestSubscriber(second, "a/cmd_vel") as commands:
            publisher = link.control_publisher(second, "a/scan")
            eventually(lambda: publisher.put(b"1") or subscriber.take())
            eventually(lambda: mine.put(b"2") or commands.take())
            assert time.monotonic() - begin_s < 4.0


def test_two_systems_in_one_process_do_not_meet(endpoint, router, client, eventually):
    other = link.open_router(["tcp/127.0.0.1:0"])
    with other, link.LatestSubscriber(client, "a/x") as subscriber:
        publisher = link.control_publisher(router, "a/x")
        eventually(lambda: publisher.matching_status.matching)
        assert not link.control_publisher(other, "a/x").matching_status.matching
        assert subscriber.take() is None
