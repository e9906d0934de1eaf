"""A network link with faults between two TUN devices: packets are lost, late, or do not pass at all.

In user space, because the kernel's own emulation (netem) is a module that many machines lack.
"""

from __future__ import annotations

import os
import random
import select
import threading
import time
from collections import deque
from dataclasses import dataclass
from types import TracebackType
from typing import Self

_PACKET_BYTES = 65_536
_QUEUE_PACKETS = 1000  # as netem and most interfaces have; what comes beyond is lost
_SWELL_S = 0.5  # how long the queue of a slow link takes from one length to another
_IDLE_S = 0.2


@dataclass(frozen=True, slots=True)
class LinkCondition:
    """How a link is, the same in both directions.

    Attributes:
        loss: Share of packets that are lost, each by itself.
        delay_s: How long packets are under way.
        jitter_s: By how much that varies to either side, slowly, as a queue fills and drains: none overtakes another.
        parted: Nothing passes; what is under way is lost.
    """

    loss: float = 0.0
    delay_s: float = 0.0
    jitter_s: float = 0.0
    parted: bool = False

    def __post_init__(self) -> None:
        if 2.0 * self.jitter_s >= _SWELL_S or self.jitter_s > self.delay_s:
            raise ValueError(f"jitter_s is {self.jitter_s}: expected less than {_SWELL_S / 2} and no more than delay_s")


@dataclass(slots=True)
class Traffic:
    """Packets in one direction so far."""

    passed: int = 0
    lost: int = 0


class Direction:
    """The packets on their way in one direction.

    Attributes:
        traffic: What has become of them.
    """

    def __init__(self, seed: str) -> None:
        self.traffic = Traffic()
        self._random = random.Random(seed)
        self._queue: deque[tuple[float, bytes]] = deque()
        self._swell = (0.0, 0.0, 0.0)  # since when it goes from one to another, each in [-1, 1]

    def accept(self, packet: bytes, now_s: float, condition: LinkCondition) -> None:
        """Take a packet that is sent now, or lose it."""
        lost = condition.parted or self._random.random() < condition.loss
        if lost or len(self._queue) >= _QUEUE_PACKETS:
            self.traffic.lost += 1
            return
        due_s = now_s + condition.delay_s + condition.jitter_s * self._swelling(now_s)
        if self._queue:  # the link has become faster since
            due_s = max(due_s, self._queue[-1][0])
        self._queue.append((due_s, packet))

    def take_due(self, now_s: float, condition: LinkCondition) -> list[bytes]:
        """Return the packets that arrive now."""
        if condition.parted:
            self.traffic.lost += len(self._queue)
            self._queue.clear()
        arrived = []
        while self._queue and self._queue[0][0] <= now_s:
            arrived.append(self._queue.popleft()[1])
        self.traffic.passed += len(arrived)
        return arrived

    @property
    def next_due_s(self) -> float | None:
        """When the next packet arrives; None while none is under way."""
        return self._queue[0][0] if self._queue else None

    def _swelling(self, now_s: float) -> float:
        """Return how full the queue of the link is, in [-1, 1]."""
        since_s, start, end = self._swell
        if now_s - since_s >= _SWELL_S:
            start = end if now_s - since_s < 2.0 * _SWELL_S else self._random.uniform(-1.0, 1.0)
            since_s, end = now_s, self._random.uniform(-1.0, 1.0)
            self._swell = since_s, start, end
        return start + (end - start) * (now_s - since_s) / _SWELL_S


class EmulatedLink:
    """Carries packets between two devices in a thread; a context manager.

    Attributes:
        directions: From the first device to the second, and back.
    """

    def __init__(self, first: int, second: int, *, seed: int) -> None:
        """Prepare it, without faults.

        Args:
            first: Device of one end, as :class:`tests.system.network.Tun` has it.
            second: Of the other end.
            seed: Of losses and delays.
        """
        self.directions = Direction(f"{seed} there"), Direction(f"{seed} back")
        self._ways = (first, second, self.directions[0]), (second, first, self.directions[1])
        self._condition = LinkCondition()
        self._wake_up, self._wake = os.pipe()
        self._closing = False
        self._thread = threading.Thread(target=self._carry, name="link", daemon=True)

    def become(self, condition: LinkCondition) -> float:
        """Be in this condition from now on; return when that was, monotonic clock, seconds."""
        self._condition = condition
        os.write(self._wake, b"!")
        return time.monotonic()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._closing = True
        os.write(self._wake, b"!")
        self._thread.join()
        os.close(self._wake)
        os.close(self._wake_up)

    def _carry(self) -> None:
        while not self._closing:
            readable, _, _ = select.select([self._wake_up, *(way[0] for way in self._ways)], [], [], self._pause_s())
            if self._wake_up in readable:
                os.read(self._wake_up, 100)
            condition = self._condition
            for source, sink, direction in self._ways:
                if source in readable:
                    for packet in _packets(source):
                        direction.accept(packet, time.monotonic(), condition)
                for packet in direction.take_due(time.monotonic(), condition):
                    os.write(sink, packet)

    def _pause_s(self) -> float:
        """Return how long nothing will arrive."""
        due_s = [at_s for direction in self.directions if (at_s := direction.next_due_s) is not None]
        return max(0.0, min([at_s - time.monotonic() for at_s in due_s], default=_IDLE_S))


def _packets(device: int) -> list[bytes]:
    """Return what a device has to give."""
    packets = []
    while True:
        try:
            packets.append(os.read(device, _PACKET_BYTES))
        except BlockingIOError:
            return packets
