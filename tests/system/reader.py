"""A reader who has just cloned the repository, and types what a guide says into one shell."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from tests.server.waiting import eventually

from .guide import ROOT

_BIN = Path(sys.executable).parent
_PROGRAMS = ("revnm-robot", "revnm-server", "revnm-sim", "revnm-train")
# A network of one's own: ports that others use do not matter, and nothing is downloaded unnoticed.
_ALONE = (
    *("unshare", "--user", "--map-root-user", "--net", "--pid", "--fork", "--kill-child", "--mount-proc"),
    *("sh", "-c", 'ip link set lo up && exec "$@"', "sh"),
)


_PIECES = re.compile(r"(…|[\d.,]*\d)")
_NUMBER = r"[\d.,]*\d"


def clone(folder: Path) -> Path:
    """Copy what a clone would have, with a .venv that is this test's environment and can install nothing."""
    ignored = [line.strip("/") for line in (ROOT / ".gitignore").read_text().split()]
    shutil.copytree(ROOT, folder, ignore=shutil.ignore_patterns(".git", "tests", *ignored), symlinks=True)
    programs = folder / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name in _PROGRAMS:
        (programs / name).symlink_to(_BIN / name)
    _script(programs / "python", f'exec {shlex.quote(sys.executable)} "$@"')
    _script(programs / "pip", "echo 'this environment is borrowed: nothing is installed into it'; exit 1")
    (programs / "activate").write_text(f"PATH={shlex.quote(str(programs))}:$PATH\n")
    for stamp in ("run.stamp", "dev.stamp"):  # after all that make compares them with
        (folder / ".venv" / stamp).touch()
    return folder


def _script(path: Path, command: str) -> None:
    path.write_text(f"#!/bin/sh\n{command}\n")
    path.chmod(0o755)


def _alone() -> Sequence[str]:
    allowed = shutil.which("unshare") and subprocess.run([*_ALONE, "true"], capture_output=True, check=False)
    return _ALONE if allowed and allowed.returncode == 0 else ()


class Reader:
    """Types blocks of commands into one shell, in the clone; a context manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._log = folder.with_suffix(".log")
        self._typed = folder.with_suffix(".typed")
        self._typed.mkdir()
        home = folder.with_suffix(".home")
        home.mkdir()
        kept = {name: os.environ[name] for name in ("LANG", "PYTHONPATH") if name in os.environ}
        env = {**kept, "HOME": str(home), "PATH": f"{folder}/.venv/bin:{os.environ['PATH']}", "PYTHONUNBUFFERED": "1"}
        with self._log.open("wb") as log:
            self._shell = subprocess.Popen(
                [*_alone(), "bash", "--norc"],
                stdin=subprocess.PIPE, stdout=log, stderr=log, cwd=folder, env=env, text=True, start_new_session=True,
            )  # fmt: skip
        self._say("set -eo pipefail; trap : INT")  # the shell outlives the Ctrl-C that ends what it runs

    def __enter__(self) -> Self:
        return self

    def __exit__(self, fault: type[BaseException] | None, *_: object) -> None:
        assert self._shell.stdin is not None
        self._shell.stdin.close()
        if fault is not None:
            self._signal(signal.SIGTERM)
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._shell.wait(timeout=20.0)
        self._signal(signal.SIGKILL)
        self._shell.wait()

    @property
    def output(self) -> str:
        """All that was printed so far."""
        return self._log.read_text(errors="replace")

    def type(self, text: str, *, within_s: float) -> str:
        """Run commands; return what they print. Fails if one fails, or if they take longer."""
        seen, done = len(self.output), self._begin(text)
        self._wait(lambda: done.exists() or self._over(), within_s, seen)
        return self._checked(done, seen)

    def start(self, text: str, *, until: str, within_s: float) -> str:
        """Run a command that does not end by itself, wait until it prints a text, and press Ctrl-C; as :meth:`type`."""
        seen, done = len(self.output), self._begin(f"{{\n{text}\n}} || [ $? = 130 ]")
        self._wait(lambda: until in self.output[seen:] or done.exists() or self._over(), within_s, seen)
        assert until in self.output[seen:], f"ended before it printed {until!r}:\n{self.output[seen:]}"
        self._signal(signal.SIGINT)
        self._wait(lambda: done.exists() or self._over(), 60.0, seen)
        return self._checked(done, seen)

    def _wait(self, condition: Callable[[], bool], within_s: float, seen: int) -> None:
        try:
            eventually(condition, within_s=within_s)
        except AssertionError as late:
            raise AssertionError(f"not over within {within_s:.0f} s; printed so far:\n{self.output[seen:]}") from late

    def _begin(self, text: str) -> Path:
        number = len(list(self._typed.iterdir()))
        block, done = self._typed / f"{number}.sh", self._typed / f"{number}.done"
        block.write_text(text)
        self._say(f"source {shlex.quote(str(block))} </dev/null; touch {shlex.quote(str(done))}")
        return done

    def _checked(self, done: Path, seen: int) -> str:
        printed = self.output[seen:]
        assert done.exists(), f"failed with {self._shell.poll()}:\n{printed}"
        return printed

    def _signal(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):  # nothing of it runs any more
            os.killpg(self._shell.pid, number)

    def _over(self) -> bool:
        return self._shell.poll() is not None

    def _say(self, line: str) -> None:
        assert self._shell.stdin is not None
        self._shell.stdin.write(line + "\n")
        self._shell.stdin.flush()


def same_but_for_numbers(expected: str, printed: str) -> bool:
    """Return whether every line of the expected output was printed, in this order, whatever its numbers and names."""
    lines = [line.strip() for line in expected.splitlines() if line.strip() not in {"", "…"}]
    pattern = r".*".join(_line_pattern(line) for line in lines)
    return re.search(pattern, printed, re.DOTALL) is not None


def _line_pattern(line: str) -> str:
    return r"\s+".join("".join(map(_piece_pattern, _PIECES.split(word))) for word in line.split())


def _piece_pattern(piece: str) -> str:
    if piece == "…":
        return ".*"
    return _NUMBER if piece[-1:].isdigit() else re.escape(piece)
