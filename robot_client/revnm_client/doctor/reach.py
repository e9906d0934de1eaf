"""Says why nobody answers at an address, in words that help: what Zenoh says itself does not."""

from __future__ import annotations

import re
import socket
import ssl
from collections.abc import Sequence

from revnm_client.credentials import Credentials
from revnm_client.errors import FileError

_TIMEOUT_S = 3.0
_REFUSES_WITHIN_S = 0.5
_THIS_MACHINE = ("127.0.0.1", "localhost", "::1")
_TCP = re.compile(r"(tcp|tls)/\[?([^\]/]+?)\]?:([0-9]{1,5})(?:[?#].*)?")


def unreachable(endpoints: Sequence[str], credentials: Credentials) -> str | None:
    """Return why none of the endpoints takes a connection; None where one does, or is neither TCP nor TLS.

    Args:
        endpoints: Such as ``tcp/192.168.1.5:7447``.
        credentials: What is shown there.

    Raises:
        FileError: A file of the credentials cannot be read.
    """
    problems = []
    for endpoint in endpoints:
        match = _TCP.fullmatch(endpoint)
        if match is None:
            return None
        context = _tls(credentials) if match[1] == "tls" else None
        problem = _problem(match[2], int(match[3]), context)
        if problem is None:
            return None
        problems.append(f"{endpoint}: {problem}")
    return "; ".join(problems)


def _tls(credentials: Credentials) -> ssl.SSLContext:
    """Return what makes the same demands of the server as Zenoh does."""
    credentials.zenoh_settings()  # says which file cannot be read
    try:
        context = ssl.create_default_context(cafile=credentials.authority)
        if credentials.certificate is not None:
            context.load_cert_chain(credentials.certificate, credentials.key)
    except ssl.SSLError as error:
        raise FileError(f"{credentials.authority}, {credentials.certificate}, {credentials.key}: {error}") from error
    return context


def _problem(host: str, port: int, tls: ssl.SSLContext | None) -> str | None:
    try:
        with socket.create_connection((host, port), timeout=_TIMEOUT_S) as connection:
            if tls is not None:
                with tls.wrap_socket(connection, server_hostname=host) as encrypted:
                    _greet(encrypted)
    except socket.gaierror:
        return f"no machine is called {host}: check the name, or give its address"
    except TimeoutError:
        return f"no answer in {_TIMEOUT_S:g} s: check the address, the network and the firewall there"
    except ConnectionRefusedError:
        if host in _THIS_MACHINE:
            return "nothing listens there: does it run, on this machine?"
        return "nothing listens there: is it running, and does it listen on an address that others reach?"
    except ssl.SSLCertVerificationError as error:
        return f"its certificate is not to be trusted: {error.verify_message.rstrip('.')}"
    except ssl.SSLError as error:
        return f"it does not take what this robot shows: {error.reason}: see security, and whether its clock is right"
    except (OSError, OverflowError) as error:
        return f"{error}: check the address and the network"
    return None


def _greet(connection: ssl.SSLSocket) -> None:
    """Wait for the server to refuse what it was shown: it does so after the handshake.

    Raises:
        ssl.SSLError: It does.
    """
    connection.settimeout(_REFUSES_WITHIN_S)
    try:
        connection.recv(1)
    except TimeoutError:
        return
