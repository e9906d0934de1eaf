"""Where work runs: processes on this machine, or a Ray or Dask cluster, all through joblib."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, TypeVar

from joblib import Parallel, delayed, parallel_config

from revnm_client.errors import ConfigError, LinkError

EngineName = Literal["local", "ray", "dask"]
ENGINES: tuple[EngineName, ...] = ("local", "ray", "dask")

_PATIENCE_S = 5
_ROUNDS = 4  # calls a process gets at a time where results come back only all at once

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Engine:
    """Settings of the engine.

    Attributes:
        name: Which one.
        jobs: Processes on this machine, or calls that a cluster gets at a time.
        address: Of the cluster's scheduler; empty: a cluster is started on this machine.
    """

    name: EngineName
    jobs: int
    address: str = ""

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ConfigError(f"--jobs {self.jobs}: expected 1 or more")
        if self.address and self.name == "local":
            raise ConfigError(f"--address {self.address}: expected --engine ray or dask with it")

    def map(self, function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[tuple[Item, Result]]:
        """Call a function on every item and yield each item with its result, in the order in which they finish.

        What the function raises comes out here.

        Raises:
            ConfigError: The engine is not installed.
            LinkError: There is no cluster at the address.
        """
        calls = [delayed(_keep)(function, item) for item in items]
        with _BACKENDS[self.name](self):
            if self.name == "ray":  # its backend returns lists only
                step = _ROUNDS * self.jobs
                for start in range(0, len(calls), step):
                    yield from Parallel(n_jobs=self.jobs, batch_size=1)(calls[start : start + step])
            else:
                yield from Parallel(n_jobs=self.jobs, return_as="generator_unordered")(calls)


def _keep(function: Callable[[Item], Result], item: Item) -> tuple[Item, Result]:
    return item, function(item)


@contextmanager
def _local(engine: Engine) -> Iterator[None]:
    with parallel_config("loky", n_jobs=engine.jobs):
        yield


@contextmanager
def _dask(engine: Engine) -> Iterator[None]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ConfigError("--engine dask: Dask is not installed: pip install 'revnm-sim[dask]'") from error
    own = {"n_workers": engine.jobs, "threads_per_worker": 1, "dashboard_address": None}
    try:
        client = Client(**({"address": engine.address, "timeout": _PATIENCE_S} if engine.address else own))
    except (OSError, ValueError) as error:
        raise LinkError(f"--address {engine.address}: no Dask scheduler answers there: {error}") from error
    with client, parallel_config("dask", client=client):
        yield


@contextmanager
def _ray(engine: Engine) -> Iterator[None]:
    try:
        import ray
        from ray.util.joblib import register_ray
    except ImportError as error:
        raise ConfigError("--engine ray: Ray is not installed: pip install 'revnm-sim[ray]'") from error
    own = {"num_cpus": engine.jobs, "include_dashboard": False}
    try:
        ray.init(**({"address": engine.address} if engine.address else own), log_to_driver=False)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise LinkError(f"--address {engine.address}: no Ray cluster answers there: {error}") from error
    register_ray()
    try:
        with parallel_config("ray", n_jobs=engine.jobs):
            yield
    finally:
        ray.shutdown()


_BACKENDS = {"local": _local, "dask": _dask, "ray": _ray}
