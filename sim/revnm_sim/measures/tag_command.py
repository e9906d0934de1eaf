"""``revnm-sim tags``: how small a tag is found, how exactly, how fast, and what is taken for one."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2

from revnm_client.errors import ConfigError
from revnm_server.tag import open_tag_library
from revnm_server.tag.choice import LIBRARIES
from revnm_sim.bench.report import make_folder, table, write_report
from revnm_sim.measures.tag_bench import detection_rows, time_rows, wrong_id_rows


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument(
        "--library", default=",".join(LIBRARIES), help="comma-separated tag libraries (default: %(default)s)"
    )
    parser.add_argument("--trials", type=int, default=100, help="pictures of each size of tag (default: 100)")
    parser.add_argument("--timed", type=int, default=20, help="pictures that are timed (default: 20)")
    parser.add_argument("--pictures", type=int, default=10_000, help="tag-free pictures (default: 10000)")
    parser.add_argument("--seed", type=int, default=0, help="of all pictures (default: 0)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json")


def run(args: argparse.Namespace) -> int:
    """Measure, print the tables and write the report; measures of no pictures are left out."""
    names = list(dict.fromkeys(args.library.split(",")))
    if unknown := [name for name in names if name not in LIBRARIES]:
        raise ConfigError(f"--library {','.join(unknown)}: expected {' or '.join(LIBRARIES)}")
    if min(args.trials, args.timed, args.pictures, args.seed) < 0:
        raise ConfigError("--trials, --timed, --pictures, --seed: expected 0 or more")
    make_folder(args.out)
    cv2.setNumThreads(1)
    libraries = [open_tag_library(name).library for name in LIBRARIES if name in names]
    rows = [
        *_shown(detection_rows(libraries, trials=args.trials, seed=args.seed) if args.trials else ()),
        *_shown(time_rows(libraries, pictures=args.timed, seed=args.seed) if args.timed else ()),
        *_shown(wrong_id_rows(libraries, pictures=args.pictures, seed=args.seed) if args.pictures else ()),
    ]
    options = {key: str(getattr(args, key)) for key in ("library", "trials", "timed", "pictures", "seed")}
    words = [word for key, value in options.items() for word in (f"--{key}", value)]
    write_report(args.out / "report.json", rows, shlex.join(["revnm-sim", "tags", *words]))
    return 0


def _shown(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    measured = list(rows)
    if measured:
        print(table(measured), flush=True)
    return measured
