"""Results of trials as they come in, one JSON line each, so that an interrupted benchmark goes on."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

from revnm_client.errors import FileError
from revnm_sim.bench.trial import TrialKey, TrialResult


class Journal:
    """A file of finished trials; a last line that was cut short is dropped."""

    def __init__(self, path: Path) -> None:
        """Read what is there.

        Raises:
            FileError: A line is no finished trial; the text names file and line.
        """
        self._path = path
        self.results: dict[TrialKey, TrialResult] = {}
        content = path.read_bytes() if path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            with path.open("r+b") as file:
                file.truncate(len(whole))
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                record = json.loads(line)
                self.results[TrialKey(**record["key"])] = TrialResult(**record["result"])
            except (ValueError, KeyError, TypeError) as error:
                raise FileError(f"{path}: line {number}: no finished trial: {error}") from error

    def add(self, key: TrialKey, result: TrialResult) -> None:
        """Append a finished trial."""
        self.results[key] = result
        record = {"key": dataclasses.asdict(key), "result": dataclasses.asdict(result)}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
