"""``report.json`` of commands that measure, and their table on the terminal."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from revnm_client.errors import FileError


def make_folder(path: Path) -> None:
    """Make a folder for what a command writes, where there is none.

    Raises:
        FileError: It cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileError(f"--out {path}: expected a folder that can be made: {error.strerror}") from error


def write_report(
    path: Path,
    rows: Sequence[Mapping[str, Any]],
    command: str,
    *,
    packages: Sequence[str],
    more: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
) -> None:
    """Write a report; it appears whole or not at all.

    Args:
        path: ``report.json``.
        rows: One flat object a row, snake_case keys with units.
        command: The command line that made it.
        packages: Whose versions to note.
        more: Other tables, by name.
    """
    report: dict[str, Any] = {
        "rows": list(rows),
        **{name: list(table) for name, table in (more or {}).items()},
        "command": command,
        "versions": {**installed_versions(packages), "python": platform.python_version()},
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
    }
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    partial.replace(path)


def installed_versions(packages: Sequence[str]) -> dict[str, str | None]:
    """Return the version of each package; None where another takes its place, as onnxruntime-gpu does."""
    return {name: _version(name) for name in packages}


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the rows as a Markdown table; all rows have the same keys."""
    if not rows:
        return ""
    keys = list(rows[0])
    cells = [keys, *([_cell(row[key]) for key in keys] for row in rows)]
    widths = [max(len(line[column]) for line in cells) for column in range(len(keys))]
    lines = ["| " + " | ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) + " |" for line in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def _cell(value: Any) -> str:
    return "" if value is None else str(value)


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
