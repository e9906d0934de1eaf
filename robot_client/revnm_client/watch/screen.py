"""The terminal as a picture that is drawn again and again, by plain ANSI sequences."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Self, TextIO

from revnm_client.watch.picture import Size

_ENTER = "\x1b[?1049h\x1b[?25l"  # the other screen, no cursor
_LEAVE = "\x1b[?25h\x1b[?1049l"
_CLEAR = "\x1b[2J"
_HOME = "\x1b[H"
_CLEAR_LINE = "\x1b[2K"
_REVERSE = "\x1b[7m"
_PLAIN = "\x1b[0m"


class Screen:
    """Covers the terminal; as a context manager it leaves it as it was."""

    def __init__(self, terminal: TextIO) -> None:
        self._terminal = terminal
        self._size = Size(0, 0)

    @property
    def size(self) -> Size:
        """The terminal's size now."""
        columns, lines = os.get_terminal_size(self._terminal.fileno())
        return Size(columns, lines)

    def show(self, lines: Sequence[str], size: Size) -> None:
        """Draw lines that were made for a size; the first one stands out."""
        first, *others = lines
        shown = [f"{_REVERSE}{first.ljust(size.columns)}{_PLAIN}", *others]
        cleared = _CLEAR if size != self._size else ""
        self._size = size
        # A line is cleared before it is written: after its last column, clearing would take the character there.
        self._write(cleared + _HOME + "\r\n".join(_CLEAR_LINE + line for line in shown))

    def __enter__(self) -> Self:
        self._write(_ENTER)
        return self

    def __exit__(self, *_: object) -> None:
        self._write(_LEAVE)

    def _write(self, text: str) -> None:
        self._terminal.write(text)
        self._terminal.flush()
