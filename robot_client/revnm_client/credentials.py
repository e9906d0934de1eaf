"""What one end of a Zenoh link shows the other to be let in, and by what it knows the other."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from revnm_client.errors import FileError

_LONGEST = 256


@dataclass(frozen=True, slots=True)
class Credentials:
    """Of a client: a robot, or whoever looks at one.

    Attributes:
        authority: PEM file of the authority whose servers are trusted; only ``tls/`` endpoints ask for it.
        certificate: PEM file that shows who this is, its common name being the robot's; with ``key``.
        key: PEM file, private.
        user: Name to log in with, the robot's; with ``password``.
        password: Never shown.
    """

    authority: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    user: str | None = None
    password: str | None = field(default=None, repr=False)

    def zenoh_settings(self) -> dict[str, Any]:
        """Return the settings of Zenoh that they are.

        Raises:
            FileError: A file cannot be read.
        """
        files = {
            "root_ca_certificate": ("authority", self.authority),
            "connect_certificate": ("certificate", self.certificate),
            "connect_private_key": ("key", self.key),
        }
        settings: dict[str, Any] = {
            f"transport/link/tls/{name}": readable(path, key=f"security.{key}", maker="revnm-server pki robot")
            for name, (key, path) in files.items()
            if path is not None
        }
        if self.certificate is not None:
            settings["transport/link/tls/enable_mtls"] = True
        if self.password is not None:
            settings["transport/auth/usrpwd/user"] = self.user
            settings["transport/auth/usrpwd/password"] = self.password
        return settings


def readable(path: Path, *, key: str, maker: str) -> str:
    """Return the path of a file that can be read: Zenoh itself would not say which one cannot.

    Args:
        path: The file.
        key: Of the settings that name it.
        maker: The command that can make such files.

    Raises:
        FileError: It cannot.
    """
    try:
        with path.open("rb"):
            return str(path.absolute())
    except FileNotFoundError as error:
        raise FileError(f"{key}: {path}: cannot be read: there is no such file ({maker} can make it)") from error
    except OSError as error:
        raise FileError(f"{key}: {path}: cannot be read: {error.strerror}") from error


def read_password(path: Path) -> str:
    """Return the password that a file holds: its only line.

    Raises:
        FileError: The file cannot be read, or holds none, or several lines.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"security.password_file: {path}: cannot be read: {error}") from error
    password = text.removesuffix("\n").removesuffix("\r")
    if not password or not password.isprintable() or len(password) > _LONGEST:
        raise FileError(
            f"security.password_file: {path}: expected the password on one line, 1 to {_LONGEST} characters"
        )
    return password
