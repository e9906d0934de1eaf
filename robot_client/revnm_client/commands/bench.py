"""``revnm-robot bench``: what the controller takes beside others on the same problem, and what the whole loop does."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from revnm_client.errors import ConfigError, RevnmError
from revnm_client.report import make_folder, table, write_report

Row = dict[str, Any]

_OURS = "mppi"
_COMPARED = "2000x56"
_SHORTEST_S = 2.0  # the state comes twice a second
_PACKAGES = ("revnm-client", "numpy", "eclipse-zenoh", "pytorch_mppi", "torch")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    add = parser.add_argument
    add("--ticks", type=int, default=400, metavar="N", help="ticks of each controller, after warm-up (%(default)s)")
    add("--loop-seconds", type=float, default=20.0, metavar="S", help="how long the loop drives, 0: not (%(default)s)")
    add("--out", type=Path, required=True, metavar="DIR", help="folder for report.json")


def run(options: argparse.Namespace) -> int:
    """Measure, print the table and write the report; return 0.

    Raises:
        ConfigError: An option makes no sense.
        FileError: The folder cannot be made.
        LinkError: The loop's client does not drive.
    """
    if options.ticks < 1:
        raise ConfigError(f"--ticks {options.ticks}: expected at least 1")
    if not (options.loop_seconds == 0.0 or options.loop_seconds >= _SHORTEST_S):
        raise ConfigError(f"--loop-seconds {options.loop_seconds}: expected 0 or at least {_SHORTEST_S:g}")
    make_folder(options.out)
    rows = list(_controllers(options.ticks))
    loops = list(_loop(options.loop_seconds))
    command = f"revnm-robot bench --ticks {options.ticks} --loop-seconds {options.loop_seconds:g} --out {options.out}"
    write_report(options.out / "report.json", rows + loops, command, packages=_PACKAGES)
    print(table(rows), *([table(loops)] if loops else []), sep="\n\n")
    for line in _ratios(rows):
        print(line)
    return 0


def _controllers(ticks: int) -> Iterator[Row]:
    from revnm_client.speed.controllers import SIZES, backends, measure_other, measure_ours
    from revnm_client.speed.one_core import call_on_one_core

    for size in SIZES:
        yield {"name": f"{_OURS}_{size}", **call_on_one_core(measure_ours, size, ticks)}
    others = backends()
    if not others:
        print("nothing to compare with is installed: revnm-training brings pytorch_mppi")
    for name in others:
        try:
            yield {"name": f"{name}_{_COMPARED}", **call_on_one_core(measure_other, name, _COMPARED, ticks)}
        except RevnmError as error:
            print(f"{name}: left out: {error}")


def _loop(seconds: float) -> Iterator[Row]:
    from revnm_client.speed.live_loop import measure_loop

    if seconds:
        yield {"name": "loop_1000x30", **measure_loop(seconds)}


def _ratios(rows: list[Row]) -> Iterator[str]:
    took = {row["name"]: row["p50_ms"] for row in rows}
    ours = took[f"{_OURS}_{_COMPARED}"]
    for name, p50_ms in took.items():
        if name.endswith(_COMPARED) and p50_ms is not ours:
            yield f"{_OURS}_{_COMPARED} is {p50_ms / ours:.1f} times as fast as {name}"
