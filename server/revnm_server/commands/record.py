"""``revnm-server record``: switch a server's record on and off, mend records that were cut, measure what it costs."""

from __future__ import annotations

import argparse
import os
import shlex
from pathlib import Path
from typing import Any

from revnm_client.errors import ConfigError, FileError
from revnm_server.api_client import ServerAddress, call
from revnm_server.recording.recovery import recover
from revnm_server.report import make_folder, table, write_report

_SIZES_PX = ((640, 480), (1920, 1080))
_TIMEOUT_S = 30.0  # a stop waits for the disk
_TOKEN = "REVNM_HTTP__TOKEN"  # noqa: S105 - the name of the variable


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's actions and their options."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for name, text in (
        ("start", "begin a record on a running server"),
        ("stop", "end it"),
        ("status", "tell of the record that is written, or of the last one"),
    ):
        action = actions.add_parser(name, help=text, description=text)
        action.add_argument("--server", default="http://127.0.0.1:8000", metavar="URL", help="(%(default)s)")
        action.add_argument("--token-file", type=Path, metavar="FILE", help=f"holds the token (else {_TOKEN})")
        action.add_argument("--certificate", type=Path, metavar="FILE", help="the server's own, where it serves HTTPS")
    text = "make a readable file of a cut or damaged one, next to it"
    actions.add_parser("recover", help=text, description=text).add_argument("file", type=Path, metavar="FILE")
    text = "measure what recording costs: of a tick, of a core, and of the disk"
    bench = actions.add_parser("bench", help=text, description=text)
    bench.add_argument("--seconds", type=float, default=20.0, metavar="S", help="of each recording (%(default)s)")
    bench.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for report.json")


def run(options: argparse.Namespace) -> int:
    """Do it and say what became of it; return 0, or 1 from ``status`` where a record failed.

    Raises:
        RevnmError: It cannot be done; the text says what to mend.
    """
    if options.action == "recover":
        return _recover(options.file)
    if options.action == "bench":
        return _bench(options.out, options.seconds)
    address = ServerAddress(options.server, _token(options.token_file), options.certificate)
    if options.action == "status":
        record = call(address, "GET", "/api/v1/recording", within_s=_TIMEOUT_S)
    else:
        record = call(address, "POST", f"/api/v1/recording/{options.action}", within_s=_TIMEOUT_S)
    print(_described(record))
    return 1 if options.action == "status" and record["reason"] else 0


def _recover(path: Path) -> int:
    saved = recover(path)
    lost = f", {saved.damaged} damaged places" if saved.damaged else ""
    lost += f", {saved.orphans} messages of unknown topics" if saved.orphans else ""
    print(f"{saved.path}: {saved.messages} messages saved{lost}")
    return 0


def _bench(folder: Path, seconds: float) -> int:
    from revnm_server.recording.cost import measure  # the other actions need not wait for its imports

    if not 0.1 <= seconds <= 3600.0:
        raise ConfigError(f"--seconds {seconds}: expected 0.1 to 3600")
    make_folder(folder)
    rows = [measure(size, original=original, seconds=seconds) for size in _SIZES_PX for original in (True, False)]
    write_report(
        folder / "report.json", rows, shlex.join(["revnm-server", "record", "bench", "--seconds", str(seconds)])
    )
    print(table(rows))
    return 0


def _described(record: dict[str, Any]) -> str:
    if record["name"] is None:
        return f"nothing is recorded: {record['reason']}" if record["reason"] else "nothing is recorded"
    doing = "recording" if record["active"] else "recorded"
    text = f"{doing} {record['name']}: {record['size_mb']} MB, {record['messages']} messages"
    text += f" in {record['duration_s']} s, {record['dropped']} dropped, {record['refused']} malformed"
    return text + (f"; {record['reason']}" if record["reason"] else "")


def _token(path: Path | None) -> str | None:
    if path is None:
        return os.environ.get(_TOKEN)
    try:
        return path.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"--token-file {path}: {error}") from error
