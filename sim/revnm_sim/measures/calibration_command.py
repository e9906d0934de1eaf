"""``revnm-sim calibration``: how well a camera calibrates itself, how well it knows, and what an update costs."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from revnm_client.errors import ConfigError
from revnm_sim.bench.report import table, write_report
from revnm_sim.measures.calibration_course import Learner, drive, random_camera

_COURSES = ((0.5, True), (1.0, True), (2.0, True), (2.0, False), (4.0, False))
_DISTANCES_M = (1.0, 2.0)
_CHI2_95 = 5.991  # of two degrees of freedom


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--runs", type=int, default=200, help="cameras for each course (default: 200)")
    parser.add_argument("--seed", type=int, default=0, help="of cameras, drives and noise (default: 0)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report and print its table."""
    if args.seed < 0 or args.runs < 1:
        raise ConfigError(f"--seed {args.seed} --runs {args.runs}: expected at least 0 and 1")
    args.out.mkdir(parents=True, exist_ok=True)
    rows = [measure(way_m, corners=corners, seeds=_seeds(args, way_m)) for way_m, corners in _COURSES]
    options = ["--runs", str(args.runs), "--seed", str(args.seed), "--out", str(args.out)]
    write_report(args.out / "report.json", rows, shlex.join(["revnm-sim", "calibration", *options]))
    print(table(rows))
    return 0


def measure(way_m: float, *, corners: bool, seeds: Iterable[tuple[int, ...]]) -> dict[str, Any]:
    """Return the results of one course: drives of a length, sightings with corners or with centre and heading alone.

    Errors are means over places around the robot that the camera sees, one for each camera; the shares within the 95 %
    ellipses count all places.
    """
    errors: dict[float, list[float]] = {distance: [] for distance in _DISTANCES_M}
    inside: dict[float, list[bool]] = {distance: [] for distance in _DISTANCES_M}
    times_ms: list[float] = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        camera, learner = random_camera(rng), Learner(corners=corners)
        moments = drive(camera, rng, way_m)
        for moment in moments:
            learner.see(moment)
        for distance in _DISTANCES_M:
            off, squares = learner.errors(camera, moments[-1].floor_from_robot, distance)
            errors[distance] += [float(off.mean())] if len(off) else []
            inside[distance] += list(squares < _CHI2_95)
        times_ms += learner.times_ms
    row: dict[str, Any] = {"way_m": way_m, "corners": corners, "cameras": len(errors[_DISTANCES_M[0]])}
    for distance in _DISTANCES_M:
        median, p90 = np.percentile(errors[distance], (50.0, 90.0))
        row[f"median_{distance:.0f}m_cm"] = round(100.0 * float(median), 1)
        row[f"p90_{distance:.0f}m_cm"] = round(100.0 * float(p90), 1)
        row[f"in_95_{distance:.0f}m"] = round(float(np.mean(inside[distance])), 3)
    p50, p95 = np.percentile(times_ms, (50.0, 95.0))
    return {**row, "p50_update_ms": round(float(p50), 1), "p95_update_ms": round(float(p95), 1)}


def _seeds(args: argparse.Namespace, way_m: float) -> Iterable[tuple[int, ...]]:
    numbers = tqdm(range(args.runs), desc=f"{way_m:g} m", unit="camera")
    return ((args.seed, number, round(10 * way_m)) for number in numbers)
