"""Hears what robots and server send each other, byte for byte, while a record is written.

Samples wait in Zenoh's own rings until they are polled: a callback in Python would hold up everything that the session
receives whenever the interpreter is busy. Zenoh's router stamps what it receives, so nothing is lost by polling late.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import zenoh

from revnm_client import keys
from revnm_client.link import LatestSubscriber
from revnm_server.recording import topics
from revnm_server.recording.topics import Topic

_WAITING = 500  # samples of a key: 5 s at 100 Hz
_MOST_OFF_NS = 10_000_000_000
_LARGEST_BYTES = 262_144  # a scan of 8,192 beams with intensities has a quarter of it


@dataclass(frozen=True, slots=True)
class WireEntry:
    """A payload as it went over Zenoh.

    Attributes:
        robot: Whose it is.
        topic: Where it belongs.
        payload: Its bytes.
        at_ns: When the router received it, server's clock.
        attachment: What came with it.
    """

    robot: str
    topic: Topic
    payload: bytes
    at_ns: int
    attachment: bytes | None = None


def wire_topics(robot: str) -> dict[str, Topic]:
    """Return the topic of each of a robot's Zenoh keys that are recorded."""
    return {
        keys.scan(robot): topics.scan(robot),
        keys.odom(robot): topics.odometry(robot),
        keys.cmd_vel(robot): topics.velocity(robot),
        keys.waypoints(robot): topics.waypoints(robot),
        keys.state(robot): topics.state(robot),
    }


class WireTap:
    """Gathers every payload of the robots' keys; closing it leaves the keys.

    Args:
        session: The router's.
        robots: Their names.

    Attributes:
        overflows: How often a ring was found full: samples may have been lost then.
        oversized: Samples that were left out because no message of theirs is so large.
    """

    def __init__(self, session: zenoh.Session, robots: Iterable[str]) -> None:
        self.overflows = 0
        self.oversized = 0
        self._sources = [
            (robot, topic, LatestSubscriber(session, key, waiting=_WAITING))
            for robot in robots
            for key, topic in wire_topics(robot).items()
        ]

    def poll(self) -> list[WireEntry]:
        """Return what came since the last time; never blocks. By one thread."""
        found = []
        now_ns = time.time_ns()
        for robot, topic, subscriber in self._sources:
            samples = subscriber.drain()
            self.overflows += len(samples) >= _WAITING
            small = [sample for sample in samples if len(sample.payload) <= _LARGEST_BYTES]
            self.oversized += len(samples) - len(small)
            found += [_entry(robot, topic, sample, now_ns) for sample in small]
        return found

    def close(self) -> None:
        """Hear no more."""
        for _, _, subscriber in self._sources:
            subscriber.close()


def _entry(robot: str, topic: Topic, sample: zenoh.Sample, now_ns: int) -> WireEntry:
    attachment = sample.attachment.to_bytes() if sample.attachment is not None else None
    return WireEntry(robot, topic, sample.payload.to_bytes(), _received_ns(sample, now_ns), attachment)


def _received_ns(sample: zenoh.Sample, now_ns: int) -> int:
    """Return the stamp of the router; where there is none, or one that a robot made up, now."""
    if sample.timestamp is None:
        return now_ns
    stamp_ns = sample.timestamp.get_time_as_ntp64().as_nanos()
    return stamp_ns if abs(stamp_ns - now_ns) <= _MOST_OFF_NS else now_ns
