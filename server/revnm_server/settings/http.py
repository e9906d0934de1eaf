"""Settings of page and API: where they are, and who may see them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pydantic

from revnm_server.settings.address import is_loopback
from revnm_server.settings.section import Section

Token = Annotated[pydantic.SecretStr, pydantic.Field(min_length=16, max_length=256)]


class HttpSettings(Section):
    """Where the page and the API are, and who may see them.

    ``token`` is asked of everyone when it is set; an address that others can reach needs it, or ``insecure``. Who has
    only ``viewer_token`` may look, and stop robots, not drive them. ``certificate`` and ``key``, PEM files, make it
    HTTPS.
    """

    host: str = "127.0.0.1"
    port: Annotated[int, pydantic.Field(ge=0, le=65535)] = 8000
    token: Token | None = None
    viewer_token: Token | None = None
    insecure: bool = False
    certificate: Path | None = None
    key: Path | None = None

    @property
    def loopback(self) -> bool:
        """Whether only this machine can reach it."""
        return is_loopback(self.host)

    @pydantic.field_validator("token", "viewer_token")
    @classmethod
    def _printable(cls, token: pydantic.SecretStr | None) -> pydantic.SecretStr | None:
        if token is not None and not (token.get_secret_value().isascii() and token.get_secret_value().isalnum()):
            raise ValueError("expected ASCII letters and digits only")
        return token

    @pydantic.model_validator(mode="after")
    def _told_apart(self) -> HttpSettings:
        if self.viewer_token is not None and self.token is None:
            raise ValueError("viewer_token needs a token, too: without one everybody may drive the robots")
        if self.viewer_token is not None and self.viewer_token == self.token:
            raise ValueError("viewer_token and token are the same: viewers could drive the robots")
        return self

    @pydantic.model_validator(mode="after")
    def _encrypted(self) -> HttpSettings:
        if (self.certificate is None) != (self.key is None):
            raise ValueError("certificate and key: expected both for HTTPS, or neither")
        return self

    @pydantic.model_validator(mode="after")
    def _guarded(self) -> HttpSettings:
        if not self.loopback and self.token is None and not self.insecure:
            raise ValueError(
                f"{self.host} can be reached by others: set a token (REVNM_HTTP__TOKEN), "
                "or say --insecure-http if anyone there may drive the robots"
            )
        return self
