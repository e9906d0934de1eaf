"""Tells of certificates before they end: links would fail from one moment to the next."""

from __future__ import annotations

import datetime
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from revnm_server.pki.folder import read_certificate

_WARN_BEFORE = datetime.timedelta(days=30)


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
