"""The link does to packets what it says, or the tests that break it prove nothing."""

from __future__ import annotations

import math
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from .emulated_link import Direction, LinkCondition
from .network import require_namespaces
from .site import Site, site


def test_each_packet_is_lost_with_the_given_probability() -> None:
    direction, condition, sent = Direction("seed"), LinkCondition(loss=0.2), 20_000
    for _ in range(sent // 100):
        for _ in range(100):
            direction.accept(b"packet", 0.0, condition)
        direction.take_due(0.0, condition)
    deviation = math.sqrt(0.2 * 0.8 * sent)  # of a binomial distribution
    assert abs(direction.traffic.lost - 0.2 * sent) < 4.0 * deviation
    assert direction.traffic.passed + direction.traffic.lost == sent


def test_delays_fill_their_range_and_no_packet_overtakes_another() -> None:
    direction, condition = Direction("seed"), LinkCondition(delay_s=0.3, jitter_s=0.1)
    delays_s, arrived = [], []
    for tick in range(60_000):  # a minute
        now_s = 100.0 + 0.001 * tick
        if tick % 5 == 0:
            direction.accept(struct.pack("d", now_s), now_s, condition)
        for packet in direction.take_due(now_s, condition):
            (sent_s,) = struct.unpack("d", packet)
            arrived.append(sent_s)
            delays_s.append(now_s - sent_s)
    assert arrived == sorted(arrived)
    assert 0.2 <= min(delays_s) < 0.22
    assert 0.38 < max(delays_s) <= 0.402
    assert abs(sum(delays_s) / len(delays_s) - 0.3) < 0.02


def test_a_link_that_becomes_faster_keeps_the_order() -> None:
    direction, slow, fast = Direction("seed"), LinkCondition(delay_s=0.3), LinkCondition()
    direction.accept(b"first", 0.0, slow)
    direction.accept(b"second", 0.1, fast)
    assert direction.take_due(0.29, fast) == []
    assert direction.take_due(0.31, fast) == [b"first", b"second"]


def test_a_parted_link_loses_what_is_under_way_and_what_comes() -> None:
    direction, parted = Direction("seed"), LinkCondition(parted=True)
    direction.accept(b"under way", 0.0, LinkCondition(delay_s=0.3))
    direction.accept(b"comes", 0.1, parted)
    assert direction.take_due(0.1, parted) == []
    assert direction.take_due(9.0, LinkCondition()) == []
    assert (direction.traffic.passed, direction.traffic.lost) == (0, 2)


def test_a_jitter_by_which_packets_would_overtake_is_refused() -> None:
    with pytest.raises(ValueError, match=r"jitter_s is 0\.3: expected less than 0\.25"):
        LinkCondition(delay_s=0.3, jitter_s=0.3)


@pytest.fixture(scope="module")
def wired() -> Iterator[Site]:
    require_namespaces()
    with site() as made:
        yield made


def ping(wired: Site, *, count: int, every_s: float, wait_s: float) -> list[float]:
    """Send echo requests (RFC 792) to the other machine's kernel; return the round trips of the replies, seconds."""
    round_trips_s = []
    with socket.socket(socket.AF_INET, socket.SOCK_RAW, socket.IPPROTO_ICMP) as raw:
        began_s = time.monotonic()
        due_s = [began_s + every_s * number for number in range(count)]
        while (now_s := time.monotonic()) < began_s + every_s * count + wait_s and len(round_trips_s) < count:
            if due_s and now_s >= due_s[0]:
                due_s.pop(0)
                raw.sendto(_echo_request(time.monotonic()), (f"{wired.subnets[0]}.2", 0))
            raw.settimeout(0.002)
            try:
                reply = raw.recv(2000)[20:]  # after the head of IP
            except TimeoutError:
                continue
            kind, _, _, number, _, sent_s = struct.unpack("!BBHHHd", reply[:16])
            if (kind, number) == (0, _NUMBER):
                round_trips_s.append(time.monotonic() - sent_s)
    return round_trips_s


_NUMBER = 4711


def _echo_request(now_s: float) -> bytes:
    body = struct.pack("!HHd", _NUMBER, 0, now_s)
    words = struct.unpack("!6H", body)
    total = (8 << 8) + sum(words)
    total = (total & 0xFFFF) + (total >> 16)
    return struct.pack("!BBH", 8, 0, ~(total + (total >> 16)) & 0xFFFF) + body


def test_a_sound_link_loses_nothing_and_is_fast(wired: Site) -> None:
    wired.link.become(LinkCondition())
    round_trips_s = ping(wired, count=200, every_s=0.002, wait_s=2.0)
    assert len(round_trips_s) == 200
    assert min(round_trips_s) < 0.02


def test_between_machines_packets_are_lost_each_way(wired: Site) -> None:
    wired.link.become(LinkCondition(loss=0.2))
    arrived = len(ping(wired, count=1000, every_s=0.001, wait_s=0.5))
    deviation = math.sqrt(0.64 * 0.36 * 1000)  # there and back: 0.8 · 0.8 arrive
    assert abs(arrived - 640) < 4.0 * deviation


def test_between_machines_packets_are_late_each_way(wired: Site) -> None:
    wired.link.become(LinkCondition(delay_s=0.1))
    round_trips_s = ping(wired, count=50, every_s=0.005, wait_s=2.0)
    assert len(round_trips_s) == 50
    assert min(round_trips_s) >= 0.2
    assert min(round_trips_s) < 0.25


def test_between_machines_nothing_passes_a_parted_link_until_it_is_whole(wired: Site) -> None:
    wired.link.become(LinkCondition(parted=True))
    assert ping(wired, count=20, every_s=0.005, wait_s=0.3) == []
    wired.link.become(LinkCondition())
    assert len(ping(wired, count=20, every_s=0.005, wait_s=2.0)) == 20
