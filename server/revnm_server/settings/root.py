"""All settings together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pydantic
from pydantic_settings import BaseSettings, SettingsConfigDict

from revnm_client.keys import check_name
from revnm_server.settings.camera import CameraSettings
from revnm_server.settings.depth import DepthSettings
from revnm_server.settings.http import HttpSettings
from revnm_server.settings.logs import LogSettings
from revnm_server.settings.perception import PerceptionSettings
from revnm_server.settings.recording import RecordingSettings
from revnm_server.settings.section import reraised
from revnm_server.settings.zenoh import ZenohSettings

_TAGS_OF_36H11 = 587


class Settings(BaseSettings):
    """Everything that can be set.

    ``robots`` maps names to the ids of their AprilTags (36h11); ``state_file`` keeps goals over a restart.
    """

    model_config = SettingsConfigDict(
        env_prefix="REVNM_", env_nested_delimiter="__", extra="forbid", frozen=True, allow_inf_nan=False
    )

    camera: CameraSettings = CameraSettings()
    zenoh: ZenohSettings = ZenohSettings()
    http: HttpSettings = HttpSettings()
    perception: PerceptionSettings = PerceptionSettings()
    depth: DepthSettings = DepthSettings()
    log: LogSettings = LogSettings()
    recording: RecordingSettings = RecordingSettings()
    robots: dict[str, Annotated[int, pydantic.Field(ge=0, lt=_TAGS_OF_36H11)]] = {"rover": 0}
    state_file: Path | None = None

    @pydantic.field_validator("robots")
    @classmethod
    def _distinct(cls, robots: dict[str, int]) -> dict[str, int]:
        for name in robots:
            reraised(check_name, name)
        if not robots or len(set(robots.values())) != len(robots):
            raise ValueError("expected at least one robot, each with a tag of its own")
        return robots

    @property
    def own_certificates(self) -> list[Path]:
        """Files of the certificates that the server shows, or knows robots by."""
        paths = (self.zenoh.certificate, self.zenoh.authority, self.http.certificate)
        return [path for path in paths if path is not None]

    @property
    def certificates(self) -> list[Path]:
        """Its own, and the robots', where they lie beside the authority's."""
        authority = self.zenoh.authority
        return [*self.own_certificates, *([] if authority is None else sorted(authority.parent.glob("*/robot.pem")))]
