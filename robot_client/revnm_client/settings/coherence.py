"""What settings say that are right each by itself, and contradict each other."""

from __future__ import annotations

from collections.abc import Iterator

from revnm_client.settings.document import Place
from revnm_client.settings.root import RobotSettings

_ENCRYPTED = ("tls/", "quic/")


def contradictions(settings: RobotSettings) -> Iterator[tuple[Place, str]]:
    """Yield the places that contradict others, and what was expected there."""
    outline, security = settings.footprint, settings.security
    if abs(outline.center_x_m) > outline.length_m / 2.0:
        expected = f"expected at most half of length_m, {outline.length_m / 2.0:g}"
        yield ("footprint", "center_x_m"), f"{outline.center_x_m}: {expected}"
    if (security.certificate is None) != (security.key is None):
        yield ("security",), "expected certificate and key, or neither"
    if security.certificate is not None and security.password_file is not None:
        yield ("security",), "expected a certificate or a password, not both"
    if security.certificate is not None and security.authority is None:
        yield ("security",), "expected the authority with the certificate: by it the robot knows its server"
    for endpoint in settings.server:
        if endpoint.startswith(_ENCRYPTED) != (security.authority is not None):
            yield ("server",), f"{endpoint}: expected tls/HOST:PORT with security.authority, and only with it"
