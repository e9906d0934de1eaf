"""What a command ends with: its exit status, and one line where it cannot go on."""

from __future__ import annotations

import io
import os
import select
import sys
from collections.abc import Callable

from revnm_client.errors import RevnmError

INTERRUPTED = 130
WRONG = 2
_NOBODY_READS = 141  # as of a program that the signal SIGPIPE has ended


def exit_status(program: str, command: Callable[[], int], *, stopped: str = "stopped") -> int:
    """Run a command and return its exit status.

    Args:
        program: Its name, for what is said on standard error.
        command: Returns its own status. RevnmError makes it 2: what is wrong can be mended by who called. After Ctrl-C
            it is 130; where nobody reads what it prints any more, as after ``| head``, 141 without a word.
        stopped: What is said after Ctrl-C.
    """
    try:
        status = _status(program, command, stopped)
        if sys.stdout is not None:  # it was closed before the start
            sys.stdout.flush()
    except BrokenPipeError:
        if _is_read():
            raise
        return _NOBODY_READS
    return status


def _status(program: str, command: Callable[[], int], stopped: str) -> int:
    try:
        return command()
    except RevnmError as error:
        print(f"{program}: {error}", file=sys.stderr)
        return WRONG
    except KeyboardInterrupt:
        print(f"{program}: {stopped}", file=sys.stderr)
        return INTERRUPTED


def _is_read() -> bool:
    """Return whether standard output still has a reader; where it has none, what is left to print goes nowhere."""
    try:
        output = sys.stdout.fileno()
    except io.UnsupportedOperation:  # it is no file
        return True
    look = select.poll()
    look.register(output, 0)
    if not look.poll(0):
        return True
    os.dup2(os.open(os.devnull, os.O_WRONLY), output)
    return False
