"""``revnm-server replay``: make the plans of a run record again, without camera or robot, and compare."""

from __future__ import annotations

import argparse
import shlex
import sys
import tempfile
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

import pydantic
from threadpoolctl import threadpool_limits

from revnm_client.errors import ConfigError, FileError
from revnm_server.recording.record_reader import RecordReader
from revnm_server.recording.replay import Comparison, RecordedSenses, known_before, replay
from revnm_server.report import make_folder, table, write_report
from revnm_server.settings import DepthSettings, PerceptionSettings

_TOLERANCE_M = 0.05
_SHOWN_EVERY = 20  # ticks


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add = parser.add_argument
    add("file", type=Path, nargs="+", metavar="FILE", help="run record; several files of one record in their order")
    add("--bundle", type=Path, metavar="DIR", help="model bundle (the one that is shipped)")
    add("--planner", choices=("revnm", "bev"), help="the bundle's policy, or a search on the map (as recorded)")
    add(
        "--tolerance-m",
        type=float,
        default=_TOLERANCE_M,
        metavar="M",
        help="the exit status is 1 if more than 5 %% of the waypoints are farther from the recorded ones (%(default)s)",
    )
    add("--out", type=Path, required=True, metavar="DIR", help="folder for report.json")


def run(options: argparse.Namespace) -> int:
    """Replay, print the table and write the report; return 0 if the plans are within the tolerance, else 1.

    Raises:
        FileError: The record or the bundle cannot be read, or the report cannot be written.
        ConfigError: An option is wrong.
    """
    if not options.tolerance_m >= 0.0:
        raise ConfigError(f"--tolerance-m {options.tolerance_m}: expected 0 or more")
    make_folder(options.out)
    reader = RecordReader(options.file)
    # A bundle is never looked for where it was then.
    chosen: dict[str, Any] = reader.about.perception | {"bundle": options.bundle, "calibration_dir": None}
    if options.planner is not None:
        chosen["planner"] = options.planner
    settings = _settings(options.file[0], PerceptionSettings, chosen)
    depth = _settings(options.file[0], DepthSettings, reader.about.depth)
    with threadpool_limits(limits=1, user_api="blas"), tempfile.TemporaryDirectory(prefix="revnm-replay-") as folder:
        comparison = _replay(reader, settings.model_copy(update={"calibration_dir": Path(folder)}), depth)
    if comparison.ticks == 0:
        raise FileError(f"{options.file[0]}: there is no tick in it that can be made again")
    rows = [_whole(reader, comparison), *comparison.rows()]
    files = [str(path) for path in options.file]
    write_report(options.out / "report.json", rows, shlex.join(["revnm-server", "replay", *files]))
    print(table(rows[:1]))
    print(table(rows[1:]))
    within = comparison.within(options.tolerance_m)
    print(f"the plans are {'' if within else 'not '}within {options.tolerance_m} m of those recorded")
    return 0 if within else 1


_Recorded = TypeVar("_Recorded", PerceptionSettings, DepthSettings)


def _settings(path: Path, section: type[_Recorded], recorded: dict[str, Any]) -> _Recorded:
    """Return a section of the recorded settings.

    Raises:
        FileError: It is malformed.
    """
    try:
        return section(**recorded)
    except pydantic.ValidationError as error:
        [problem, *_] = error.errors(include_url=False)
        place = ".".join(str(part) for part in problem["loc"])
        raise FileError(f"{path}: settings of its server: {place}: {problem['msg']}") from None


def _replay(reader: RecordReader, settings: PerceptionSettings, depth: DepthSettings) -> Comparison:
    from revnm_server.assembly import build_map_pipeline, build_pipeline, load_models
    from revnm_server.calibration.store import save_belief
    from revnm_server.networks.bundle import Bundle, default_bundle_path
    from revnm_server.networks.checked_file import file_sha256
    from revnm_server.networks.manifest import MANIFEST

    about = reader.about
    models = load_models(settings, depth)
    folder = settings.bundle or default_bundle_path()
    if file_sha256(folder / MANIFEST) != about.bundle_sha256:
        print(f"the record was made with other models ({about.bundle}) than {folder} has", file=sys.stderr)
    ticks = reader.ticks()
    first = next(ticks, None)
    if first is None:
        return Comparison()
    belief = known_before(first.document)
    if belief is not None and settings.calibration_dir is not None:
        path = settings.calibration_dir / f"{about.camera}.json"
        save_belief(path, about.camera, first.frame.size_px, belief)
    senses = {robot: RecordedSenses() for robot in about.robots}
    if isinstance(models, Bundle) and models.sees == "picture":
        return replay(chain([first], ticks), build_pipeline(models, settings, about.robots), senses, progress=_Ticks())
    pipeline = build_map_pipeline(models, settings, about.robots, senses, camera=about.camera)
    try:
        return replay(chain([first], ticks), pipeline, senses, progress=_Ticks())
    finally:
        pipeline.close()


class _Ticks:
    """Shows how far it is, where somebody watches."""

    def __init__(self) -> None:
        self._count = 0

    def __call__(self) -> None:
        self._count += 1
        if self._count % _SHOWN_EVERY == 0 and sys.stderr.isatty():
            print(f"\r{self._count} ticks", end="", file=sys.stderr, flush=True)


def _whole(reader: RecordReader, comparison: Comparison) -> dict[str, Any]:
    return {
        "ticks": comparison.ticks,
        "original_pictures": comparison.originals,
        "broken_ticks": reader.broken,
        "early_ticks": reader.early,
        "missing_messages": comparison.missing,
        "failed_recorded": comparison.failed_then,
        "failed_replayed": comparison.failed_now,
    }
