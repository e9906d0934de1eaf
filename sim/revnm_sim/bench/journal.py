"""Results of trials as they come in, one JSON line each, so that an interrupted benchmark goes on."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from revnm_client.errors import FileError


class _Dataclass(Protocol):
    """A dataclass, as :mod:`dataclasses` knows one."""

    __dataclass_fields__: ClassVar[dict[str, dataclasses.Field[Any]]]


KeyT = TypeVar("KeyT", bound=_Dataclass)
ResultT = TypeVar("ResultT", bound=_Dataclass)


class Journal(Generic[KeyT, ResultT]):
    """A file of finished trials; a last line that was cut short is dropped."""

    def __init__(self, path: Path, key: Callable[..., KeyT], result: Callable[..., ResultT]) -> None:
        """Read what is there.

        Args:
            path: The file.
            key: Makes a key of its fields.
            result: Makes a result of its fields.

        Raises:
            FileError: A line is no finished trial; the text names file and line.
        """
        self._path = path
        self.results: dict[KeyT, ResultT] = {}
        content = path.read_bytes() if path.exists() else b""
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            with path.open("r+b") as file:
                file.truncate(len(whole))
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                record = json.loads(line)
                self.results[key(**record["key"])] = result(**record["result"])
            except (ValueError, KeyError, TypeError) as error:
                raise FileError(f"{path}: line {number}: no finished trial: {error}") from error

    def add(self, key: KeyT, result: ResultT) -> None:
        """Append a finished trial."""
        self.results[key] = result
        record = {"key": dataclasses.asdict(key), "result": dataclasses.asdict(result)}
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(record) + "\n")
