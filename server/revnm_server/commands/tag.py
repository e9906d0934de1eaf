"""``revnm-server tag``: a PDF of tags to print and cut out."""

from __future__ import annotations

import argparse
from contextlib import suppress
from pathlib import Path

from revnm_client.errors import ConfigError, FileError
from revnm_server.tag.sheet import PAPERS_MM, Sheet, checked_sheet, render_sheets


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add = parser.add_argument
    add("--id", type=int, action="append", required=True, metavar="TAG", help="which tag; again for more pages")
    add("--size", type=float, required=True, metavar="M", help="side of the black square, metres")
    add("--paper", choices=tuple(PAPERS_MM), help="what it is printed on (the smallest of a4, a3, a2 that it fits)")
    add("--out", type=Path, default=Path("tag.pdf"), metavar="FILE", help="the PDF (tag.pdf)")


def run(options: argparse.Namespace) -> int:
    """Write the PDF; return 0.

    Raises:
        ConfigError: A tag does not exist, is asked for twice or does not fit the paper.
        FileError: The file cannot be written.
    """
    if len(set(options.id)) < len(options.id):
        raise ConfigError(f"--id {' --id '.join(map(str, options.id))}: expected every tag once")
    size_mm = round(options.size * 1e3, 3)
    sheets = [checked_sheet(tag_id=each, size_mm=size_mm, paper=options.paper) for each in options.id]
    _write(options.out, render_sheets(sheets))
    print(f"{options.out}: {_described(sheets)}; print at 100 % on {sheets[0].paper.upper()}")
    return 0


def _described(sheets: list[Sheet]) -> str:
    ids = ", ".join(str(sheet.tag_id) for sheet in sheets)
    return f"tag{'s' if len(sheets) > 1 else ''} {ids}, the black square {sheets[0].size_mm:g} mm"


def _write(path: Path, content: bytes) -> None:
    """Write a file; it appears whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise FileError(f"--out {path}: {error.strerror}") from error
