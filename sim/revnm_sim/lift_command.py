"""``revnm-sim lift``: how well the map of the robot's surroundings agrees with the truth, and what it costs."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from revnm_client.errors import ConfigError
from revnm_sim.bench.protocol import draw_setting
from revnm_sim.bench.report import table, write_report
from revnm_sim.lift_faults import CALIBRATIONS, DEPTHS, NETWORK
from revnm_sim.lift_network import DepthNetwork
from revnm_sim.lift_trial import Outcome, drive, views
from revnm_sim.worlds import WORLDS

_DEFAULT_CASES = (
    "exact/exact,focal_height_3pct/exact,pitch_1deg/exact,roll_1deg/exact,all/exact,all_untold/exact,"
    "exact/blur,exact/mild,exact/strong,exact/network,all/network,exact/noise_only"
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument(
        "--world",
        default="random_pillar,aisles,rooms",
        help=f"comma-separated, of: {', '.join(WORLDS)}, or paths of world files (default: %(default)s)",
    )
    parser.add_argument(
        "--case",
        default=_DEFAULT_CASES,
        help=f"comma-separated CALIBRATION/DEPTH, of: {', '.join(CALIBRATIONS)} / {', '.join(DEPTHS)} "
        "(default: %(default)s)",
    )
    parser.add_argument("--pairs", type=int, default=10, help="ways driven in each world (default: 10)")
    parser.add_argument("--seed", type=int, default=5000, help="of pairs, cameras and errors (default: 5000)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report and print its table."""
    cases = _cases(args.case)
    if args.seed < 0 or args.pairs < 1:
        raise ConfigError(f"--seed {args.seed} --pairs {args.pairs}: expected at least 0 and 1")
    args.out.mkdir(parents=True, exist_ok=True)
    rows = [
        row
        for world in dict.fromkeys(args.world.split(","))
        for row in _world_rows(world, cases, args.pairs, args.seed)
    ]
    options = ["--world", args.world, "--case", args.case, "--pairs", str(args.pairs), "--seed", str(args.seed)]
    write_report(args.out / "report.json", rows, shlex.join(["revnm-sim", "lift", *options]))
    print(table(rows))
    return 0


def _cases(text: str) -> list[tuple[str, str]]:
    """Return the names of calibration and depth of every case.

    Raises:
        ConfigError: A case is none.
    """
    found = []
    for case in dict.fromkeys(text.split(",")):
        calibration, _, depth = case.partition("/")
        if calibration not in CALIBRATIONS or depth not in DEPTHS:
            raise ConfigError(
                f"--case {case}: expected one of {', '.join(CALIBRATIONS)}, a slash, and one of {', '.join(DEPTHS)}"
            )
        found.append((calibration, depth))
    return found


def _world_rows(world: str, cases: Sequence[tuple[str, str]], pairs: int, seed: int) -> list[dict[str, Any]]:
    network = DepthNetwork() if any(depth == NETWORK for _, depth in cases) else None
    outcomes: Mapping[tuple[str, str], Outcome] = {case: Outcome() for case in cases}
    for pair in tqdm(range(pairs), desc=world, unit="way"):
        setting = draw_setting(world, seed=seed, pair=pair, cameras=1, rule="any")
        exact = views(setting)
        seen = exact if network is None else network.see(setting, exact)
        for case, total in outcomes.items():
            rng = np.random.default_rng([seed, pair, 4])
            new = drive(
                seen if case[1] == NETWORK else exact, setting.cameras[0], CALIBRATIONS[case[0]], DEPTHS[case[1]], rng
            )
            total.scores += new.scores
            total.refused += new.refused
            total.times_ms += new.times_ms
    return [_row(world, case, total) for case, total in outcomes.items()]


def _row(world: str, case: tuple[str, str], outcome: Outcome) -> dict[str, Any]:
    """Return one flat object; shares without cells, and times without pictures, are None."""
    scores = outcome.scores
    times = np.percentile(outcome.times_ms, (50.0, 95.0)).round(2).tolist() if outcome.times_ms else [None, None]
    return {
        "world": world,
        "calibration": case[0],
        "depth": case[1],
        "maps": len(scores),
        "refused": len(outcome.refused),
        "obstacle_recall": _share(sum(s.found for s in scores), sum(s.wanted for s in scores)),
        "obstacle_precision": _share(sum(s.right for s in scores), sum(s.claimed for s in scores)),
        "floor_recall": _share(sum(s.open for s in scores), sum(s.floor for s in scores)),
        "p50_ms": times[0],
        "p95_ms": times[1],
    }


def _share(part: int, whole: int) -> float | None:
    return round(part / whole, 3) if whole else None
