"""Two machines and what is between them: the robot's, which is this one, and the server's, a network namespace.

A link that can be broken is between both, and a cable that never is: it wires the camera to the server.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from .emulated_link import EmulatedLink
from .network import Namespace, cable, give_address, namespace, tun

_PORT = 7447
_MOST_SITES = 128
_SEED = 0

SERVER_HOSTS = 2, 3
"""Addresses that the robot looks for its server at, on the link; the server is at the first."""


@dataclass(frozen=True)
class Site:
    """Two machines, wired.

    Attributes:
        edge: Where the server is.
        link: Between robot and server.
        subnets: The first three bytes of the addresses on the link, and on the camera's cable.
        interface: Of the link, at the server's end.
    """

    edge: Namespace
    link: EmulatedLink
    subnets: tuple[str, str]
    interface: str

    def endpoint(self, host: int) -> str:
        """Return the Zenoh endpoint of a server that has this address on the link."""
        return f"tcp/{self.subnets[0]}.{host}:{_PORT}"


def _free_number() -> int:
    """Return a number whose interfaces are not there: neither another test's, nor those of one that was killed."""
    names = {path.name for path in Path("/sys/class/net").iterdir()}
    return next(number for number in range(_MOST_SITES) if not {f"revnm{number}", f"revnm{number}c"} & names)


@contextmanager
def site() -> Iterator[Site]:
    """Wire two machines."""
    with ExitStack() as stack:
        number = _free_number()
        here = stack.enter_context(tun(f"revnm{number}"))
        edge = stack.enter_context(namespace(f"{here.name}-{os.getpid()}"))
        there = stack.enter_context(tun(f"revnm{number}e", inside=edge))
        subnets = f"198.18.{2 * number}", f"198.18.{2 * number + 1}"
        give_address(here.name, f"{subnets[0]}.1/24")
        give_address(there.name, f"{subnets[0]}.{SERVER_HOSTS[0]}/24", inside=edge)
        stack.enter_context(cable(f"{here.name}c", inside=edge))
        give_address(f"{here.name}c", f"{subnets[1]}.1/24")
        give_address(f"{here.name}c", f"{subnets[1]}.2/24", inside=edge)
        link = stack.enter_context(EmulatedLink(here.device, there.device, seed=_SEED))
        yield Site(edge, link, subnets, there.name)
