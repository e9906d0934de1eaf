"""All that a finished benchmark leaves in its folder."""

from __future__ import annotations

from pathlib import Path

from revnm_sim.bench.ego_strip import draw_ego_strip
from revnm_sim.bench.figures import draw_trajectories
from revnm_sim.bench.markdown import markdown, summary
from revnm_sim.bench.metrics import Results, comparisons, rows
from revnm_sim.bench.report import write_report


def publish(results: Results, out: Path, command: str) -> str:
    """Write ``report.json``, ``report.md`` and its pictures into a folder.

    Args:
        results: All trials.
        out: The folder.
        command: The command line that made them.

    Returns:
        The table for the terminal.
    """
    found, compared = rows(results), comparisons(results)
    write_report(out / "report.json", found, command, more={"comparisons": compared})
    draw_trajectories(results, out / "trajectories.png")
    figures = ["trajectories.png"]
    if draw_ego_strip(results, out / "ego_depth.png"):
        figures.append("ego_depth.png")
    (out / "report.md").write_text(markdown(found, compared, figures, command), encoding="utf-8")
    return summary(found)
