"""Settings of the Zenoh router that robots connect to: where it is, and who is let in."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pydantic

from revnm_server.settings.address import is_local_endpoint
from revnm_server.settings.section import Section

_ENCRYPTED = ("tls/", "quic/")


class ZenohSettings(Section):
    """The router's endpoints, and who is let in.

    ``certificate`` and ``key``, PEM files, encrypt; ``listen`` is ``tls/HOST:PORT`` then. With ``authority``, a PEM
    file, robots must show a certificate of that authority, their name in it. With ``passwords``, a file of
    ``NAME:PASSWORD`` lines, they log in instead. Either way each may use its own keys only. An address that others
    can reach needs one of the two, or ``insecure``.
    """

    listen: Annotated[tuple[str, ...], pydantic.Field(min_length=1)] = ("tcp/127.0.0.1:7447",)
    certificate: Path | None = None
    key: Path | None = None
    authority: Path | None = None
    passwords: Path | None = None
    insecure: bool = False

    @pydantic.model_validator(mode="after")
    def _encrypted(self) -> ZenohSettings:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key: expected both for TLS, or neither")
        if self.authority is not None and self.certificate is None:
            raise ValueError("authority needs the server's certificate and key, too: revnm-server pki init makes all")
        for endpoint in self.listen:
            if (self.certificate is not None) != endpoint.startswith(_ENCRYPTED):
                raise ValueError(f"listen is {endpoint}: expected tls/HOST:PORT with a certificate, and only with one")
        return self

    @pydantic.model_validator(mode="after")
    def _guarded(self) -> ZenohSettings:
        if self.authority is not None and self.passwords is not None:
            raise ValueError("authority and passwords: expected one of them: robots show certificates or log in")
        guarded = self.authority is not None or self.passwords is not None
        if guarded and self.insecure:
            raise ValueError("insecure: expected without authority and passwords, which it would not undo")
        others = [endpoint for endpoint in self.listen if not is_local_endpoint(endpoint)]
        if others and not guarded and not self.insecure:
            raise ValueError(
                f"{others[0]} can be reached by others, who could command the robots: let robots show certificates "
                "(authority: revnm-server pki) or log in (passwords), or say --insecure-zenoh if all there are trusted"
            )
        return self
