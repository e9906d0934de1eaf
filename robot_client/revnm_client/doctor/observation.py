"""What was seen of a robot in some seconds: the doctor's raw material."""

from __future__ import annotations

import itertools
import statistics
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Generic, NamedTuple, TypeVar

from revnm_client.clock_probe import ClockProbe, ProbeReading
from revnm_client.json_payload import Scalar
from revnm_client.messages import Odometry, Plan, Scan
from revnm_client.senses import Senses
from revnm_client.server_ears import ServerEars

_LOOK_S = 0.005

MessageT = TypeVar("MessageT", Scan, Odometry, Plan)


@dataclass(frozen=True, slots=True)
class Received(Generic[MessageT]):
    """A message and when it came, nanoseconds, clock of this machine."""

    message: MessageT
    received_ns: int

    @property
    def lag_s(self) -> float:
        """Seconds from its stamp until it came; negative if stamped in the future."""
        return (self.received_ns - self.message.stamp_ns) * 1e-9


@dataclass(slots=True)
class Series(Generic[MessageT]):
    """The messages of one kind, in the order in which they came."""

    items: list[Received[MessageT]] = field(default_factory=list)

    def add(self, message: MessageT | None) -> None:
        """Take in a message that has just come, if one has."""
        if message is not None:
            self.items.append(Received(message, time.time_ns()))

    @property
    def messages(self) -> Sequence[MessageT]:
        """The messages alone."""
        return [item.message for item in self.items]

    @property
    def rate_hz(self) -> float:
        """Messages a second; 0 where fewer than two came."""
        gaps = self._gaps_s()
        return len(gaps) / sum(gaps) if sum(gaps) > 0.0 else 0.0

    @property
    def longest_gap_s(self) -> float:
        """Longest time from one to the next."""
        return max(self._gaps_s(), default=0.0)

    @property
    def lag_s(self) -> float:
        """The middle one of the times from stamp to arrival; call it where there is a message."""
        return statistics.median(item.lag_s for item in self.items)

    def _gaps_s(self) -> list[float]:
        times = [item.received_ns for item in self.items]
        return [(later - earlier) * 1e-9 for earlier, later in itertools.pairwise(times)]


@dataclass(slots=True)
class Observation:
    """What was seen.

    Attributes:
        seconds: How long was looked.
        scans: Of the LiDAR.
        odometry: Of the base.
        plans: Of the server.
        rejected: How many scans and odometries were malformed.
        last_error: Why the last one was.
        trouble: Why the base would not obey.
        clock: What is known of the server's clock; None where the server was not reached.
        state: The last state that a running client told; None where none did.
    """

    seconds: float
    scans: Series[Scan] = field(default_factory=Series)
    odometry: Series[Odometry] = field(default_factory=Series)
    plans: Series[Plan] = field(default_factory=Series)
    rejected: int = 0
    last_error: str = ""
    trouble: str | None = None
    clock: ProbeReading | None = None
    state: dict[str, Scalar] | None = None


class Server(NamedTuple):
    """What tells of the server.

    Attributes:
        ears: Hear its plans, and the state of the robot's client.
        probe: Asks for its time.
    """

    ears: ServerEars
    probe: ClockProbe


def observe(senses: Senses | None, server: Server | None, seconds: float) -> Observation:
    """Look for some seconds, or until interrupted.

    Args:
        senses: The robot's; None where it was not reached.
        server: None where it was not reached.
        seconds: How long to look.
    """
    seen = Observation(seconds)
    pause = threading.Event()
    deadline_s = time.monotonic() + seconds
    try:
        while time.monotonic() < deadline_s:
            _look(seen, senses, server)
            pause.wait(_LOOK_S)
    except KeyboardInterrupt:
        pass  # this is what was seen so far
    return seen


def _look(seen: Observation, senses: Senses | None, server: Server | None) -> None:
    if senses is not None:
        seen.odometry.add(senses.take_odometry())
        seen.scans.add(senses.take_scan())
        seen.rejected, seen.last_error = senses.rejected, senses.last_error
        seen.trouble = senses.trouble()
    if server is not None:
        seen.plans.add(server.ears.plans.take())
        seen.state = server.ears.states.take() or seen.state
        seen.clock = server.probe.reading()
