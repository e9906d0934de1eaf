"""What every suite is, and how one is run: missing trials in parallel, a report, a table, and what went wrong."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic

from revnm_sim.bench.journal import Journal, KeyT, ResultT
from revnm_sim.bench.progress import run_missing
from revnm_sim.bench.report import make_folder, table, write_report
from revnm_sim.engine import Engine

Rows = list[dict[str, Any]]


@dataclass(frozen=True, slots=True)
class Suite(Generic[KeyT, ResultT]):
    """Trials of one kind.

    Attributes:
        name: For the command line.
        key: Type of the trials' keys.
        result: Type of what comes of them.
        run: Runs one.
        rows: Sums them up.
        bar: Says of the rows whether the bar is met.
        note: Says what went wrong in a trial; empty if nothing did.
    """

    name: str
    key: type[KeyT]
    result: type[ResultT]
    run: Callable[[KeyT], ResultT]
    rows: Callable[[Mapping[KeyT, ResultT]], Rows]
    bar: Callable[[Sequence[Mapping[str, Any]]], str]
    note: Callable[[KeyT, ResultT], str]

    def measure(self, keys: Sequence[KeyT], engine: Engine, out: Path, options: Sequence[str]) -> str:
        """Run the trials that the folder lacks, write ``report.json`` and return the table with its bar.

        Args:
            keys: The trials that are wanted.
            engine: Where they run.
            out: The folder.
            options: Of the command line that decide the results.

        Raises:
            FileError: The folder cannot be made, or holds a journal of something else.
        """
        make_folder(out)
        journal = Journal(out / f"{self.name}.jsonl", self.key, self.result)
        run_missing(self.run, keys, engine, journal, _Amiss(self.note).count)
        results = {key: journal.results[key] for key in keys}
        rows = self.rows(results)
        write_report(out / "report.json", rows, shlex.join(["revnm-sim", "bench", *options]))
        notes = [note for note in map(self.note, results, results.values()) if note]
        return "\n".join([table(rows), self.bar(rows), *notes])


class _Amiss(Generic[KeyT, ResultT]):
    """Counts the trials of this run in which something went wrong."""

    def __init__(self, note: Callable[[KeyT, ResultT], str]) -> None:
        self._note, self._amiss = note, 0

    def count(self, key: KeyT, result: ResultT) -> str:
        self._amiss += bool(self._note(key, result))
        return f"amiss {self._amiss}"
