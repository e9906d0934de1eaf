"""Child processes that have one core and one thread of numpy, whatever the machine has."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

T = TypeVar("T")

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@contextmanager
def one_core() -> Iterator[None]:
    """Let children that start in this block inherit one core and one thread; Linux only."""
    cores, threads = os.sched_getaffinity(0), {name: os.environ.get(name) for name in _THREADS}
    os.sched_setaffinity(0, {max(cores)})
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
        for name, value in threads.items():
            os.environ.pop(name)
            os.environ.update({} if value is None else {name: value})


def call_on_one_core(function: Callable[..., T], *arguments: object) -> T:
    """Return what the function returns in a fresh process; function, arguments and result can be pickled."""
    with one_core(), ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()
