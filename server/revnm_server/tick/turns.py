"""Who of many has a turn: what is not urgent is done for a few at a time, so that ticks stay short with many robots."""

from __future__ import annotations

from collections.abc import Iterable


class Turns:
    """Gives turns by name: first to those who never had one, then to those whose last one is longest ago."""

    def __init__(self, at_once: int) -> None:
        """Begin.

        Args:
            at_once: How many have a turn together, at most.
        """
        self._at_once = at_once
        self._last: dict[str, int] = {}
        self._given = 0

    def next(self, names: Iterable[str]) -> list[str]:
        """Return those of these names who have their turn now, in the order in which they are given."""
        waiting = list(names)
        chosen = sorted(waiting, key=lambda name: self._last.get(name, 0))[: self._at_once]
        for name in chosen:
            self._given += 1
            self._last[name] = self._given
        return [name for name in waiting if name in chosen]
