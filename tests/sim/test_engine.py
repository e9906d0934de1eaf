"""Where trials run makes no difference: local processes and a Dask cluster give the same; failures come out."""

from __future__ import annotations

from dataclasses import replace

import pytest
from distributed import LocalCluster

from revnm_client.errors import ConfigError, LinkError
from revnm_sim.bench.trial import TrialKey, TrialResult, run_trial
from revnm_sim.engine import Engine

KEYS = [
    TrialKey("demo_room", "expert", "truth", 7, pair, camera, 0, 2, "any", "", "", "")
    for pair in range(10)
    for camera in range(2)
]


def timeless(results: dict[TrialKey, TrialResult]) -> dict[TrialKey, TrialResult]:
    return {key: replace(result, tick_p50_ms=0.0, robot_tick_p50_ms=0.0) for key, result in results.items()}


@pytest.mark.slow
def test_a_dask_cluster_gives_what_local_processes_give() -> None:
    local = dict(Engine("local", 2).map(run_trial, KEYS))
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        far = dict(Engine("dask", 2, cluster.scheduler_address).map(run_trial, KEYS))
    assert len(local) == 20
    assert timeless(far) == timeless(local)
    assert sum(result.success for result in local.values()) >= 19


def test_one_process_gives_what_two_give() -> None:
    one, two = (dict(Engine("local", jobs).map(run_trial, KEYS[:4])) for jobs in (1, 2))
    assert timeless(one) == timeless(two)


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_trial_raises_comes_out(jobs: int) -> None:
    with pytest.raises(ConfigError, match="'moon'"):
        list(Engine("local", jobs).map(run_trial, [replace(KEYS[0], world="moon")] * 3))


def test_a_scheduler_that_does_not_answer_is_told() -> None:
    with pytest.raises(LinkError, match=r"--address tcp://127\.0\.0\.1:1: no Dask scheduler answers"):
        list(Engine("dask", 1, "tcp://127.0.0.1:1").map(run_trial, KEYS[:1]))
