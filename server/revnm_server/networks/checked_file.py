"""Files that are only used if they are what somebody said they are.

Imports the standard library only, so that commands which load no model start at once.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from revnm_client.errors import FileError


def file_sha256(path: Path) -> str:
    """Return the sha256 of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_sha256(path: Path, expected: str) -> None:
    """Check a file against the sum that was given for it.

    Args:
        path: The file.
        expected: Its sha256, hexadecimal, lower case.

    Raises:
        FileError: It is missing, cannot be read or has another sum; the text says both sums.
    """
    if not path.is_file():
        raise FileError(f"{path}: missing")
    try:
        got = file_sha256(path)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    if got != expected:
        raise FileError(f"{path}: altered: sha256 expected {expected}, got {got}")
