"""``revnm-sim camera``: how the server's camera reader bears faults, and how old its newest picture is."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from revnm_client.errors import ConfigError
from revnm_sim.bench.report import make_folder, table, write_report
from revnm_sim.measures.camera_trial import (
    BREAKAGES,
    FPS,
    FaultTiming,
    Scene,
    sample_ages_ms,
    time_4k,
    time_fault,
    watched,
)

_STREAMS = {"640x480": (640, 480), "1920x1080": (1920, 1080), "3840x2160": (3840, 2160)}
_RATE_HZ = 5.0
_HOLD_S = (3.0, 7.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--repeats", type=int, default=3, help="times that each fault happens (default: 3)")
    parser.add_argument("--samples", type=int, default=50, help="looks at each stream, 5 a second (default: 50)")
    parser.add_argument("--seed", type=int, default=0, help="of how long faults last (default: 0)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report and print the tables."""
    if min(args.repeats, args.samples) < 1 or args.seed < 0:
        raise ConfigError("--repeats, --samples and --seed: expected at least 1, 1 and 0")
    make_folder(args.out)
    faults = list(tqdm(_fault_rows(args), desc="faults", total=len(BREAKAGES) + 1))
    streams = list(tqdm(_stream_rows(args), desc="streams", total=len(_STREAMS)))
    options = ["--repeats", str(args.repeats), "--samples", str(args.samples), "--seed", str(args.seed)]
    write_report(args.out / "report.json", [*faults, *streams], shlex.join(["revnm-sim", "camera", *options]))
    print(table(faults), table(streams), sep="\n\n")
    return 0


def _fault_rows(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield a row of each fault, with the slowest of its repeats; each camera breaks again and again."""
    rng = np.random.default_rng(args.seed)
    scene = Scene((640, 480))
    with watched(scene) as (server, camera):
        for fault, breakage in BREAKAGES.items():
            holds_s = rng.uniform(*_HOLD_S, args.repeats) * (fault != "dropped")
            yield _row(fault, [time_fault(server, camera, breakage, hold_s=hold_s) for hold_s in holds_s])
        yield _row("4k", [time_4k(scene, camera, hold_s=_HOLD_S[0]) for _ in range(args.repeats)])


def _row(fault: str, timings: list[FaultTiming]) -> dict[str, Any]:
    return {
        "fault": fault,
        "state": ", ".join(dict.fromkeys(timing.state for timing in timings)),
        "state_after_s": round(max(timing.state_after_s for timing in timings), 2),
        "recovered_after_s": round(max(timing.recovered_after_s for timing in timings), 2),
        "repeats": len(timings),
        "reason": timings[-1].reason,
    }


def _stream_rows(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for stream, size_px in _STREAMS.items():
        with watched(Scene(size_px)) as (_, camera):
            sample_ages_ms(camera, rate_hz=_RATE_HZ, count=5)  # what is measured is not the start
            ages_ms = sample_ages_ms(camera, rate_hz=_RATE_HZ, count=args.samples)
            p50, p95 = np.percentile(ages_ms, (50, 95))
            yield {
                "stream": stream,
                "p50_age_ms": round(float(p50), 1),
                "p95_age_ms": round(float(p95), 1),
                "wanted_fps": FPS,
                "received_fps": round(camera.status().fps or 0.0, 1),
            }
