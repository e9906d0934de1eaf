"""Says why nobody answers at an address, in words that help: what Zenoh says itself does not."""

from __future__ import annotations

import re
import socket
from collections.abc import Sequence

_TIMEOUT_S = 3.0
_TCP = re.compile(r"(?:tcp|tls)/\[?([^\]/]+?)\]?:([0-9]{1,5})(?:[?#].*)?")


def unreachable(endpoints: Sequence[str]) -> str | None:
    """Return why none of the endpoints takes a TCP connection; None where one does, or is no TCP endpoint."""
    problems = []
    for endpoint in endpoints:
        match = _TCP.fullmatch(endpoint)
        problem = None if match is None else _problem(match[1], int(match[2]))
        if problem is None:
            return None
        problems.append(f"{endpoint}: {problem}")
    return "; ".join(problems)


def _problem(host: str, port: int) -> str | None:
    try:
        socket.create_connection((host, port), timeout=_TIMEOUT_S).close()
    except socket.gaierror:
        return f"no machine is called {host}: check the name, or give its address"
    except TimeoutError:
        return f"no answer in {_TIMEOUT_S:g} s: check the address, the network and the firewall there"
    except ConnectionRefusedError:
        return "nothing listens there: is it running, and does it listen on an address that others reach?"
    except (OSError, OverflowError) as error:
        return f"{error}: check the address and the network"
    return None
