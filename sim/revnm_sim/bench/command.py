"""``revnm-sim bench``: methods against each other in closed loop, and the suites of the robot's own controller."""

from __future__ import annotations

import argparse
import shlex
import signal
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from revnm_client.errors import ConfigError
from revnm_server.networks.bundle import default_bundle_path
from revnm_server.networks.checked_file import file_sha256
from revnm_server.networks.manifest import MANIFEST, read_manifest
from revnm_sim.bench.journal import Journal
from revnm_sim.bench.methods import METHODS, WITH_DEPTH_NETWORK, WITH_MODELS, WITH_OWN_BUNDLE
from revnm_sim.bench.progress import run_missing
from revnm_sim.bench.protocol import PROTOCOLS, Protocol, draw_setting, fit_protocol, parse_protocol
from revnm_sim.bench.publish import publish
from revnm_sim.bench.report import make_folder
from revnm_sim.bench.suites import SUITES, run_suite
from revnm_sim.bench.trial import TrialKey, TrialResult, run_trial
from revnm_sim.engine import ENGINES, Engine
from revnm_sim.worlds import WORLDS, named_site

PAPER_WORLDS = ("random_pillar", "bookstore", "warehouse")
_DEFAULT_METHODS = tuple(name for name in METHODS if name not in WITH_OWN_BUNDLE)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument(
        "--suite",
        choices=("methods", *SUITES),
        default="methods",
        help="methods against each other; the controller's courses; or faults on the way (default: methods)",
    )
    parser.add_argument(
        "--scenes",
        type=int,
        default=200,
        help="suite controller: random scenes, and a tenth as many of each other course (default: 200)",
    )
    parser.add_argument("--runs", type=int, default=100, help="suite faults: runs with each fault (default: 100)")
    parser.add_argument(
        "--world",
        default=",".join(PAPER_WORLDS),
        help=f"comma-separated, of: {', '.join(WORLDS)}, or paths of world files (default: %(default)s)",
    )
    parser.add_argument(
        "--method",
        default=",".join(_DEFAULT_METHODS),
        help=f"comma-separated, of: {', '.join(METHODS)} (default: %(default)s)",
    )
    parser.add_argument("--perception", choices=["truth", "models"], default="truth", help="where depth comes from")
    sizes = ", ".join(f"{name} ({p.pairs} × {p.cameras} × {p.repeats})" for name, p in PROTOCOLS.items())
    parser.add_argument(
        "--protocol", default="default", help=f"{sizes}, or PAIRSxCAMERASxREPEATS such as 20x2x1 (default: default)"
    )
    parser.add_argument(
        "--pairs", choices=["blocked", "any"], default="blocked", help="whether the straight way must be blocked"
    )
    parser.add_argument("--seed", type=int, default=1000, help="trials of one seed are the same for every method")
    parser.add_argument(
        "--bundle",
        action="append",
        default=[],
        metavar="[METHOD=]FOLDER",
        help="model bundle, of all methods or of one; may be repeated (default: the server's)",
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: 1)")
    parser.add_argument("--engine", choices=ENGINES, default="local", help="where they run (default: local)")
    parser.add_argument("--address", default="", help="scheduler of the Ray or Dask cluster; without it one is started")
    parser.add_argument("--out", type=Path, required=True, help="folder for the report; a run there is continued")


def run(args: argparse.Namespace) -> int:
    """Run the benchmark, or what is missing of it, write the report and print its table."""
    engine = Engine(args.engine, args.jobs, args.address)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: the workers end, too
    if args.suite != "methods":
        print(run_suite(args, engine))
        return 0
    keys = trial_keys(args)
    make_folder(args.out)
    journal = Journal(args.out / "trials.jsonl", TrialKey, TrialResult)
    run_missing(run_trial, keys, engine, journal, _Tally().count)
    command = shlex.join(["revnm-sim", "bench", *_options(args)])
    print(publish({key: journal.results[key] for key in keys}, args.out, command))
    return 0


class _Tally:
    """The running success rates of this run's trials, by method."""

    def __init__(self) -> None:
        self._counts: dict[str, tuple[int, int]] = {}

    def count(self, key: TrialKey, result: TrialResult) -> str:
        wins, trials = self._counts.get(key.method, (0, 0))
        self._counts[key.method] = wins + result.success, trials + 1
        return " ".join(f"{name} {wins / trials:.2f}" for name, (wins, trials) in sorted(self._counts.items()))


def trial_keys(args: argparse.Namespace) -> list[TrialKey]:
    """Return the trials that the options ask for; those of one pair follow each other.

    Raises:
        ConfigError: A world, a method or a protocol is unknown, or a method has no bundle.
        FileError: A bundle's manifest or a world file is missing or malformed.
        ContractError: A world has no pair that a camera sees.
    """
    methods = _names(args.method, METHODS, "method")
    bundles = _bundles(args.bundle, methods, args.perception)
    protocol = parse_protocol(args.protocol)
    return [
        key for world in dict.fromkeys(args.world.split(",")) for key in _world_keys(world, args, protocol, bundles)
    ]


@dataclass(frozen=True, slots=True)
class _Models:
    """A bundle's folder and the sha256 of its manifest; both empty where a method has none."""

    folder: str = ""
    manifest_sha256: str = ""


def _world_keys(
    world: str, args: argparse.Namespace, protocol: Protocol, bundles: Mapping[str, _Models]
) -> list[TrialKey]:
    if args.seed < 0:
        raise ConfigError(f"--seed {args.seed}: expected 0 or more")
    site = named_site(world, 0)
    fitted = fit_protocol(protocol, site)
    draw_setting(world, seed=args.seed, pair=0, cameras=fitted.cameras, rule=args.pairs)  # fails early
    return [
        TrialKey(
            world=world,
            method=method,
            perception=args.perception,
            seed=args.seed,
            pair=pair,
            camera=camera,
            repeat=repeat,
            cameras=fitted.cameras,
            rule=args.pairs,
            world_sha256=site.file_sha256,
            bundle=models.folder,
            manifest_sha256=models.manifest_sha256,
        )
        for pair in range(fitted.pairs)
        for camera in range(fitted.cameras)
        for repeat in range(fitted.repeats)
        for method, models in bundles.items()
    ]


def _bundles(options: Sequence[str], methods: Sequence[str], perception: str) -> dict[str, _Models]:
    """Return the models of every method."""
    common, own = default_bundle_path(), {}
    with_bundle = WITH_MODELS | WITH_DEPTH_NETWORK if perception == "models" else WITH_MODELS
    for option in options:
        name, equals, folder = option.partition("=")
        if not equals:
            common = Path(option)
        elif name in methods and name in with_bundle:
            own[name] = Path(folder)
        else:
            raise ConfigError(f"--bundle {option}: {name} is none of the methods with models that --method names")
    for method in methods:
        if method in WITH_OWN_BUNDLE and method not in own:
            raise ConfigError(f"--method {method}: expected --bundle {method}=FOLDER, a bundle of its own")
    return {m: _models(own.get(m, common)) if m in with_bundle else _Models() for m in methods}


def _models(folder: Path) -> _Models:
    read_manifest(folder)
    return _Models(str(folder), file_sha256(folder / MANIFEST))


def _names(text: str, known: Iterable[str], option: str) -> list[str]:
    choices = list(known)
    names = list(dict.fromkeys(text.split(",")))
    for name in names:
        if name not in choices:
            raise ConfigError(f"--{option} {name}: expected one of {', '.join(choices)}")
    return names


def _options(args: argparse.Namespace) -> list[str]:
    """Return the options that decide the results; how many processes ran them does not."""
    words = []
    for name in ("world", "method", "perception", "protocol", "pairs", "seed"):
        words += [f"--{name}", str(getattr(args, name))]
    for bundle in args.bundle:
        words += ["--bundle", bundle]
    return [*words, "--out", str(args.out)]
