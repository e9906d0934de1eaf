"""What each tick heard of the robots, and in which turn: a replay must hear the same."""

from __future__ import annotations

from typing import NamedTuple

from revnm_server.ports import Heard, Senses


class Listening(NamedTuple):
    """One robot was listened to once."""

    robot: str
    heard: Heard


class HeardLog:
    """Listens along with the pipeline; used by the tick's thread alone."""

    def __init__(self) -> None:
        self._listenings: list[Listening] = []

    def along(self, robot: str, senses: Senses) -> Senses:
        """Return the senses of a robot, of which from now on everything is noted that they hear."""
        return _Noted(robot, senses, self._listenings)

    def take(self) -> tuple[Listening, ...]:
        """Return what was heard since the last time, in its order."""
        taken = tuple(self._listenings)
        self._listenings.clear()
        return taken


class _Noted:
    def __init__(self, robot: str, senses: Senses, listenings: list[Listening]) -> None:
        self._robot, self._senses, self._listenings = robot, senses, listenings

    @property
    def rejected(self) -> dict[str, int]:
        return self._senses.rejected

    def listen(self) -> Heard:
        heard = self._senses.listen()
        self._listenings.append(Listening(self._robot, heard))
        return heard
