"""Checkpoints to a model bundle: ONNX files, checked against PyTorch, and their manifest.

The averaged weights are exported. A bundle appears whole or not at all. A policy that sees pictures is exported in two
parts where its encoder sees each picture alone, so that the server encodes a picture once and not in every history.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from torch import Tensor, nn

from revnm_client.errors import ConfigError, ContractError, FileError
from revnm_server.mapping.ego_prior import PRIOR_CHANNELS
from revnm_server.mapping.map_window import LAYERS, WAY_POINTS, WindowSpec
from revnm_server.networks.bundle import default_bundle_path, load_bundle
from revnm_server.networks.inference import OnnxModel
from revnm_server.networks.manifest import MANIFEST
from revnm_training.bundle_manifest import bundle_manifest
from revnm_training.checkpoint import Checkpoint, fill, load_trained
from revnm_training.kept_part import KeptPart, kept_part
from revnm_training.networks.act import ActPolicy
from revnm_training.networks.depth_net import DepthNet
from revnm_training.networks.dit import Denoiser
from revnm_training.networks.map_policy import MapPolicy
from revnm_training.preset import Preset
from revnm_training.train_policy import policy_network

TOLERANCE = 1e-3
ENCODER = "encoder"
_KINDS = ("policy", "exo2ego", "depth")
_RANDOM_STD = 0.02
_MAX_ROBOTS = 64
_CHECKED_BATCHES = (1, 3, 16)


class PolicyGraph(nn.Module):
    """The policy as it is deployed: z at the prior's mean, waypoints only."""

    def __init__(self, policy: ActPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, exo: Tensor, ego: Tensor, robot: Tensor, heading: Tensor, goal: Tensor) -> Tensor:
        """Return waypoints (R, H, 2), metres."""
        waypoints: Tensor = self.policy(exo, ego, robot, heading, goal).waypoints
        return waypoints


class EncoderGraph(nn.Module):
    """The first part of a policy that is exported in two: images → features."""

    def __init__(self, policy: ActPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, images: Tensor) -> Tensor:
        """Return the features (K, tokens, d) of images (K, 1, e, e) of either view, ego depth enlarged to e."""
        return self.policy.exo.features(images)


class FeaturePolicyGraph(nn.Module):
    """The second part: features of the histories → waypoints."""

    def __init__(self, policy: ActPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, exo: Tensor, ego: Tensor, robot: Tensor, heading: Tensor, goal: Tensor) -> Tensor:
        """Return waypoints (R, H, 2), metres, from features (R, N, tokens, d) of both views."""
        return self.policy.decide(exo, ego, robot, heading, goal)


class MapPolicyGraph(nn.Module):
    """The policy over the map as it is deployed: what stands around; the other heads only teach it."""

    def __init__(self, policy: MapPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, map: Tensor, way: Tensor, goal: Tensor, ego: Tensor) -> Tensor:  # noqa: A002
        """Return probabilities (R, side, side)."""
        occupied: Tensor = self.policy(map, way, goal, ego).occupied.sigmoid()
        return occupied


@dataclass(frozen=True, slots=True)
class Graph:
    """A network with the names and shapes of its ONNX contract.

    Attributes:
        network: In evaluation mode.
        inputs: Shape of each input by name, without the batch axis; an empty shape is an integer per robot.
        outputs: Names of the outputs.
        batched: Whether the first axis is the number of robots; else it is 1.
    """

    network: nn.Module
    inputs: dict[str, tuple[int, ...]]
    outputs: tuple[str, ...]
    batched: bool


def graphs(preset: Preset) -> dict[str, Graph]:
    """Return the graphs of a preset's networks, with random weights, by kind; ``encoder`` is a part of the policy."""
    spec = preset.observation
    exo2ego = Denoiser(preset.exo2ego, spec)
    found = {**_policy_graphs(preset), "exo2ego": Graph(exo2ego, _exo2ego_inputs(preset), ("clean",), True)}
    if preset.depth is not None:
        found["depth"] = Graph(DepthNet(preset.depth), {"image": (3, *spec.disparity_hw)}, ("disparity",), False)
    return found


def _policy_graphs(preset: Preset) -> dict[str, Graph]:
    network, spec = policy_network(preset), preset.observation
    if isinstance(network, MapPolicy):
        side = WindowSpec().side
        seen = {
            "map": (len(LAYERS), side, side),
            "way": (WAY_POINTS, 2),
            "goal": (2,),
            "ego": (1, spec.ego_px, spec.ego_px),
        }
        return {"policy": Graph(MapPolicyGraph(network), seen, ("occupied",), True)}
    assert isinstance(network, ActPolicy)
    poses = {"robot": (2,), "heading": (2,), "goal": (2,)}
    if network.encodes_alone:
        encoder = Graph(EncoderGraph(network), {"images": (1, *spec.exo_hw)}, ("features",), True)
        features = (spec.history, *network.exo.get_buffer("grid").shape)
        rest = Graph(FeaturePolicyGraph(network), {"exo": features, "ego": features, **poses}, ("waypoints",), True)
        return {ENCODER: encoder, "policy": rest}
    exo, ego = (spec.history, 1, *spec.exo_hw), (spec.history, 1, spec.ego_px, spec.ego_px)
    return {"policy": Graph(PolicyGraph(network), {"exo": exo, "ego": ego, **poses}, ("waypoints",), True)}


def _exo2ego_inputs(preset: Preset) -> dict[str, tuple[int, ...]]:
    spec = preset.observation
    noisy, crop = (1, spec.ego_px, spec.ego_px), (spec.history, spec.crop_px, spec.crop_px)
    seen: dict[str, tuple[int, ...]] = {"noisy": noisy, "crop": crop, "step": (), "robot": (2,), "heading": (2,)}
    if preset.exo2ego.prior:
        seen["prior"] = (PRIOR_CHANNELS, spec.ego_px, spec.ego_px)
    return seen


def export_onnx(graph: Graph, path: Path) -> float:
    """Write a network as ONNX and compare both on random inputs.

    Returns:
        The largest absolute difference.

    Raises:
        ContractError: It exceeds 1e-3.
    """
    network = graph.network.eval()
    dynamic = {0: torch.export.Dim("robots", min=1, max=_MAX_ROBOTS)} if graph.batched else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the exporter's own deprecations
        program = torch.onnx.export(
            network,
            _random_inputs(graph, 2 if graph.batched else 1, seed=0),
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_shapes=[dynamic] * len(graph.inputs),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    onnx.save(_without_traces(program.model_proto), path)
    difference = _difference(graph, path)
    if difference > TOLERANCE:
        raise ContractError(f"{path}: ONNX differs from PyTorch by {difference:.2g}, more than {TOLERANCE}")
    return difference


def _without_traces(model: onnx.ModelProto) -> onnx.ModelProto:
    """Remove what the exporter notes about the code it came from: paths of the machine that trained."""
    for part in (model, model.graph, *model.graph.node, *model.graph.value_info, *model.functions):
        part.ClearField("metadata_props")
    for function in model.functions:
        for node in function.node:
            node.ClearField("metadata_props")
    return model


def _random_inputs(graph: Graph, batch: int, *, seed: int) -> tuple[Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)

    def draw(shape: tuple[int, ...]) -> Tensor:
        if not shape:
            return torch.randint(1000, (batch,), generator=generator)
        return torch.rand((batch, *shape), generator=generator)

    return tuple(draw(shape) for shape in graph.inputs.values())


def _difference(graph: Graph, path: Path) -> float:
    model, worst = OnnxModel(path), 0.0
    for batch in _CHECKED_BATCHES if graph.batched else (1,):
        inputs = _random_inputs(graph, batch, seed=batch)
        with torch.inference_mode():
            answer = graph.network(*inputs)
        expected = answer if isinstance(answer, tuple) else (answer,)
        arrays = {name: tensor.numpy() for name, tensor in zip(graph.inputs, inputs, strict=True)}
        got = model.run(**arrays)
        for name, value in zip(graph.outputs, expected, strict=True):
            worst = max(worst, float(np.abs(got[name] - value.numpy()).max()))
    return worst


def export_bundle(
    preset: Preset,
    checkpoints: Mapping[str, Path],
    out: Path,
    *,
    base: Path | None = None,
    random_weights: bool = False,
    reports: Sequence[Path] = (),
) -> dict[str, float]:
    """Write a bundle and load it as the server does.

    Args:
        preset: What the checkpoints were trained with.
        checkpoints: File by kind: ``policy``, ``exo2ego``, ``depth``.
        out: The bundle's folder; an earlier bundle there is replaced.
        base: A bundle that gives the networks that have no checkpoint here, as they are. A preset without a depth
            network takes the size of that one's disparity, too.
        random_weights: The preset's networks that have neither get random weights: good for measuring speed.
        reports: ``report.json`` files of benchmarks of this bundle, for the manifest.

    Returns:
        The largest difference between ONNX and PyTorch by kind.

    Raises:
        ConfigError: A network has neither checkpoint nor base, or one that the preset has no use for.
        FileError: A checkpoint, the base or a report does not fit.
        ContractError: ONNX and PyTorch differ.
    """
    parts = graphs(preset)
    missing, base = _missing(preset, set(checkpoints), base, random_weights=random_weights)
    loaded = {kind: _load_weights(parts[kind], path, kind, preset) for kind, path in checkpoints.items()}
    kept = {kind: kept_part(base, kind, preset) for kind in missing if base is not None}
    if "depth" not in parts:
        preset = _with_depth_of(preset, kept["depth"])
    drawn = [kind for kind in _KINDS if kind not in loaded and kind not in kept]
    loaded |= {kind: _random_weights(parts[kind], kind, preset) for kind in drawn}
    benchmark = [row for report in reports for row in _read_rows(report)]
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent) as scratch:
        folder = Path(scratch) / "bundle"
        folder.mkdir()
        written = [kind for kind in parts if kind in loaded or (kind == ENCODER and "policy" in loaded)]
        differences = {kind: export_onnx(parts[kind], folder / f"{kind}.onnx") for kind in written}
        for kind, part in kept.items():
            shutil.copyfile(part.path, folder / f"{kind}.onnx")
            if part.encoder is not None:
                shutil.copyfile(part.encoder, folder / f"{ENCODER}.onnx")
        manifest = bundle_manifest(preset, loaded, kept, folder, benchmark)
        (folder / MANIFEST).write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
        load_bundle(folder)
        if out.exists():
            shutil.rmtree(out)
        folder.rename(out)
    return differences


def _missing(
    preset: Preset, given: set[str], base: Path | None, *, random_weights: bool
) -> tuple[list[str], Path | None]:
    """Return the kinds of networks that the base must give, and the base.

    Raises:
        ConfigError: A network has neither checkpoint nor base, or one that the preset has no use for.
    """
    kinds = [kind for kind in _KINDS if kind != "depth" or preset.depth is not None]
    missing = [kind for kind in _KINDS if kind not in given]
    has = f"preset {preset.name!r} has the networks {', '.join(kinds)}"
    if needless := sorted(given - set(kinds)):
        raise ConfigError(f"{has}: none for {', '.join(needless)}")
    if random_weights:  # in the place of all but the depth network that the preset does not have
        missing, base = [kind for kind in missing if kind not in kinds], base or default_bundle_path()
    if missing and base is None:
        raise ConfigError(f"{has}: no checkpoint or base for {', '.join(sorted(missing))}")
    return missing, base


def _with_depth_of(preset: Preset, kept: KeptPart) -> Preset:
    """Return the preset with a depth network that it did not have: what it sees has that one's size."""
    observation = replace(preset.observation, disparity_hw=kept.disparity_hw)
    return replace(preset, depth=kept.depth, observation=observation)


def _random_weights(graph: Graph, kind: str, preset: Preset) -> Checkpoint:
    """Draw the layers that training begins at zero, too: with zeros in them networks would not see their input."""
    network = _inner(graph)
    for parameter in network.parameters():
        if not parameter.any():
            nn.init.normal_(parameter, std=_RANDOM_STD)
    record = {"weights": "random", "validation": {}}
    return Checkpoint(kind, preset.name, 0, 0, torch.initial_seed(), {}, network.state_dict(), {}, record)


def _inner(graph: Graph) -> nn.Module:
    """Return the network that training knows."""
    network = graph.network
    return network.policy if isinstance(network, PolicyGraph | FeaturePolicyGraph | MapPolicyGraph) else network


def _load_weights(graph: Graph, path: Path, kind: str, preset: Preset) -> Checkpoint:
    checkpoint = load_trained(path, kind, preset.name)
    fill(_inner(graph), checkpoint, path)
    return checkpoint


def _read_rows(report: Path) -> list[dict[str, Any]]:
    try:
        rows = json.loads(report.read_text(encoding="utf-8"))["rows"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(f"{report}: no benchmark report with rows: {error}") from error
    return list(rows)
