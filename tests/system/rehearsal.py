"""Commands that cannot be run here are said to a shell that only notes them, and to the real parsers of the product.

The shell does what shells do with quotes, variables, continued lines and loops; no program runs in it.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from revnm_client import cli as robot
from revnm_server import cli as server
from revnm_sim import cli as sim
from revnm_training import cli as train

from .guide import ROOT, Block

_PARSERS: dict[str, Callable[[Sequence[str]], argparse.ArgumentParser]] = {
    "revnm-robot": robot.build_parser,
    "revnm-server": server.build_parser,
    "revnm-sim": sim.build_parser,
    "revnm-train": lambda _: train.build_parser(),
}
_FOLDERS = ("docs/", "robot_client/", "server/", "sim/", "training/", "docker/")
_PROLOGUE = r"""
command_not_found_handle() {
    [ "$1" = sudo ] && shift
    printf '%s\0' "$BLOCK" "$#" "$@" >> "$CALLS"
}
"""


@dataclass(frozen=True, slots=True)
class Call:
    """A program's name and arguments, and the block that says so."""

    place: str
    words: tuple[str, ...]


def calls(blocks: Sequence[Block], folder: Path) -> list[Call]:
    """Return what the shell would call for the commands of some blocks, without calling it."""
    folder.mkdir()
    noted = folder / "calls"
    noted.touch()
    for number, block in enumerate(blocks):
        said = folder / f"{number}.sh"
        said.write_text(_without_paths(block.text))
    script = _PROLOGUE + "".join(f"BLOCK={block.place}\nsource {n}.sh\nwait\n" for n, block in enumerate(blocks))
    env = {"PATH": "/nowhere", "CALLS": str(noted), "HOME": str(folder)}
    done = subprocess.run(
        ["/bin/bash"], input=script, cwd=folder, env=env, capture_output=True, text=True, timeout=30, check=False
    )
    assert "syntax error" not in done.stderr, done.stderr
    return list(_read(noted.read_text().split("\0")))


def _without_paths(text: str) -> str:
    """Return commands with programs named by their last part: no path is searched for in this shell."""
    return text.replace(".venv/bin/", "").replace("/opt/revnm/bin/", "")


def _read(fields: list[str]) -> list[Call]:
    found, at = [], 0
    while at + 1 < len(fields):
        place, count = fields[at], int(fields[at + 1])
        found.append(Call(place, tuple(fields[at + 2 : at + 2 + count])))
        at += 2 + count
    return found


def fault(call: Call) -> str | None:
    """Return what is wrong with a call: an option, a make target or a file that does not exist; None if nothing is."""
    program, *words = call.words
    missing = [word for word in words if word.removeprefix("./").startswith(_FOLDERS) and not _exists(word)]
    if missing:
        return f"{call.place}: no such file: {missing[0]}"
    if program == "make":
        done = subprocess.run(["make", "-n", *words], cwd=ROOT, capture_output=True, text=True, check=False)
        return f"{call.place}: {done.stderr}" if done.returncode else None
    if program in _PARSERS:
        return _parse_fault(call, words)
    return f"{call.place}: no such program: {program}" if program.startswith("revnm") else None


def _exists(word: str) -> bool:
    return (ROOT / word).exists()


def _parse_fault(call: Call, words: Sequence[str]) -> str | None:
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            _PARSERS[call.words[0]](words).parse_args(words)
    except SystemExit as ended:
        return f"{call.place}: {' '.join(call.words)}\n{said.getvalue()}" if ended.code else None
    return None
