"""Sizes of networks and training recipes, read from a YAML file.

Two presets ship: ``paper`` has the sizes of the paper, ``edge`` is what trains in an hour and runs in real time on
two CPU cores. The networks are the same code.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from revnm_client.errors import FileError
from revnm_server.observation import ObservationSpec


@dataclass(frozen=True, slots=True)
class BackboneConfig:
    """A ResNet of basic blocks.

    Attributes:
        width: Channels of the first stage; they double with every stage.
        blocks: Basic blocks of each stage; every stage after the first halves the grid.
    """

    width: int
    blocks: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class PolicyConfig:
    """The ACT-style CVAE policy.

    Attributes:
        exo_backbone: Encoder of the exo disparity.
        ego_backbone: Encoder of the ego depth; None shares the exo encoder, as in the paper.
        ego_px: The ego depth is enlarged to this side before it is encoded.
        robot_aligned: Paint robot, goal and robot-aligned coordinates into the exo picture and give the goal token
            the goal's place relative to the robot's heading; else poses enter by linear tokens only (paper).
        width: Channels of the transformer.
        heads: Attention heads.
        feedforward: Channels of the feed-forward layers.
        vae_layers: Layers of the CVAE encoder.
        encoder_layers: Layers of the transformer encoder.
        decoder_layers: Layers of the transformer decoder.
        latent: Dimensions of z.
        dropout: Dropout probability.
    """

    exo_backbone: BackboneConfig
    ego_backbone: BackboneConfig | None
    ego_px: int
    robot_aligned: bool
    width: int
    heads: int
    feedforward: int
    vae_layers: int
    encoder_layers: int
    decoder_layers: int
    latent: int
    dropout: float


@dataclass(frozen=True, slots=True)
class MapPolicyConfig:
    """The policy over the lifted map.

    Attributes:
        backbone: Encoder of the map's window, behind a stem that halves it.
        ego_backbone: Encoder of the ego depth.
        width: Channels of the transformer.
        heads: Attention heads.
        feedforward: Channels of the feed-forward layers.
        vae_layers: Layers of the CVAE encoder.
        encoder_layers: Layers of the transformer encoder.
        decoder_layers: Layers of the transformer decoder.
        latent: Dimensions of z.
        dropout: Dropout probability.
        occupied_weight: Weight of the loss of what stands where.
        cost_weight: Weight of the loss of the cost to the goal.
    """

    backbone: BackboneConfig
    ego_backbone: BackboneConfig
    width: int
    heads: int
    feedforward: int
    vae_layers: int
    encoder_layers: int
    decoder_layers: int
    latent: int
    dropout: float
    occupied_weight: float
    cost_weight: float


@dataclass(frozen=True, slots=True)
class Exo2EgoConfig:
    """The diffusion transformer that imagines the ego depth.

    Attributes:
        width: Channels.
        depth: Blocks.
        heads: Attention heads.
        patch: Side of a patch, pixels.
        steps: DDIM steps at run time; divides 1000.
        prior: See the exo depth reprojected into the robot's view, too; only with a policy that sees the map.
        noise: Diffuse; else it is a plain regression, called once on zeros.
    """

    width: int
    depth: int
    heads: int
    patch: int
    steps: int
    prior: bool
    noise: bool


@dataclass(frozen=True, slots=True)
class DepthConfig:
    """The small monocular depth network.

    Attributes:
        backbone: The encoder.
        mean: Mean of the RGB channels, of [0, 1].
        std: Standard deviation of the RGB channels.
    """

    backbone: BackboneConfig
    mean: tuple[float, float, float]
    std: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """One training recipe: AdamW, warm-up, cosine to zero.

    Attributes:
        learning_rate: Peak learning rate.
        weight_decay: Decoupled weight decay.
        batch: Samples in a step.
        warmup_steps: Steps of linear warm-up.
        ema: Decay of the averaged weights that are validated and exported.
        kl_weight: β of the policy's KL term; 0 elsewhere.
    """

    learning_rate: float
    weight_decay: float
    batch: int
    warmup_steps: int
    ema: float
    kl_weight: float


@dataclass(frozen=True, slots=True)
class Preset:
    """Everything that a training run and an export need to know.

    Attributes:
        name: For the manifest.
        observation: Shapes and ranges of the observation.
        policy: Sizes of the policy that sees the picture (paper); None if it sees the map.
        map_policy: Sizes of the policy that sees the map; None if it sees the picture.
        exo2ego: Sizes of the denoiser.
        depth: Sizes of the depth network; None where a third-party network is loaded by config.
        train_policy: Recipe of the policy.
        train_exo2ego: Recipe of the denoiser.
        train_depth: Recipe of the depth network; None as above.
    """

    name: str
    observation: ObservationSpec
    policy: PolicyConfig | None
    map_policy: MapPolicyConfig | None
    exo2ego: Exo2EgoConfig
    depth: DepthConfig | None
    train_policy: TrainConfig
    train_exo2ego: TrainConfig
    train_depth: TrainConfig | None


def load_preset(name_or_path: str) -> Preset:
    """Load a shipped preset by name, or a YAML file by path.

    Raises:
        FileError: There is no such preset, or a key is unknown, missing or of the wrong type.
    """
    shipped = resources.files("revnm_training") / "presets"
    path = Path(name_or_path)
    if path.suffix not in {".yaml", ".yml"}:
        path = Path(str(shipped / f"{name_or_path}.yaml"))
    if not path.is_file():
        raise FileError(f"{name_or_path}: no such preset: expected a YAML file or one of edge, paper")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise FileError(f"{path}: not YAML: {error}") from error
    return preset_from(content, str(path))


def preset_from(content: Any, where: str) -> Preset:
    """Build a preset from parsed YAML or JSON.

    Args:
        content: As parsed.
        where: Where it stands, for errors.

    Raises:
        FileError: A key is unknown, missing or of the wrong type, or two do not fit together.
    """
    preset: Preset = _build(Preset, content, where)
    if (preset.policy is None) == (preset.map_policy is None):
        raise FileError(f"{where}: expected a policy or a map_policy, the other null")
    if preset.exo2ego.prior and preset.map_policy is None:
        raise FileError(f"{where}: exo2ego: prior: needs a map_policy: only a map can be reprojected")
    return preset


def depth_config_from(content: Any, where: str) -> DepthConfig | None:
    """Build the part of a preset that describes its depth network; None where that is null.

    Raises:
        FileError: A key is unknown, missing or of the wrong type.
    """
    config: DepthConfig | None = _build(DepthConfig | None, content, where)
    return config


def _build(kind: Any, value: Any, where: str) -> Any:
    """Build a value of an annotated type from parsed YAML, checking keys and types on the way."""
    if isinstance(kind, types.UnionType):
        if value is None:
            return None
        kind = next(option for option in typing.get_args(kind) if option is not type(None))
    if dataclasses.is_dataclass(kind):
        return _build_dataclass(kind, value, where)
    if typing.get_origin(kind) is tuple:
        return _build_tuple(kind, value, where)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not kind:
        raise FileError(f"{where}: expected {kind.__name__}, got {value!r}")
    return value


def _build_dataclass(kind: Any, value: Any, where: str) -> Any:
    if not isinstance(value, dict):
        raise FileError(f"{where}: expected a mapping, got {value!r}")
    hints = typing.get_type_hints(kind)
    for key in sorted(set(value) ^ set(hints)):
        raise FileError(f"{where}: {key}: {'unknown' if key in value else 'missing'} key")
    return kind(**{key: _build(hint, value[key], f"{where}: {key}") for key, hint in hints.items()})


def _build_tuple(kind: Any, value: Any, where: str) -> Any:
    items = typing.get_args(kind)
    open_ended = len(items) == 2 and items[1] is Ellipsis
    if not isinstance(value, list) or (not open_ended and len(value) != len(items)):
        raise FileError(f"{where}: expected a list of {'any length' if open_ended else len(items)}, got {value!r}")
    kinds = [items[0]] * len(value) if open_ended else items
    return tuple(_build(item, element, where) for item, element in zip(kinds, value, strict=True))
