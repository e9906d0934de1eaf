"""Settings of the camera on the wall."""

from __future__ import annotations

import pydantic

from revnm_client.keys import check_name
from revnm_server.camera.url import parse_camera_url, redact
from revnm_server.settings.section import Section, reraised


class CameraSettings(Section):
    """The camera on the wall; ``name`` is that of the file in which its calibration is kept."""

    url: str = "zenoh://camera"
    name: str = "camera"

    def __repr__(self) -> str:
        return f"CameraSettings(url={redact(self.url)!r}, name={self.name!r})"

    def __str__(self) -> str:
        return repr(self)

    @pydantic.field_validator("url")
    @classmethod
    def _understood(cls, url: str) -> str:
        reraised(parse_camera_url, url)
        return url

    @pydantic.field_validator("name")
    @classmethod
    def _named(cls, name: str) -> str:
        reraised(check_name, redact(name))  # an address that stands in the wrong place is not shown either
        return name
