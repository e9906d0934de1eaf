"""One of the product's commands as a real process, with a log file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Self

# Several processes share the machine's cores: a pool of threads each would only make them wait for each other.
_ENV = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


class Process:
    """Runs a command until it ends or the block is left; a context manager."""

    def __init__(self, program: str, arguments: Sequence[str], *, log: Path, prefix: Sequence[str] = ()) -> None:
        """Start it.

        Args:
            program: Beside this Python.
            arguments: Of the program.
            log: What it says is added to this.
            prefix: What stands before the command; it must become the command, not start it.
        """
        self._log = log
        command = [*prefix, str(Path(sys.executable).with_name(program)), *arguments]
        with log.open("ab") as output:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, env={**os.environ, **_ENV}
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()

    @property
    def output(self) -> str:
        """What it and its forerunners with the same log have said so far."""
        return self._log.read_text(errors="replace")

    @property
    def status(self) -> int | None:
        """Exit status; None while it runs."""
        return self._process.poll()

    def check(self) -> None:
        """Fail if it has ended."""
        assert self.status is None, f"ended with {self.status}:\n{self.output}"

    def signal(self, number: signal.Signals) -> None:
        """Send a signal; after one that kills at once, wait for the end."""
        self._process.send_signal(number)
        if number is signal.SIGKILL:
            self._process.wait()
