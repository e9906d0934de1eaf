"""Settings of run records: where they are kept, and how much of the disk they may take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pydantic

from revnm_server.settings.section import Section

_MB_PER_GB = 1000.0


class RecordingSettings(Section):
    """Where run records are kept, and how large they become.

    Without a ``folder`` nothing can be recorded. A record is cut into files of ``rotate_mb`` or ``rotate_s``, whichever
    comes first. The oldest are deleted before all together would take more than ``quota_gb``, and where the disk has
    less than ``least_free_gb`` left. ``from_start`` records without being told to. ``jpeg_quality`` is that of pictures
    which did not come as JPEG.
    """

    folder: Path | None = None
    quota_gb: Annotated[float, pydantic.Field(gt=0.0)] = 10.0
    rotate_mb: Annotated[float, pydantic.Field(gt=0.0)] = 500.0
    rotate_s: Annotated[float, pydantic.Field(gt=0.0)] = 600.0
    least_free_gb: Annotated[float, pydantic.Field(ge=0.0)] = 1.0
    from_start: bool = False
    jpeg_quality: Annotated[int, pydantic.Field(ge=1, le=100)] = 90

    @pydantic.model_validator(mode="after")
    def _consistent(self) -> RecordingSettings:
        if self.from_start and self.folder is None:
            raise ValueError("from_start needs a folder")
        if self.quota_gb * _MB_PER_GB < 2.0 * self.rotate_mb:
            raise ValueError(
                f"quota_gb {self.quota_gb} holds no two files of rotate_mb {self.rotate_mb}: the one that is written, "
                "and the one before"
            )
        return self
