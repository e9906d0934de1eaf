"""What the service shows of each tick to whoever keeps a record of it: the port of the recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from revnm_server.frame import Frame
from revnm_server.robots.mission import Goal
from revnm_server.tick.pipeline import TickResult
from revnm_server.views.view import RecordingView


@dataclass(frozen=True, slots=True)
class ObservedTick:
    """One tick; nothing in it is changed afterwards.

    Attributes:
        frame: What the pipeline saw.
        goals: Where the robots were to go.
        result: What it made of them; None where it failed.
        published: The robots whose plan was sent.
    """

    frame: Frame
    goals: Mapping[str, Goal]
    result: TickResult | None
    published: frozenset[str]


class TickRecorder(Protocol):
    """Keeps a record of the ticks while it is told to."""

    def observe(self, tick: ObservedTick) -> None:
        """Take a tick; runs in the tick's thread, never blocks and never raises."""
        ...

    def start(self) -> RecordingView:
        """Begin a record, unless one is being written; return what there is now. May wait for the disk.

        Raises:
            RevnmError: Nothing can be recorded; the text says why.
        """
        ...

    def stop(self) -> RecordingView:
        """End the record, if one is being written; return what became of it. May wait for the disk."""
        ...

    def view(self) -> RecordingView:
        """Return what there is to show of the record; never waits for the disk."""
        ...
