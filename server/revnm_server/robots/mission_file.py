"""The mission on disk: written whole or not at all, checked when it is read."""

from __future__ import annotations

import json
import logging
import os
import tempfile
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import pydantic
from typing_extensions import TypedDict

from revnm_client.errors import FileError

logger = logging.getLogger(__name__)

_FORMAT = 1
Coordinate = Annotated[float, pydantic.Field(ge=0.0, lt=65_536.0)]
Side = Annotated[int, pydantic.Field(ge=1, le=65_536)]


class GoalRecord(TypedDict):
    """A goal as it is stored: see :class:`revnm_server.robots.mission.Goal`."""

    id: Annotated[str, pydantic.Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9_-]+$")]
    pixel_uv: tuple[Coordinate, Coordinate]
    size_px: tuple[Side, Side]


class Record(TypedDict):
    """One robot as it is stored: see :class:`revnm_server.robots.mission.RobotMission`."""

    goal: GoalRecord | None
    arrived: bool
    stopped: bool
    epoch: Annotated[int, pydantic.Field(ge=0, lt=2**53)]
    order: Literal["stop", "resume"] | None


class _Document(TypedDict):
    format: Literal[1]
    robots: dict[str, Record]


class MissionFile:
    """A JSON file that is replaced at every change. Thread-safe.

    Attributes:
        error: Why the last write failed, if it did.
    """

    def __init__(self, path: Path) -> None:
        self.error: str | None = None
        self._path = path
        self._lock = threading.Lock()
        self._saved_version = -1

    def load(self) -> dict[str, Record]:
        """Return what was saved, by robot; nothing if there is no file yet.

        Raises:
            FileError: The file cannot be read or is malformed.
        """
        try:
            text = self._path.read_text()
        except FileNotFoundError:
            return {}
        except (OSError, UnicodeDecodeError) as error:
            raise FileError(f"state file {self._path}: {error}") from error
        try:
            document = pydantic.TypeAdapter(_Document).validate_json(text)
        except pydantic.ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(str(part) for part in first["loc"])
            raise FileError(
                f"state file {self._path}: {place or 'text'}: {first['msg']}; "
                "mend it, or move it away to start without goals"
            ) from error
        return document["robots"]

    def save(self, records: Mapping[str, Record], *, version: int) -> None:
        """Replace the file, safe against a crash at any moment; a failure is kept in ``error``.

        Args:
            records: All robots.
            version: Counts the changes: an older one does not overwrite a newer one.
        """
        with self._lock:
            if version <= self._saved_version:
                return
            try:
                self._replace(json.dumps({"format": _FORMAT, "robots": dict(records)}, indent=1))
            except OSError as error:
                self.error = f"cannot write state file {self._path}: {error.strerror}"
                logger.error("%s", self.error)
                return
            self.error = None
            self._saved_version = version

    def _replace(self, text: str) -> None:
        folder = self._path.parent
        folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=self._path.name, suffix=".part", dir=folder)
        part = Path(name)
        try:
            with os.fdopen(handle, "w") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            part.replace(self._path)
        except OSError:
            part.unlink(missing_ok=True)
            raise
        folder_handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(folder_handle)
        finally:
            os.close(folder_handle)
