"""Rows of the benchmark's report from the results of its trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from revnm_sim.bench.trial import TrialKey, TrialResult


def spl(results: Sequence[TrialResult]) -> float:
    """Return success weighted by path length, with the expert's way as reference.

    Source: Anderson et al., 2018, arXiv:1807.06757; the reference is the planner's path, as in the paper.
    """
    return float(np.mean([r.success * r.expert_m / max(r.path_m, r.expert_m) for r in results]))


def rows(results: Mapping[TrialKey, TrialResult]) -> list[dict[str, Any]]:
    """Return one flat row per world, method and perception, in the order of the trials."""
    groups: dict[tuple[str, str, str], list[TrialResult]] = {}
    for key, result in results.items():
        groups.setdefault((key.world, key.method, key.perception), []).append(result)
    return [_row(*group, members) for group, members in groups.items()]


def _row(world: str, method: str, perception: str, results: Sequence[TrialResult]) -> dict[str, Any]:
    successes = [r for r in results if r.success]
    return {
        "world": world,
        "method": method,
        "perception": perception,
        "trials": len(results),
        "success_rate": round(len(successes) / len(results), 4),
        "spl": round(spl(results), 4),
        "collisions": sum(r.collision for r in results),
        "timeouts": sum(r.timeout for r in results),
        "blocked_rate": round(sum(r.blocked for r in results) / len(results), 4),
        "mean_success_s": round(float(np.mean([r.duration_s for r in successes])), 2) if successes else None,
        "p50_tick_ms": round(float(np.median([r.tick_p50_ms for r in results])), 3),
        "p50_robot_tick_ms": round(float(np.median([r.robot_tick_p50_ms for r in results])), 3),
    }
