"""``revnm-sim bench``: methods against each other in closed loop."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from joblib import Parallel, delayed
from tqdm import tqdm

from revnm_client.errors import ConfigError
from revnm_server.bundle import default_bundle_path, file_sha256
from revnm_server.manifest import MANIFEST, read_manifest
from revnm_sim.bench.journal import Journal
from revnm_sim.bench.methods import METHODS, WITH_MODELS
from revnm_sim.bench.metrics import rows
from revnm_sim.bench.report import table, write_report
from revnm_sim.bench.trial import TrialKey, TrialResult, run_trial
from revnm_sim.worlds import WORLDS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument("--world", default="random_pillar", help=f"comma-separated, of: {', '.join(WORLDS)}")
    parser.add_argument("--method", default=",".join(METHODS), help=f"comma-separated, of: {', '.join(METHODS)}")
    parser.add_argument("--perception", choices=["truth", "models"], default="truth", help="where depth comes from")
    parser.add_argument("--trials", type=int, default=40, help="trials per world and method")
    parser.add_argument("--seed", type=int, default=1000, help="trials of one seed are the same for every method")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--bundle", type=Path, default=default_bundle_path(), help="model bundle of the method revnm")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json; a run there is continued")


def run(args: argparse.Namespace) -> int:
    """Run the benchmark, or what is missing of it, and print the table."""
    keys = trial_keys(args)
    args.out.mkdir(parents=True, exist_ok=True)
    journal = Journal(args.out / "trials.jsonl")
    missing = [key for key in keys if key not in journal.results]
    with tqdm(total=len(keys), initial=len(keys) - len(missing), unit="trial") as bar:
        for key, result in _run_trials(missing, args.jobs):
            journal.add(key, result)
            bar.update()
    report = rows({key: journal.results[key] for key in keys})
    write_report(args.out / "report.json", report, shlex.join(["revnm-sim", "bench", *_options(args)]))
    print(table(report))
    return 0


def trial_keys(args: argparse.Namespace) -> list[TrialKey]:
    """Return the trials that the options ask for.

    Raises:
        ConfigError: A world or method is unknown, or a count is not positive.
        FileError: A method needs the bundle, and its manifest is missing or malformed.
    """
    worlds = _names(args.world, WORLDS, "world")
    methods = _names(args.method, METHODS, "method")
    for name in ("trials", "jobs"):
        if getattr(args, name) < 1:
            raise ConfigError(f"--{name} {getattr(args, name)}: expected 1 or more")
    bundles = {method: _bundle(args.bundle) if method in WITH_MODELS else ("", "") for method in methods}
    return [
        TrialKey(world, method, args.perception, args.seed, index, *bundles[method])
        for world in worlds
        for method in methods
        for index in range(args.trials)
    ]


def _bundle(folder: Path) -> tuple[str, str]:
    """Return a bundle's folder and the sha256 of its manifest."""
    read_manifest(folder)
    return str(folder), file_sha256(folder / MANIFEST)


def _run_trials(keys: Sequence[TrialKey], jobs: int) -> Iterator[tuple[TrialKey, TrialResult]]:
    parallel = Parallel(n_jobs=jobs, return_as="generator_unordered")
    yield from parallel(delayed(_keyed)(key) for key in keys)


def _keyed(key: TrialKey) -> tuple[TrialKey, TrialResult]:
    return key, run_trial(key)


def _names(text: str, known: Iterable[str], option: str) -> list[str]:
    choices = list(known)
    names = list(dict.fromkeys(text.split(",")))
    for name in names:
        if name not in choices:
            raise ConfigError(f"--{option} {name}: expected one of {', '.join(choices)}")
    return names


def _options(args: argparse.Namespace) -> list[str]:
    names = ["world", "method", "perception", "trials", "seed", "jobs"]
    if args.bundle != default_bundle_path():
        names.append("bundle")
    names.append("out")
    return [word for name in names for word in (f"--{name}", str(getattr(args, name)))]
