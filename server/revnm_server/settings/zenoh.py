"""Settings of the Zenoh router that robots connect to."""

from __future__ import annotations

from typing import Annotated

import pydantic

from revnm_server.settings.section import Section


class ZenohSettings(Section):
    """The router's endpoints."""

    listen: Annotated[tuple[str, ...], pydantic.Field(min_length=1)] = ("tcp/127.0.0.1:7447",)
