"""Pictures of a training run: its losses, and how well its checkpoints drive."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from revnm_client.geometry import FloatArray
from revnm_sim.bench.statistics import rate_interval

LOSS_PICTURE = "loss.png"
SUCCESS_PICTURE = "success.png"
_PANEL_IN = (4.0, 2.6)
_COLUMNS = 3


@dataclass(frozen=True, slots=True)
class RoundResult:
    """How well a checkpoint drives.

    Attributes:
        step: Training steps up to it.
        label: What it is called.
        success_rate: Share of its drives that arrived.
        spl: Success weighted by path length, the mean.
        trials: How many drives.
    """

    step: int
    label: str
    success_rate: float
    spl: float
    trials: int


def plot_success(out: Path, results: Sequence[RoundResult]) -> None:
    """Draw SR with its 95 % interval and SPL over the checkpoints into ``success.png``."""
    figure = _figure(1, 1)
    axes = figure.add_subplot()
    steps = [result.step for result in results]
    rates = np.array([result.success_rate for result in results])
    axes.errorbar(steps, rates, yerr=_error_bars(results), marker="o", capsize=3.0, label="SR, 95 %")
    axes.plot(steps, [result.spl for result in results], marker="s", label="SPL")
    axes.set_xticks(steps, [f"{result.label}\nstep {result.step}" for result in results])
    axes.set_ylim(0.0, 1.02)
    axes.grid(alpha=0.3)
    axes.legend(loc="lower right")
    figure.savefig(out / SUCCESS_PICTURE)


def plot_losses(folder: Path) -> None:
    """Draw every column of a run's ``training.csv`` and ``validation.csv`` over its steps into ``loss.png``."""
    panels = _panels(folder / "training.csv") + _panels(folder / "validation.csv", marker="o")
    rows = -(-len(panels) // _COLUMNS)
    figure = _figure(rows, min(_COLUMNS, len(panels)))
    for number, (name, steps, values, marker) in enumerate(panels, start=1):
        axes: Axes = figure.add_subplot(rows, min(_COLUMNS, len(panels)), number)
        axes.plot(steps, values, marker=marker, markersize=3.0, linewidth=1.0)
        axes.set_title(name, fontsize=9)
        axes.tick_params(labelsize=7)
        axes.grid(alpha=0.3)
    figure.savefig(folder / LOSS_PICTURE)


def _figure(rows: int, columns: int) -> Figure:
    figure = Figure(figsize=(_PANEL_IN[0] * columns, _PANEL_IN[1] * rows), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _panels(path: Path, marker: str = "") -> list[tuple[str, FloatArray, FloatArray, str]]:
    """Return (name, steps, values, marker) of each column of a log; none where it is not there yet."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        return []
    steps = np.array([float(row["step"]) for row in rows])
    return [(name, steps, np.array([float(row[name]) for row in rows]), marker) for name in rows[0] if name != "step"]


def _error_bars(results: Sequence[RoundResult]) -> FloatArray:
    """Return how far the intervals reach below and above the rates, (2, M)."""
    bars = []
    for result in results:
        successes = np.arange(result.trials) < round(result.success_rate * result.trials)
        interval = rate_interval(successes.astype(np.float64), range(result.trials))
        bars.append((result.success_rate - interval.low, interval.high - result.success_rate))
    return np.asarray(np.maximum(0.0, np.array(bars).T))
