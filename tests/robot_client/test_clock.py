from __future__ import annotations

import random
import time

import pytest
import zenoh

from revnm_client.clock import ClockJump, ClockOffset
from revnm_client.clock_probe import ClockProbe
from revnm_client.control_messages import (
    TimeReply,
    TimeRequest,
    decode_time_request,
    encode_time_reply,
    encode_time_request,
)
from revnm_client.link import open_client

SECOND = 1_000_000_000
MS = 1_000_000


def exchange(clock: ClockOffset, *, now_ns: int, skew_ns: int, there_ns: int, back_ns: int) -> bool:
    """One request at robot time ``now_ns``; the server needs 1 ms to answer."""
    t2_ns = now_ns + there_ns + skew_ns
    t3_ns = t2_ns + MS
    return clock.add(now_ns, t2_ns, t3_ns, t3_ns - skew_ns + back_ns)


def test_hand_made_exchange():
    # The server is 100 ahead. Sent at 10, 4 there (114), answered at 120, 6 back: t4 = 26.
    # Offset in [120 - 26, 114 - 10] = [94, 104]: the middle is 99, the round trip 10.
    clock = ClockOffset()
    assert clock.offset_ns is None
    assert clock.round_trip_ns is None
    assert clock.add(10, 114, 120, 26)
    assert (clock.offset_ns, clock.round_trip_ns) == (99, 10)


@pytest.mark.parametrize("skew_s", [-5, -0.3, 0, 0.3, 5])
def test_error_is_at_most_half_the_round_trip_however_uneven(skew_s):
    rng = random.Random(1)
    skew_ns = int(skew_s * SECOND)
    for _ in range(200):
        clock = ClockOffset()
        for tick in range(10):
            ways_ns = (rng.randrange(100 * MS), rng.randrange(5 * MS))
            there_ns, back_ns = rng.sample(ways_ns, 2)
            assert exchange(clock, now_ns=tick * SECOND, skew_ns=skew_ns, there_ns=there_ns, back_ns=back_ns)
            assert abs(clock.offset_ns - skew_ns) <= (clock.round_trip_ns + 1) // 2


def test_the_shortest_of_the_last_eight_counts():
    clock = ClockOffset()
    exchange(clock, now_ns=0, skew_ns=7 * SECOND, there_ns=1 * MS, back_ns=1 * MS)
    for tick in range(1, 8):
        exchange(clock, now_ns=tick * SECOND, skew_ns=7 * SECOND, there_ns=90 * MS, back_ns=0)
        assert clock.offset_ns == 7 * SECOND
    exchange(clock, now_ns=8 * SECOND, skew_ns=7 * SECOND, there_ns=90 * MS, back_ns=0)
    assert clock.offset_ns == 7 * SECOND + 45 * MS  # the short one is the ninth last now
    assert clock.round_trip_ns == 90 * MS


def test_a_clock_that_was_set_is_noticed_at_once():
    clock = ClockOffset()
    for tick in range(8):
        exchange(clock, now_ns=tick * SECOND, skew_ns=0, there_ns=MS, back_ns=MS)
    exchange(clock, now_ns=8 * SECOND, skew_ns=300 * MS, there_ns=20 * MS, back_ns=10 * MS)
    assert clock.offset_ns == pytest.approx(300 * MS, abs=15 * MS)


def test_an_impossible_exchange_is_left_out():
    clock = ClockOffset()
    assert not clock.add(10, 114, 120, 12)  # the reply took longer to write than the whole exchange
    assert clock.offset_ns is None


def test_forgetting():
    clock = ClockOffset()
    clock.add(10, 114, 120, 26)
    clock.forget()
    assert clock.offset_ns is None


def test_jumps_of_the_wall_clock():
    jump = ClockJump()
    assert not jump.check(1000 * SECOND, 5 * SECOND)  # the first says nothing
    assert not jump.check(1001 * SECOND, 6 * SECOND)
    assert not jump.check(1002 * SECOND + 10 * MS, 7 * SECOND)  # slewing
    assert jump.check(1006 * SECOND, 8 * SECOND)
    assert not jump.check(1007 * SECOND, 9 * SECOND)
    assert jump.check(1003 * SECOND, 10 * SECOND)


@pytest.mark.parametrize("skew_s", [-5, 5])
def test_probe_measures_a_server_with_another_clock(router, client, eventually, skew_s):
    skew_ns = skew_s * SECOND

    def answer(query):
        with query:
            t1_ns = decode_time_request(query.payload.to_bytes()).t1_ns
            t2_ns = t1_ns + skew_ns  # as if it came at once
            query.reply("rover/revnm/time", encode_time_reply(TimeReply(t1_ns, t2_ns, t2_ns, "hall")))

    with router.declare_queryable("rover/revnm/time", answer), ClockProbe(client, "rover") as probe:
        eventually(lambda: probe.reading().offset_ns is not None)
        reading = probe.reading()
        assert abs(reading.offset_ns - skew_ns) <= reading.round_trip_ns
        assert (reading.rejected, reading.failures) == (0, 0)


def test_probe_counts_garbage_and_goes_on(router, client, eventually):
    replies = iter([b"", b"{}", b'{"t1":1,"t2":2,"t3":3,"server":""}', None])

    def answer(query):
        with query:
            payload = next(replies, b"junk")
            if payload is None:
                query.reply_err(b"no clock here")
            else:
                query.reply("rover/revnm/time", payload)

    with router.declare_queryable("rover/revnm/time", answer), ClockProbe(client, "rover") as probe:
        eventually(lambda: probe.reading().rejected >= 5)
        assert probe.reading().offset_ns is None
        assert probe.reading().last_error.startswith("rover/revnm/time: ")
        assert probe.reading().failures == 0


def clock_of(session, server, skew_ns):
    """Let a server tell a time."""

    def answer(query):
        with query:
            t1_ns = decode_time_request(query.payload.to_bytes()).t1_ns
            reply = TimeReply(t1_ns, t1_ns + skew_ns, t1_ns + skew_ns, server)
            query.reply("rover/revnm/time", encode_time_reply(reply))

    return session.declare_queryable("rover/revnm/time", answer)


def test_probe_follows_one_of_two_servers_until_it_answers_no_more(endpoint, router, client, eventually):
    with open_client([endpoint]) as elsewhere, ClockProbe(client, "rover") as probe:
        first = clock_of(router, "hall", 5 * SECOND)
        eventually(lambda: probe.reading().server == "hall")
        with clock_of(elsewhere, "yard", -5 * SECOND):
            key = "rover/revnm/time"
            everybody = {"target": zenoh.QueryTarget.ALL, "consolidation": zenoh.ConsolidationMode.NONE}
            asked = encode_time_request(TimeRequest(1))
            eventually(lambda: len(list(client.get(key, payload=asked, **everybody))) == 2)
            before = probe.reading()
            probe.forget()  # so that it asks at once, and hears both
            eventually(lambda: probe.reading().offset_ns is not None)
            after = probe.reading()
            assert (before.server, after.server) == ("hall", "hall")
            assert abs(after.offset_ns - 5 * SECOND) <= after.round_trip_ns
            first.undeclare()
            gone_s = time.monotonic()
            eventually(lambda: probe.reading().server == "yard", within_s=20.0)
            assert time.monotonic() - gone_s > 3.0  # a server that starts anew has time to come back
            reading = probe.reading()
            assert abs(reading.offset_ns + 5 * SECOND) <= reading.round_trip_ns


def test_probe_without_a_server_knows_nothing_and_ends(client):
    with ClockProbe(client, "rover") as probe:
        assert probe.reading().offset_ns is None
