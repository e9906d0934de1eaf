"""Reports of commands that measure the server's code: :mod:`revnm_client.report`, with the versions of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from revnm_client.report import installed_versions, make_folder, table
from revnm_client.report import write_report as _write_report

__all__ = ["PACKAGES", "installed_versions", "make_folder", "table", "write_report"]

PACKAGES = ("revnm-client", "revnm-server", "numpy", "numba", "onnxruntime")
"""Whose versions matter wherever the server's code is measured."""


def write_report(
    path: Path,
    rows: Sequence[Mapping[str, Any]],
    command: str,
    *,
    packages: Sequence[str] = PACKAGES,
    more: Mapping[str, Sequence[Mapping[str, Any]]] | None = None,
) -> None:
    """Write a report; see :func:`revnm_client.report.write_report`."""
    _write_report(path, rows, command, packages=packages, more=more)
