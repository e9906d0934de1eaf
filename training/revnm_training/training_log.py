"""The logs of a training run: ``training.csv`` and ``validation.csv``, one row a report."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path


class TrainingLog:
    """Appends rows; on resuming, rows after the checkpoint are dropped first."""

    def __init__(self, folder: Path, step: int) -> None:
        self._training = folder / "training.csv"
        self._validation = folder / "validation.csv"
        for path in (self._training, self._validation):
            _drop_after(path, step)

    def training(self, step: int, row: Mapping[str, float]) -> None:
        """Add losses and rates of a step."""
        _append(self._training, step, row)

    def validation(self, step: int, row: Mapping[str, float]) -> None:
        """Add what was measured on held-out data after a step."""
        _append(self._validation, step, row)


def _append(path: Path, step: int, row: Mapping[str, float]) -> None:
    is_new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(["step", *row])
        writer.writerow([step, *(f"{value:.6g}" for value in row.values())])


def _drop_after(path: Path, step: int) -> None:
    if not path.exists():
        return
    header, *rows = path.read_text(encoding="utf-8").splitlines()
    kept = [row for row in rows if int(row.split(",", 1)[0]) <= step]
    path.write_text("\n".join([header, *kept]) + "\n", encoding="utf-8")
