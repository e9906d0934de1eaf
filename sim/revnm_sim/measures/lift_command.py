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
from revnm_sim.measures.lift_faults import CALIBRATIONS, DEPTHS, NETWORK
from revnm_sim.measures.lift_figure import Example, draw_examples
from revnm_sim.measures.lift_network import DepthNetwork
from revnm_sim.measures.lift_trial import Outcome, View, drive, views
from revnm_sim.worlds import WORLDS

Case = tuple[str, str]  # names of a calibration's and a depth's fault
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
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json and maps.png")


def run(args: argparse.Namespace) -> int:
    """Measure, write the report and a picture, and print the table."""
    cases = _cases(args.case)
    if args.seed < 0 or args.pairs < 1:
        raise ConfigError(f"--seed {args.seed} --pairs {args.pairs}: expected at least 0 and 1")
    args.out.mkdir(parents=True, exist_ok=True)
    rows, examples = list[dict[str, Any]](), list[Example]()
    for world in dict.fromkeys(args.world.split(",")):
        seen, outcomes = _drives(world, cases, args.pairs, args.seed)
        rows += [_row(world, case, outcome) for case, outcome in outcomes.items()]
        examples += _example(world, seen, outcomes)
    options = ["--world", args.world, "--case", args.case, "--pairs", str(args.pairs), "--seed", str(args.seed)]
    write_report(args.out / "report.json", rows, shlex.join(["revnm-sim", "lift", *options]))
    if examples:
        draw_examples(examples, args.out / "maps.png")
    print(table(rows))
    return 0


def _cases(text: str) -> list[Case]:
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


def _drives(world: str, cases: Sequence[Case], pairs: int, seed: int) -> tuple[list[View], Mapping[Case, Outcome]]:
    """Return all places, and what each case made of them."""
    network = DepthNetwork() if any(depth == NETWORK for _, depth in cases) else None
    outcomes: Mapping[Case, Outcome] = {case: Outcome() for case in cases}
    places = list[View]()
    for pair in tqdm(range(pairs), desc=world, unit="way"):
        setting = draw_setting(world, seed=seed, pair=pair, cameras=1, rule="any")
        exact = views(setting)
        seen = exact if network is None else network.see(setting, exact)
        places += exact
        for (calibration, depth), outcome in outcomes.items():
            rng = np.random.default_rng([seed, pair, 4])
            shown = seen if depth == NETWORK else exact
            outcome.add(drive(shown, setting.cameras[0], CALIBRATIONS[calibration], DEPTHS[depth], rng))
    return places, outcomes


def _example(world: str, places: Sequence[View], outcomes: Mapping[Case, Outcome]) -> list[Example]:
    """Return the place with the most obstacles in sight, if there is any place."""
    if not places:
        return []
    number = int(np.argmax([np.sum(view.truth.occupied & view.truth.visible) for view in places]))
    windows = {"/".join(case): outcome.windows[number] for case, outcome in outcomes.items()}
    return [Example(world, places[number], windows)]


def _row(world: str, case: Case, outcome: Outcome) -> dict[str, Any]:
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
