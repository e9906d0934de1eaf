"""The folder of the run records: names for new ones, and room for them by deleting the oldest.

Only files that this program wrote are ever deleted: their name and their first bytes must say so, and nobody may be
writing them.
"""

from __future__ import annotations

import fcntl
import logging
import re
import shutil
import stat
import struct
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from revnm_server.recording.errors import RecordingError
from revnm_server.recording.record_file import LIBRARY, PART

logger = logging.getLogger(__name__)

_NAME = re.compile(r"revnm-\d{8}-\d{6}-\d{3}\.mcap(\.part)?")
_MAGIC = b"\x89MCAP0\r\n"
_MB, _GB = 1e6, 1e9


@dataclass(frozen=True, slots=True)
class KeptRecord:
    """A record on the disk that nobody writes any more.

    Attributes:
        path: The file.
        size_bytes: What it takes.
    """

    path: Path
    size_bytes: int


class RecordFolder:
    """A folder of records. Several servers may share it.

    Args:
        folder: Is made when it is needed.
        quota_bytes: What all records together may take.
        least_free_bytes: What must stay free on the disk.
    """

    def __init__(self, folder: Path, *, quota_bytes: float, least_free_bytes: float) -> None:
        self._folder = folder
        self._quota_bytes, self._least_free_bytes = quota_bytes, least_free_bytes

    def new_path(self) -> Path:
        """Return where a new record may be written.

        Raises:
            RecordingError: There is no folder, or none to write in.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"recording.folder {self._folder}: {error.strerror}") from error
        while True:
            now = datetime.now(UTC)
            path = self._folder / f"revnm-{now:%Y%m%d-%H%M%S}-{now.microsecond // 1000:03d}.mcap"
            if not path.exists() and not path.with_name(path.name + PART).exists():
                return path

    def kept(self) -> list[KeptRecord]:
        """Return the records that nobody writes any more, oldest first.

        Raises:
            RecordingError: The folder cannot be read.
        """
        try:
            names = sorted(path.name for path in self._folder.iterdir() if _NAME.fullmatch(path.name))
        except OSError as error:
            raise RecordingError(f"recording.folder {self._folder}: {error.strerror}") from error
        found = (_ours(self._folder / name) for name in names)
        return [record for record in found if record is not None]

    def make_room(self, *, written_bytes: int, wanted_bytes: float) -> None:
        """Delete the oldest records until there is room.

        Args:
            written_bytes: What the record that is being written has by now.
            wanted_bytes: What it may still need.

        Raises:
            RecordingError: There is too little room without any of them, or the folder cannot be read.
        """
        kept = self.kept()
        if self._free_bytes() + sum(record.size_bytes for record in kept) < self._least_free_bytes:
            self.check_free()  # others fill the disk: to delete every record would not help
        while kept:
            taken = written_bytes + wanted_bytes + sum(record.size_bytes for record in kept)
            if taken <= self._quota_bytes and self._free_bytes() >= self._least_free_bytes:
                return
            oldest = kept.pop(0)
            try:
                oldest.path.unlink(missing_ok=True)
            except OSError as error:
                raise RecordingError(f"{oldest.path} cannot be deleted to make room: {error.strerror}") from error
            logger.info("deleted the record %s to make room", oldest.path)
        self.check_free()

    def check_free(self) -> None:
        """Check that the disk has as much left as must stay free.

        Raises:
            RecordingError: It has not.
        """
        free_bytes = self._free_bytes()
        if free_bytes < self._least_free_bytes:
            raise RecordingError(
                f"the disk of {self._folder} has {free_bytes / _MB:.0f} MB left: recording.least_free_gb "
                f"keeps {self._least_free_bytes / _GB:g} GB free"
            )

    def _free_bytes(self) -> int:
        try:
            return shutil.disk_usage(self._folder).free
        except OSError as error:
            raise RecordingError(f"recording.folder {self._folder}: {error.strerror}") from error


def _ours(path: Path) -> KeptRecord | None:
    """Return the record at a path of our kind of name; None where it is something else, or being written."""
    try:
        about = path.lstat()
        if not stat.S_ISREG(about.st_mode):
            return None
        with path.open("rb") as file:
            if file.read(len(_HEAD)) != _HEAD:
                return None
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return None  # not readable, gone by now, or locked by whoever writes it
    return KeptRecord(path, about.st_size)


def _head() -> bytes:
    """Return how every file of ours begins: MCAP's magic, and the header with profile and library."""
    strings = b"".join(struct.pack("<I", len(text)) + text.encode() for text in ("ros2", LIBRARY))
    return _MAGIC + struct.pack("<BQ", 1, len(strings)) + strings


_HEAD = _head()
