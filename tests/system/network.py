"""Other machines as network namespaces, and what wires this one to them. Linux, as root.

Addresses are from 198.18.0.0/15, which RFC 2544 keeps for tests; each cable has a /24 of its own.
"""

from __future__ import annotations

import fcntl
import os
import shutil
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

_TUN = Path("/dev/net/tun")
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_MTU_BYTES = 1400


@dataclass(frozen=True)
class Namespace:
    """A machine with a network of its own; what runs in it is started with ``prefix``."""

    name: str

    @property
    def prefix(self) -> tuple[str, ...]:
        """What stands before a command that is to run there; it stays one process."""
        return "ip", "netns", "exec", self.name


@dataclass(frozen=True)
class Tun:
    """An end of a cable whose packets a program carries.

    Attributes:
        device: Where to read the packets that the machine sends, and to write those that it shall get; never blocks.
        name: Of the interface.
    """

    device: int
    name: str


def require_namespaces() -> None:
    """Skip the test where there can be no namespaces, except where it must run (``CI`` is set): then fail."""
    reason = _lack()
    if reason is None:
        return
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)


@contextmanager
def namespace(name: str) -> Iterator[Namespace]:
    """Make a machine; what runs in it must have ended when the context is left."""
    _ip("netns", "add", name)
    try:
        _ip("-n", name, "link", "set", "lo", "up")
        yield Namespace(name)
    finally:
        _ip("netns", "delete", name)


@contextmanager
def tun(name: str, *, inside: Namespace | None = None) -> Iterator[Tun]:
    """Make an end of a cable, here or inside of a namespace.

    Args:
        name: Of the interface; nobody here may have it.
        inside: Where; None is here.
    """
    device = os.open(_TUN, os.O_RDWR | os.O_NONBLOCK)
    try:
        fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN | _IFF_NO_PI))
        if inside is not None:
            _ip("link", "set", name, "netns", inside.name)
        yield Tun(device, name)
    finally:
        os.close(device)  # the interface goes with it


@contextmanager
def cable(name: str, *, inside: Namespace) -> Iterator[None]:
    """Wire this machine to another, without any fault; the interface is called the same at both ends."""
    _ip("link", "add", name, "type", "veth", "peer", "name", name, "netns", inside.name)
    try:
        yield
    finally:
        _ip("link", "delete", name)


def give_address(interface: str, address: str, *, inside: Namespace | None = None) -> None:
    """Give an interface an address, as 198.18.0.1/24, and let it work."""
    where = () if inside is None else ("-n", inside.name)
    _ip(*where, "address", "add", address, "dev", interface)
    _ip(*where, "link", "set", interface, "mtu", str(_MTU_BYTES), "up")


def take_address(interface: str, address: str, *, inside: Namespace) -> None:
    """Take an address away: what is sent to it is lost from now on, without an answer."""
    _ip("-n", inside.name, "address", "delete", address, "dev", interface)


@contextmanager
def small_disk(folder: Path, *, size_mb: int) -> Iterator[None]:
    """Make a folder that is a disk of its own; what is started in a namespace later has it, too."""
    folder.mkdir()
    _run("mount", "-t", "tmpfs", "-o", f"size={size_mb}m", "tmpfs", str(folder))
    try:
        yield
    finally:
        _run("umount", str(folder))


def _lack() -> str | None:
    """Return why there can be no namespaces; None where there can be."""
    if shutil.which("ip") is None:
        return "no command ip: make network installs iproute2"
    name = f"revnm-{os.getpid()}"
    try:
        with namespace(name) as there, tun(name, inside=there):
            return None
    except subprocess.CalledProcessError as error:
        return f"no network namespaces: {error.stderr.strip() or error}"
    except OSError as error:
        return f"no TUN devices: {_TUN}: {error.strerror}"


def _ip(*arguments: str) -> None:
    _run("ip", *arguments)


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, text=True)
