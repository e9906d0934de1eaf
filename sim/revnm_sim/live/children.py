"""Child processes that live and die together, with a log file each."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

from revnm_client.errors import RevnmError

_LAST_LINES = 15
_GRACE_S = 5.0


class ChildError(RevnmError):
    """A child process ended that should not have; the text holds the end of its log."""


class Children:
    """Starts Python entry points as processes and ends whatever still runs when it is closed.

    The children get process groups of their own: Ctrl-C reaches this process only, which then ends them in the order
    in which they were started.
    """

    def __init__(self, log_folder: Path) -> None:
        self._log_folder = log_folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._started: dict[str, Callable[[], subprocess.Popen[bytes]]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, name: str, module: str, arguments: Sequence[str], *, env: Mapping[str, str]) -> None:
        """Start ``module.main()`` with arguments, as ``name``; its output goes to ``name.log``.

        Args:
            name: For logs and errors.
            module: What holds ``main() -> int``, for example ``revnm_server.cli``.
            arguments: The command line behind the program's name.
            env: Environment variables on top of this process's own.
        """
        self.log_path(name).write_bytes(b"")
        self._started[name] = partial(_start_process, module, arguments, env, self.log_path(name))
        self._running[name] = self._started[name]()

    def kill(self, name: str) -> None:
        """End a child at once, as a crash would; it is not missed until it is started again."""
        process = self._running.pop(name)
        process.kill()
        process.wait()

    def restart(self, name: str) -> None:
        """Start a killed child as before; its output follows that of its forerunner."""
        self._running[name] = self._started[name]()

    def send_signal(self, name: str, number: signal.Signals) -> None:
        """Send a signal to a child."""
        self._running[name].send_signal(number)

    def pid(self, name: str) -> int:
        """Return the process number of a child that was started."""
        return self._running[name].pid

    def log_path(self, name: str) -> Path:
        """Return where the output of a child goes."""
        return self._log_folder / f"{name}.log"

    def check(self) -> None:
        """Do nothing if all children run.

        Raises:
            ChildError: One has ended.
        """
        for name, process in self._running.items():
            status = process.poll()
            if status is not None:
                path = self.log_path(name)
                lines = path.read_text(encoding="utf-8", errors="replace").splitlines()[-_LAST_LINES:]
                raise ChildError("\n".join([f"{name} ended with status {status}; the end of {path}:", *lines]))

    def close(self) -> None:
        """Ask all children to end; kill those that do not within some seconds."""
        for process in self._running.values():
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        deadline_s = time.monotonic() + _GRACE_S
        for process in self._running.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, deadline_s - time.monotonic()))
            if process.poll() is None:
                process.kill()
                process.wait()
        self._running.clear()


def _start_process(
    module: str, arguments: Sequence[str], env: Mapping[str, str], log_path: Path
) -> subprocess.Popen[bytes]:
    code = f"import sys; from {module} import main; sys.exit(main())"
    with log_path.open("ab") as log:
        return subprocess.Popen(  # noqa: S603 - our own interpreter and modules
            [sys.executable, "-u", "-c", code, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env={**os.environ, **env},
            start_new_session=True,
        )
