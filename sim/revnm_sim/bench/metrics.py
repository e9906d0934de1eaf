"""Rows of the benchmark's report from the results of its trials: one per method, and one per two methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from revnm_client.geometry import FloatArray
from revnm_sim.bench.statistics import Interval, bootstrap_mean, mcnemar_p, rate_interval
from revnm_sim.bench.trial import TrialKey, TrialResult

Results = Mapping[TrialKey, TrialResult]
Place = tuple[int, int, int]  # pair, camera, repeat
Group = tuple[str, str, str]  # world, method, perception

HIDDEN_M = 1.0
"""From so much of the planner's way on unseen floor on, a trial counts among the hidden ones."""


def spl(results: Sequence[TrialResult], *, length: Callable[[TrialResult], float]) -> FloatArray:
    """Return success weighted by path length of each trial (M,).

    Source: Anderson et al., 2018, arXiv:1807.06757.

    Args:
        results: The trials.
        length: Picks the reference. The paper's is the planner's way; a trial ends at the goal's radius, the way at
            the goal itself.
    """
    return np.array([r.success * length(r) / max(r.path_m, length(r)) for r in results])


def rows(results: Results) -> list[dict[str, Any]]:
    """Return one flat row per world, method and perception, in the order of the trials."""
    first: dict[Group, TrialKey] = {(key.world, key.method, key.perception): key for key in reversed(list(results))}
    return [{**_row(*group, members), **_origin(first[group])} for group, members in _groups(results).items()]


def comparisons(results: Results) -> list[dict[str, Any]]:
    """Return one flat row per two methods of a world and perception, over the trials that both have."""
    groups = _groups(results)
    return [
        _comparison((first, groups[first]), (second, groups[second]))
        for first, second in combinations(groups, 2)
        if first[::2] == second[::2]
    ]


def _groups(results: Results) -> dict[Group, dict[Place, TrialResult]]:
    groups: dict[Group, dict[Place, TrialResult]] = {}
    for key, result in results.items():
        members = groups.setdefault((key.world, key.method, key.perception), {})
        members[key.pair, key.camera, key.repeat] = result
    return groups


def _origin(key: TrialKey) -> dict[str, Any]:
    """Return what the trials of a group were made from."""
    return {
        "seed": key.seed,
        "pairs_rule": key.rule,
        "world_sha256": key.world_sha256 or None,
        "manifest_sha256": key.manifest_sha256 or None,
    }


def _row(world: str, method: str, perception: str, members: Mapping[Place, TrialResult]) -> dict[str, Any]:
    results = list(members.values())
    succeeded = np.array([r.success for r in results], dtype=np.float64)
    collided = np.array([r.collision for r in results], dtype=np.float64)
    late = np.array([r.timeout for r in results], dtype=np.float64)
    weighted = spl(results, length=lambda r: r.expert_m)
    conditions = [place[:2] for place in members]
    pairs = [place[0] for place in members]
    return {
        "world": world,
        "method": method,
        "perception": perception,
        "trials": len(results),
        "success_rate": _mean(succeeded),
        **_named("success", rate_interval(succeeded, conditions)),
        **_named("success_by_pair", rate_interval(succeeded, pairs)),
        "spl": _mean(weighted),
        **_named("spl", bootstrap_mean(weighted, conditions)),
        **_named("spl_by_pair", bootstrap_mean(weighted, pairs)),
        "spl_geodesic": _mean(spl(results, length=lambda r: r.geodesic_m)),
        "collisions": sum(r.collision for r in results),
        "timeouts": sum(r.timeout for r in results),
        "collision_rate": _mean(collided),
        **_named("collision", rate_interval(collided, conditions)),
        "timeout_rate": _mean(late),
        **_named("timeout", rate_interval(late, conditions)),
        "blocked_rate": _mean([r.blocked for r in results]),
        **_hidden_row(results),
        "least_clearance_m": round(min(r.closest_m for r in results), 3),
        "median_clearance_m": round(float(np.median([r.closest_m for r in results])), 3),
        "mean_success_s": _mean([r.duration_s for r in results if r.success], digits=2),
        "p50_tick_ms": round(float(np.median([r.tick_p50_ms for r in results])), 3),
        "p50_robot_tick_ms": round(float(np.median([r.robot_tick_p50_ms for r in results])), 3),
    }


def _hidden_row(results: Sequence[TrialResult]) -> dict[str, Any]:
    hidden = [r for r in results if r.hidden_m >= HIDDEN_M]
    return {
        "hidden_trials": len(hidden),
        "hidden_success_rate": _mean([r.success for r in hidden]),
        "hidden_spl": _mean(spl(hidden, length=lambda r: r.expert_m)),
    }


def _comparison(
    first: tuple[Group, Mapping[Place, TrialResult]], second: tuple[Group, Mapping[Place, TrialResult]]
) -> dict[str, Any]:
    world, method, perception = first[0]
    shared = [place for place in first[1] if place in second[1]]
    a, b = (np.array([members[place].success for place in shared]) for _, members in (first, second))
    difference = a.astype(np.float64) - b
    only = int((a & ~b).sum()), int((b & ~a).sum())
    hidden = np.array([first[1][place].hidden_m >= HIDDEN_M for place in shared])
    return {
        "world": world,
        "perception": perception,
        "method": method,
        "other": second[0][1],
        "trials": len(shared),
        "only_method": only[0],
        "only_other": only[1],
        "difference": _mean(difference),
        **_named("difference", bootstrap_mean(difference, [place[:2] for place in shared])),
        **_named("difference_by_pair", bootstrap_mean(difference, [place[0] for place in shared])),
        "mcnemar_p": float(f"{mcnemar_p(*only):.3g}"),
        "hidden_trials": int(hidden.sum()),
        "hidden_difference": _mean(difference[hidden]),
    }


def _named(name: str, interval: Interval) -> dict[str, float]:
    return {f"{name}_low": round(interval.low, 4), f"{name}_high": round(interval.high, 4)}


def _mean(values: Sequence[float] | FloatArray, *, digits: int = 4) -> float | None:
    return round(float(np.mean(values)), digits) if len(values) else None
