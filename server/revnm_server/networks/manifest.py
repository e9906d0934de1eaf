"""What ``manifest.json`` of a model bundle may say.

Training writes bundles by this schema and the server reads them by it. Unknown keys are errors. Imports no
onnxruntime, so that training needs none.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator

from revnm_client.errors import FileError
from revnm_server.observation import ObservationSpec

MANIFEST = "manifest.json"
_MANIFEST_MAX_BYTES = 1_000_000

FileName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}$")]
Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Side = Annotated[int, Field(ge=8, le=4096)]
Positive = Annotated[float, Field(gt=0.0, le=1000.0)]
PerChannel = tuple[float, float, float]


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class ObservationSection(_Section):
    """The fields of :class:`~revnm_server.observation.ObservationSpec`."""

    history: int = Field(ge=1, le=32)
    history_interval_s: Positive
    disparity_hw: tuple[Side, Side]
    exo_hw: tuple[Side, Side]
    crop_px: Side
    crop_span: float = Field(gt=0.0, le=4.0)
    crop_heading_up: bool
    ego_px: Side
    ego_hfov_rad: float = Field(gt=0.0, lt=np.pi)
    ego_height_m: Positive
    ego_range_m: Positive
    waypoints: int = Field(ge=1, le=64)
    spacing_m: Positive

    def to_spec(self) -> ObservationSpec:
        """Return the same as the plain data that the pipeline uses."""
        return ObservationSpec(**self.model_dump())


class ModelSection(_Section):
    """A model's file."""

    file: FileName
    sha256: Sha256


class PolicySection(ModelSection):
    """The policy's file, and whether it sees the camera's picture, as in the paper, or the lifted map.

    With an ``encoder``, the policy sees the features that this other model makes of each picture, not the pictures.
    """

    sees: Literal["picture", "map"]
    encoder: ModelSection | None = None


class Exo2EgoSection(ModelSection):
    """The denoiser's file, how it is sampled, and whether it sees the exo depth reprojected.

    Without ``noise`` it is a plain regression, called once on zeros.
    """

    steps: int = Field(ge=1, le=1000)
    schedule: Literal["cosine"]
    prior: bool
    noise: bool


class DepthSection(ModelSection):
    """The depth network's file, what it gives, and how its input is normalised."""

    kind: Literal["disparity"]
    mean: PerChannel
    std: tuple[Positive, Positive, Positive]


class ModelsSection(_Section):
    """The three models."""

    policy: PolicySection
    exo2ego: Exo2EgoSection
    depth: DepthSection


class Manifest(_Section):
    """``manifest.json`` of a bundle; ``recipe``, ``data`` and ``results`` are for people."""

    format: Literal[2]
    name: str = Field(min_length=1, max_length=64)
    observation: ObservationSection
    models: ModelsSection
    recipe: dict[str, Any]
    data: dict[str, Any]
    results: dict[str, Any]

    @model_validator(mode="after")
    def _prior_needs_a_map(self) -> Self:
        if self.models.exo2ego.prior and self.models.policy.sees != "map":
            raise ValueError("models.exo2ego.prior: needs a policy that sees the map")
        if self.models.policy.sees == "map" and self.observation.history != 1:
            raise ValueError("observation.history: a policy that sees the map has a history of 1")
        if self.models.policy.sees == "map" and self.models.policy.encoder is not None:
            raise ValueError("models.policy.encoder: needs a policy that sees the picture")
        return self


def read_manifest(folder: Path) -> Manifest:
    """Read and check the manifest of a bundle without touching its models.

    Raises:
        FileError: It is missing, cannot be read or is malformed; the text names the key.
    """
    path = folder / MANIFEST
    if not path.is_file():
        raise FileError(f"{path}: missing; expected the manifest of a model bundle")
    if path.stat().st_size > _MANIFEST_MAX_BYTES:
        raise FileError(f"{path}: larger than {_MANIFEST_MAX_BYTES} bytes")
    try:
        return Manifest.model_validate_json(path.read_bytes())
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise FileError(f"{path}: {_describe(error)}") from error


def _describe(error: ValidationError) -> str:
    lines = []
    for fault in error.errors(include_url=False):
        key = ".".join(str(part) for part in fault["loc"]) or "the whole file"
        reason = "unknown key" if fault["type"] == "extra_forbidden" else fault["msg"]
        lines.append(f"{key}: {reason}")
    return "; ".join(lines)
