"""Times the shipped networks by threads and by what idle threads do.

``python tests/server/session_threads.py [ROUNDS]``. All variants take turns, call by call, so that whatever else the
machine does hits them alike. ``cpu_ms`` is the processor time of a call, of all threads: what other work has less of.
"""

from __future__ import annotations

import sys
import time
from itertools import product
from typing import Any

import numpy as np
import onnxruntime

from revnm_server.networks.bundle import default_bundle_path
from revnm_sim.bench.report import table

THREADS = (1, 2)
SPINNING = ("0", "1")
_PAUSE_S = 0.02  # until the threads of the variant before have ceased to spin


def session(model: str, threads: int, spinning: str) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", spinning)
    path = default_bundle_path() / f"{model}.onnx"
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def inputs(loaded: Any) -> dict[str, Any]:
    rng = np.random.default_rng(0)
    arrays = {}
    for value in loaded.get_inputs():
        shape = [n if isinstance(n, int) else 1 for n in value.shape]
        whole = value.type == "tensor(int64)"
        arrays[value.name] = np.full(shape, 999) if whole else rng.random(shape, dtype=np.float32)
    return arrays


def main(rounds: int) -> None:
    variants = list(product(("depth", "exo2ego", "policy"), THREADS, SPINNING))
    sessions = {variant: session(*variant) for variant in variants}
    given = {variant: inputs(sessions[variant]) for variant in variants}
    times_ms: dict[Any, list[float]] = {variant: [] for variant in variants}
    cpu_ms: dict[Any, list[float]] = {variant: [] for variant in variants}
    for number in range(rounds + 3):
        for variant in variants:
            time.sleep(_PAUSE_S)
            started, spent = time.perf_counter(), time.process_time()
            sessions[variant].run(None, given[variant])
            if number >= 3:
                times_ms[variant].append((time.perf_counter() - started) * 1e3)
                cpu_ms[variant].append((time.process_time() - spent) * 1e3)
    rows = []
    for variant, found in times_ms.items():
        model, threads, spinning = variant
        least, p50, p95 = (round(float(each), 2) for each in np.percentile(found, (0.0, 50.0, 95.0)))
        row = {"model": model, "threads": threads, "idle_threads": "spin" if spinning == "1" else "sleep"}
        rows.append({**row, "calls": rounds, "least_ms": least, "p50_ms": p50, "p95_ms": p95})
        rows[-1]["cpu_ms"] = round(float(np.mean(cpu_ms[variant])), 2)
    print(table(rows))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
