"""``revnm-server bench``: what each stage of a tick takes, and how that compares with other runtimes."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import Any

from revnm_client.errors import ConfigError, RevnmError
from revnm_server.networks.bundle import default_bundle_path, load_bundle
from revnm_server.networks.manifest import read_manifest
from revnm_server.report import make_folder, table, write_report
from revnm_server.speed.tables import OURS, Row, one_after_the_other, stage_rows, summary

_TICK_HZ = 10.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add = parser.add_argument
    add("--preset", metavar="NAMES", help="bundles to measure, by name (all of --bundle, else the shipped one)")
    add("--bundle", type=Path, action="append", default=[], metavar="DIR", help="a model bundle; may be repeated")
    add("--robots", default="1,4,16", metavar="COUNTS", help="how many robots have goals (%(default)s)")
    add("--ticks", type=int, default=100, metavar="N", help="ticks of each count, after warm-up (%(default)s)")
    add("--longest", type=float, default=60.0, metavar="S", help="seconds after which a count ends (%(default)s)")
    add("--threads", type=int, default=2, metavar="N", help="threads of a model (%(default)s)")
    add("--no-baseline", action="store_true", help="measure the server alone")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for report.json")


def run(options: argparse.Namespace) -> int:
    """Measure, print the tables and write the report; return 0.

    Raises:
        ConfigError: An option makes no sense, or there is no bundle of a preset.
        FileError: A bundle is damaged, or the folder cannot be made.
    """
    counts = _counts(options.robots)
    for name, value in (("ticks", options.ticks), ("threads", options.threads), ("longest", options.longest)):
        if not value >= 1:
            raise ConfigError(f"--{name} {value}: expected at least 1")
    folders = _folders(options.bundle, options.preset)
    make_folder(options.out)
    rows = [row for folder in folders for row in _measure(folder, counts, options)]
    verdict = summary(rows)
    write_report(options.out / "report.json", rows, _command(options), more={"summary": verdict})
    print(table(rows), table(verdict), sep="\n\n")
    return 0


def _measure(folder: Path, counts: list[int], options: argparse.Namespace) -> list[Row]:
    from revnm_server.speed.baseline import backends, run_networks
    from revnm_server.speed.drive import Course, drive
    from revnm_server.tick.map_beliefs import AT_ONCE

    bundle, rows = load_bundle(folder, threads=options.threads), []
    for robots in counts:
        course = Course(robots, options.ticks, options.longest, _TICK_HZ)
        rows += stage_rows(bundle.name, robots, OURS, drive(bundle, course))
    others = {} if options.no_baseline else backends()
    if not others and not options.no_baseline:
        print("nothing to compare with is installed: revnm-training brings PyTorch eager")
    for name, point in others.items():
        try:
            networks = point.load()(bundle)
        except RevnmError as error:
            print(f"{bundle.name}, {name}: left out: {error}")
            continue
        print(f"{bundle.name}, {name}: {networks.note}")
        for robots in counts:
            judged = min(robots, AT_ONCE) if bundle.sees == "map" else robots  # as many as ours judge a picture
            taken = run_networks(networks, bundle, robots=judged, rounds=options.ticks, longest_s=options.longest)
            ours = [row for row in rows if row["robots"] == robots and row["backend"] == OURS]
            rows += stage_rows(bundle.name, robots, name, one_after_the_other(taken, ours))
    return rows


def _counts(text: str) -> list[int]:
    words = text.split(",")
    if not all(word.isdecimal() and 1 <= int(word) <= 64 for word in words):
        raise ConfigError(f"--robots {text}: expected numbers from 1 to 64, such as 1,4,16")
    return [int(word) for word in dict.fromkeys(words)]


def _folders(given: list[Path], presets: str | None) -> list[Path]:
    """Return the bundles to measure; the shipped one stands for its preset where none is given for it."""
    names = [read_manifest(folder).name for folder in given]
    if len(set(names)) < len(names):
        raise ConfigError(f"--bundle: expected bundles of different names, got {', '.join(names)}")
    named = dict(zip(names, given, strict=True))
    if presets is None:
        return list(named.values()) or [default_bundle_path()]
    shipped = default_bundle_path()
    named = {read_manifest(shipped).name: shipped} | named
    wanted = list(dict.fromkeys(presets.split(",")))
    for name in wanted:
        if name not in named:
            raise ConfigError(
                f"--preset {name}: no bundle of it is given. This makes one with random weights, as fast as a trained "
                f"one: revnm-train export --preset {name} --random-weights --out {name}; then add --bundle {name}"
            )
    return [named[name] for name in wanted]


def _command(options: argparse.Namespace) -> str:
    words: list[Any] = ["revnm-server", "bench"]
    words += [] if options.preset is None else ["--preset", options.preset]
    for folder in options.bundle:
        words += ["--bundle", folder]
    words += ["--robots", options.robots, "--ticks", options.ticks, "--longest", options.longest]
    words += ["--threads", options.threads, *(["--no-baseline"] if options.no_baseline else [])]
    return shlex.join(str(word) for word in words)
