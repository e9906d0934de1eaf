"""Which addresses only this machine can reach."""

from __future__ import annotations

import ipaddress
from urllib.parse import urlsplit

_IN_THIS_MACHINE = ("unixsock-stream", "unixpipe")


def is_loopback(host: str) -> bool:
    """Return whether a host's name or address means this machine and nothing else; rubbish does not."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_local_endpoint(endpoint: str) -> bool:
    """Return whether only this machine can reach a Zenoh endpoint, such as ``tcp/127.0.0.1:7447``."""
    protocol, _, address = endpoint.partition("/")
    try:
        return protocol in _IN_THIS_MACHINE or is_loopback(urlsplit(f"//{address}").hostname or "")
    except ValueError:
        return False
