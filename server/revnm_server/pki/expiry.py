"""Tells of certificates before they end: links would fail from one moment to the next."""

from __future__ import annotations

import datetime
import logging
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from revnm_client.errors import FileError
from revnm_server.pki.folder import read_certificate

_log = logging.getLogger(__name__)

_WARN_BEFORE = datetime.timedelta(days=30)
_LOOK_EVERY_S = 3600.0


@dataclass(frozen=True, slots=True)
class Ending:
    """A certificate that ends within a month, or has ended.

    Attributes:
        text: Which, when, and what to do.
        over: It has ended: nobody takes it any more.
    """

    text: str
    over: bool


def endings(paths: Iterable[Path], now: datetime.datetime) -> Iterator[Ending]:
    """Yield those that end soon.

    Args:
        paths: PEM files.
        now: With its time zone.

    Raises:
        FileError: One cannot be read.
    """
    for path in dict.fromkeys(paths):
        ends = read_certificate(path).ends
        if ends <= now:
            yield Ending(f"{path} ended on {ends:%Y-%m-%d}: make a new one (revnm-server pki)", over=True)
        elif ends - now < _WARN_BEFORE:
            yield Ending(f"{path} ends on {ends:%Y-%m-%d}: make a new one (revnm-server pki)", over=False)


class CertificateWatch:
    """Looks at certificates once an hour, for whoever is shown what is odd.

    Args:
        paths: Tells which; asked anew each time.
        now: Tells the time.
        clock_s: Tells how much time has passed.
    """

    def __init__(
        self,
        paths: Callable[[], Iterable[Path]],
        *,
        now: Callable[[], datetime.datetime] = lambda: datetime.datetime.now(datetime.UTC),
        clock_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._paths, self._now, self._clock_s = paths, now, clock_s
        self._looked_s = -_LOOK_EVERY_S
        self._notes: list[str] = []

    def notes(self) -> list[str]:
        """Return which end soon, or cannot be read."""
        if self._clock_s() - self._looked_s >= _LOOK_EVERY_S:
            self._looked_s = self._clock_s()
            before, self._notes = self._notes, self._look()
            for note in self._notes:
                if note not in before:
                    _log.warning(note)
        return self._notes

    def _look(self) -> list[str]:
        try:
            return [each.text for each in endings(self._paths(), self._now())]
        except FileError as error:
            return [str(error)]
