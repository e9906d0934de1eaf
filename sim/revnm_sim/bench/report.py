"""``report.json`` and the table on the terminal, with the versions of what the simulator's figures depend on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from revnm_server import report
from revnm_server.report import make_folder, table

__all__ = ["make_folder", "table", "write_report"]

_PACKAGES = ("revnm-client", "revnm-server", "revnm-sim", "numpy", "numba", "onnxruntime", "pybullet")


def write_report(
    path: Path, rows: Sequence[dict[str, Any]], command: str, *, comparisons: Sequence[dict[str, Any]] | None = None
) -> None:
    """Write a report: :func:`revnm_server.report.write_report`."""
    report.write_report(path, rows, command, packages=_PACKAGES, comparisons=comparisons)
