"""A model bundle: a folder with three or four ONNX models and a manifest that says what they expect.

Nothing in a bundle is trusted: every file is hashed, every model's inputs and outputs are compared with the
manifest, and each model runs once on zeros before the server says it is ready.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from revnm_client.errors import ContractError, FileError
from revnm_server.mapping.ego_prior import PRIOR_CHANNELS
from revnm_server.mapping.map_window import LAYERS, WAY_POINTS, WindowSpec
from revnm_server.networks.checked_file import check_sha256
from revnm_server.networks.depth_input import DepthInput
from revnm_server.networks.depth_network import DepthNetwork
from revnm_server.networks.depth_output import DepthOutput
from revnm_server.networks.inference import OnnxModel, Shape
from revnm_server.networks.manifest import DepthSection, Manifest, ModelSection, PolicySection, read_manifest
from revnm_server.networks.providers import Provider
from revnm_server.observation import ObservationSpec


@dataclass(frozen=True, slots=True)
class Exo2EgoConfig:
    """The exo2ego denoiser.

    Attributes:
        model: One call of the denoiser.
        steps: How many DDIM steps a sample takes.
        prior: Whether it sees the exo depth reprojected.
        noise: Whether it diffuses; else it is called once on zeros.
    """

    model: OnnxModel
    steps: int
    prior: bool
    noise: bool


@dataclass(frozen=True, slots=True)
class Bundle:
    """A checked bundle with its models loaded.

    Attributes:
        folder: Where it came from.
        name: Its name.
        spec: What the models observe.
        depth: The depth network.
        exo2ego: The exo2ego denoiser.
        policy: The policy's model.
        encoder: Makes the features that the policy sees instead of pictures, ``images`` (K, 1, e, e) → ``features``
            (K, T, d); None where the policy sees the pictures, or the map.
        sees: Whether the policy sees the camera's picture or the lifted map.
        manifest: The manifest, for people.
    """

    folder: Path
    name: str
    spec: ObservationSpec
    depth: DepthNetwork
    exo2ego: Exo2EgoConfig
    policy: OnnxModel
    encoder: OnnxModel | None
    sees: Literal["picture", "map"]
    manifest: dict[str, Any]


@dataclass(frozen=True, slots=True)
class DepthBundle:
    """What of a bundle a planner on the map needs.

    Attributes:
        spec: What the models observe; the depth network's size stands in it.
        depth: The depth network.
        missing: Names of the models that the bundle lacks.
    """

    spec: ObservationSpec
    depth: DepthNetwork
    missing: tuple[str, ...]


def default_bundle_path() -> Path:
    """Return the folder of the bundle that comes with the package."""
    return Path(__file__).parents[1] / "bundles" / "edge"


def load_bundle(folder: Path, *, threads: int = 2, provider: Provider = "cpu") -> Bundle:
    """Load a bundle and check all of it.

    Args:
        folder: The bundle.
        threads: Threads that one call of a model may use.
        provider: What runs the models.

    Raises:
        ConfigError: The provider is not installed, or cannot start.
        FileError: The manifest or a model is missing, malformed, altered, or does not fit; the text says
            which file and why.
    """
    manifest = read_manifest(folder)
    spec = manifest.observation.to_spec()
    models = manifest.models
    for section in _sections(manifest):
        check_sha256(folder / section.file, section.sha256)
    depth, exo2ego, policy = (
        OnnxModel(folder / section.file, threads=threads, provider=provider)
        for section in (models.depth, models.exo2ego, models.policy)
    )
    encoder = _load_encoder(folder, models.policy, spec, threads=threads, provider=provider)
    policy_contract = _map_policy(spec) if models.policy.sees == "map" else _policy(spec, encoder)
    for model, contract in (
        (depth, _depth(spec)),
        (exo2ego, _exo2ego(spec, prior=models.exo2ego.prior)),
        (policy, policy_contract),
    ):
        _check_model(model, *contract)
    return Bundle(
        folder=folder,
        name=manifest.name,
        spec=spec,
        depth=_depth_network(depth, models.depth, spec),
        exo2ego=Exo2EgoConfig(exo2ego, models.exo2ego.steps, models.exo2ego.prior, models.exo2ego.noise),
        policy=policy,
        encoder=encoder,
        sees=models.policy.sees,
        manifest=manifest.model_dump(mode="json"),
    )


def load_depth_bundle(folder: Path, *, threads: int = 2, provider: Provider = "cpu") -> DepthBundle:
    """Load a bundle's depth network; its other models may be missing, but what is there must not be altered.

    Args:
        folder: The bundle.
        threads: Threads that one call of the model may use.
        provider: What runs the model.

    Raises:
        ConfigError: The provider is not installed, or cannot start.
        FileError: The manifest or the depth network is missing, malformed or does not fit, or any model is altered.
    """
    manifest = read_manifest(folder)
    spec, section = manifest.observation.to_spec(), manifest.models.depth
    missing = missing_models(folder)
    for each in _sections(manifest):
        if each.file not in missing:
            check_sha256(folder / each.file, each.sha256)
    model = OnnxModel(folder / section.file, threads=threads, provider=provider)
    _check_model(model, *_depth(spec))
    return DepthBundle(spec, _depth_network(model, section, spec), missing)


def missing_models(folder: Path) -> tuple[str, ...]:
    """Return the names of the models, other than the depth network, that a bundle lacks.

    Raises:
        FileError: The manifest is missing or malformed.
    """
    models = read_manifest(folder).models
    others = (models.policy, models.policy.encoder, models.exo2ego)
    return tuple(each.file for each in others if each is not None and _is_missing(folder / each.file))


def _sections(manifest: Manifest) -> list[ModelSection]:
    models = manifest.models
    sections = (models.policy, models.policy.encoder, models.exo2ego, models.depth)
    return [each for each in sections if each is not None]


def _load_encoder(
    folder: Path, policy: PolicySection, spec: ObservationSpec, *, threads: int, provider: Provider
) -> OnnxModel | None:
    """Load the policy's encoder, if there is one, and check that it makes features of one size."""
    if policy.encoder is None:
        return None
    encoder = OnnxModel(folder / policy.encoder.file, threads=threads, provider=provider)
    features = encoder.outputs.get("features", ())[1:]
    if len(features) != 2 or None in features:
        raise FileError(f"{encoder.path}: output features: shape expected (any, tokens, channels), both numbers")
    _check_model(encoder, {"images": (None, 1, *spec.exo_hw)}, {"features": (None, *features)})
    return encoder


def _depth_network(model: OnnxModel, section: DepthSection, spec: ObservationSpec) -> DepthNetwork:
    takes = DepthInput("image", spec.disparity_hw, "fixed", section.mean, section.std)
    return DepthNetwork(model, takes, DepthOutput("disparity", section.kind))


def _is_missing(path: Path) -> bool:
    """Tell whether nothing at all lies there: what is there and is no file, or cannot be read, is an error."""
    return not path.exists() and not path.is_symlink()


Contract = tuple[dict[str, Shape], dict[str, Shape]]


def _depth(spec: ObservationSpec) -> Contract:
    height, width = spec.disparity_hw
    return {"image": (1, 3, height, width)}, {"disparity": (1, height, width)}


def _exo2ego(spec: ObservationSpec, *, prior: bool) -> Contract:
    ego = (None, 1, spec.ego_px, spec.ego_px)
    crop = (None, spec.history, spec.crop_px, spec.crop_px)
    inputs: dict[str, Shape] = {"noisy": ego, "crop": crop, "step": (None,), "robot": (None, 2), "heading": (None, 2)}
    if prior:
        inputs["prior"] = (None, PRIOR_CHANNELS, spec.ego_px, spec.ego_px)
    return inputs, {"clean": ego}


def _policy(spec: ObservationSpec, encoder: OnnxModel | None) -> Contract:
    exo: Shape = (None, spec.history, 1, *spec.exo_hw)
    ego: Shape = (None, spec.history, 1, spec.ego_px, spec.ego_px)
    if encoder is not None:
        exo = ego = (None, spec.history, *encoder.outputs["features"][1:])
    inputs: dict[str, Shape] = {
        "exo": exo,
        "ego": ego,
        "robot": (None, 2),
        "heading": (None, 2),
        "goal": (None, 2),
    }
    return inputs, {"waypoints": (None, spec.waypoints, 2)}


def _map_policy(spec: ObservationSpec) -> Contract:
    side = WindowSpec().side
    inputs: dict[str, Shape] = {
        "map": (None, len(LAYERS), side, side),
        "way": (None, WAY_POINTS, 2),
        "goal": (None, 2),
        "ego": (None, 1, spec.ego_px, spec.ego_px),
    }
    return inputs, {"occupied": (None, side, side)}


def _check_model(model: OnnxModel, inputs: dict[str, Shape], outputs: dict[str, Shape]) -> None:
    """Compare declared shapes with the contract, then run on zeros, which also warms the model up."""
    _check_shapes(model.path, "input", inputs, model.inputs)
    _check_shapes(model.path, "output", outputs, model.outputs)
    try:
        results = model.run(**{name: _zeros(name, shape, batch=2) for name, shape in inputs.items()})
    except ContractError as error:
        raise FileError(f"{error} (trial run on zeros)") from error
    got = {name: result.shape for name, result in results.items()}
    expected = {name: tuple(2 if n is None else n for n in shape) for name, shape in outputs.items()}
    _check_shapes(model.path, "output of a trial run", expected, got)


def _check_shapes(path: Path, kind: str, expected: Mapping[str, Shape], got: Mapping[str, Shape]) -> None:
    if expected.keys() != got.keys():
        raise FileError(f"{path}: {kind}s expected {sorted(expected)}, got {sorted(got)}")
    for name, shape in expected.items():
        if not _fits(shape, got[name]):
            raise FileError(f"{path}: {kind} {name}: shape expected {_text(shape)}, got {_text(got[name])}")


def _fits(expected: Shape, got: Shape) -> bool:
    # What the contract fixes, a model may leave open: the trial run shows what it does there.
    return len(expected) == len(got) and all(b is None or a == b for a, b in zip(expected, got, strict=True))


def _text(shape: Shape) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"


def _zeros(name: str, shape: Shape, *, batch: int) -> NDArray[Any]:
    dtype = np.int64 if name == "step" else np.float32
    return np.zeros([batch if n is None else n for n in shape], dtype=dtype)
