"""``report.json`` of the simulator's commands: as the server's, with versions and comparisons of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from revnm_server import report
from revnm_server.report import make_folder, table

__all__ = ["make_folder", "table", "write_report"]

_PACKAGES = (*report.PACKAGES, "revnm-sim", "pybullet")


def write_report(
    path: Path,
    rows: Sequence[Mapping[str, Any]],
    command: str,
    *,
    more: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
) -> None:
    """Write a report; it appears whole or not at all.

    Args:
        path: ``report.json``.
        rows: One flat object a row, snake_case keys with units.
        command: The command line that made it.
        more: Other tables, by name.
    """
    report.write_report(path, rows, command, packages=_PACKAGES, more=more)
