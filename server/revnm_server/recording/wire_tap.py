"""Hears what robots and server send each other, byte for byte, while a record is written."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import zenoh

from revnm_client import keys
from revnm_server.recording import topics
from revnm_server.recording.entry_queue import WireEntry
from revnm_server.recording.topics import Topic


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
    """Hands on every payload of the robots' keys; closing it leaves the keys.

    Args:
        session: The router's.
        robots: Their names.
        offer: Takes the payloads, in Zenoh's threads; must not block or raise.
    """

    def __init__(self, session: zenoh.Session, robots: Iterable[str], offer: Callable[[WireEntry], object]) -> None:
        self._subscribers: list[zenoh.Subscriber[None]] = [
            session.declare_subscriber(key, _handler(robot, topic, offer))
            for robot in robots
            for key, topic in wire_topics(robot).items()
        ]

    def close(self) -> None:
        """Hear no more."""
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]


def _handler(robot: str, topic: Topic, offer: Callable[[WireEntry], object]) -> Callable[[zenoh.Sample], None]:
    def hear(sample: zenoh.Sample) -> None:
        at_ns = time.time_ns()
        attachment = sample.attachment.to_bytes() if sample.attachment is not None else None
        offer(WireEntry(robot, topic, sample.payload.to_bytes(), at_ns, attachment))

    return hear
