"""Depth networks of others that are known here: where they are, their sums, their licences and their settings."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Self

import httpx
import pydantic
import yaml

from revnm_server.networks.download import check_url
from revnm_server.networks.manifest import FileName, Sha256
from revnm_server.settings.depth import DepthSettings
from revnm_server.settings.section import Section, reraised

_CATALOGUE = Path(__file__).with_name("model_catalogue.yaml")

ModelName = Annotated[str, pydantic.StringConstraints(pattern=r"^[a-z0-9][a-z0-9-]{0,63}$")]


class CatalogueFile(Section):
    """A file of a network; without ``sha256`` where nobody was found who publishes it."""

    url: str
    sha256: Sha256 | None = None
    size_bytes: Annotated[int, pydantic.Field(gt=0)] | None = None

    @property
    def name(self) -> str:
        """Name of the file."""
        return file_name(self.url)

    @pydantic.field_validator("url")
    @classmethod
    def _allowed(cls, url: str) -> str:
        reraised(check_url, url)
        return url


class CatalogueEntry(Section):
    """A network: the model is its first file, the others lie beside it; ``depth`` holds its settings, files apart."""

    about: str
    licence: str
    source: str
    files: Annotated[tuple[CatalogueFile, ...], pydantic.Field(min_length=1)]
    depth: dict[str, Any]

    @pydantic.model_validator(mode="after")
    def _settable(self) -> Self:
        DepthSettings.model_validate({"model": self.files[0].name, "sha256": "0" * 64, **self.depth})
        pydantic.TypeAdapter(tuple[FileName, ...]).validate_python(tuple(file.name for file in self.files))
        return self


def load_catalogue(path: Path = _CATALOGUE) -> dict[str, CatalogueEntry]:
    """Return the known networks by name."""
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    return pydantic.TypeAdapter(dict[ModelName, CatalogueEntry]).validate_python(content)


def file_name(url: str) -> str:
    """Return the name of the file that a URL leads to; empty where it has none."""
    return PurePosixPath(httpx.URL(url).path).name
