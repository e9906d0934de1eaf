"""The authority's folder: ``authority.pem`` and ``.key``, ``server.pem`` and ``.key``, and a folder for each robot.

Keys are not encrypted, and readable for their owner only. What is there is never written over but the server's.
"""

from __future__ import annotations

import datetime
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import NameOID

from revnm_client.errors import FileError
from revnm_client.keys import check_name
from revnm_server.pki import certificates
from revnm_server.pki.certificates import Pair, alternative_names

_AUTHORITY, _SERVER, _ROBOT = "authority", "server", "robot"


@dataclass(frozen=True, slots=True)
class Issued:
    """A certificate in a file.

    Attributes:
        path: The file.
        name: Its common name.
        ends: Until when it is good, UTC.
    """

    path: Path
    name: str
    ends: datetime.datetime


def create_authority(folder: Path, hosts: Sequence[str]) -> None:
    """Make a folder with a new authority, and a certificate for the server.

    Args:
        folder: Must not be there.
        hosts: Names and addresses by which robots and browsers reach the server.

    Raises:
        ConfigError: A host is no name or address, or there is none.
        FileError: The folder is there, or cannot be made; then nothing is left of it.
    """
    names = alternative_names(hosts)
    with _made(folder) as made:
        authority = certificates.authority()
        _write(made / _AUTHORITY, authority)
        _write(made / _SERVER, certificates.server(authority, names))


def issue_server(folder: Path, hosts: Sequence[str]) -> None:
    """Give the server a new certificate in place of its old one, as when its address has changed.

    Raises:
        ConfigError: A host is no name or address, or there is none.
        FileError: The folder holds no authority, or cannot be written to.
    """
    names = alternative_names(hosts)
    pair = certificates.server(_load(folder), names)
    try:
        with tempfile.TemporaryDirectory(prefix=f".{_SERVER}-", dir=folder) as made:
            _write(Path(made) / _SERVER, pair)
            for suffix in (".key", ".pem"):
                (Path(made) / _SERVER).with_suffix(suffix).replace((folder / _SERVER).with_suffix(suffix))
    except OSError as error:
        raise FileError(f"{folder}: cannot be written to: {error.strerror}") from error


def issue_robot(folder: Path, robot: str) -> Path:
    """Make the folder that is copied to a robot: the authority's certificate, the robot's, and its key.

    Args:
        folder: Of the authority.
        robot: Name of the robot, or of a camera that publishes over Zenoh.

    Returns:
        The robot's folder.

    Raises:
        ConfigError: It cannot be a robot's name.
        FileError: The folder holds no authority, or the robot has its folder; nothing is changed then.
    """
    authority = _load(folder)
    with _made(folder / check_name(robot)) as made:
        _write(made / _ROBOT, certificates.robot(authority, robot))
        shutil.copyfile(folder / f"{_AUTHORITY}.pem", made / f"{_AUTHORITY}.pem")
    return folder / robot


def issued(folder: Path) -> list[Issued]:
    """Return the certificates in an authority's folder: its own, the server's, the robots' by name.

    Raises:
        FileError: One of them cannot be read.
    """
    paths = [folder / f"{_AUTHORITY}.pem", folder / f"{_SERVER}.pem", *sorted(folder.glob(f"*/{_ROBOT}.pem"))]
    return [read_certificate(path) for path in paths]


def read_certificate(path: Path) -> Issued:
    """Return what a PEM file's first certificate says.

    Raises:
        FileError: It cannot be read, or is none.
    """
    certificate = _certificate(path)
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return Issued(path, str(names[0].value) if names else "", certificate.not_valid_after_utc)


@contextmanager
def _made(target: Path) -> Iterator[Path]:
    """Make a folder for its owner only, that is there as a whole or not at all.

    Raises:
        FileError: It is there, or cannot be made.
    """
    if target.exists():
        raise FileError(f"{target}: is there, and is not written over: move it away if a new one is meant")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise FileError(f"{target}: cannot be made: {error.strerror}") from error
    try:
        yield folder
        folder.rename(target)
    except OSError as error:
        raise FileError(f"{target}: cannot be made: {error.strerror}") from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _load(folder: Path) -> Pair:
    path = folder / f"{_AUTHORITY}.key"
    certificate = _certificate(folder / f"{_AUTHORITY}.pem")
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError) as error:
        raise FileError(f"{path}: expected an unencrypted private key in PEM: {error}") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise FileError(f"{path}: is not the key of {_AUTHORITY}.pem beside it")
    return Pair(certificate, key)


def _certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise FileError(f"{path}: expected a certificate in PEM: {error}") from error


def _write(stem: Path, pair: Pair) -> None:
    """Write ``stem.pem``, and ``stem.key`` for its owner only."""
    stem.with_suffix(".pem").write_bytes(pair.certificate.public_bytes(Encoding.PEM))
    private = pair.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    with os.fdopen(os.open(stem.with_suffix(".key"), os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(private)
