"""Export: a bundle that the server loads, equal to PyTorch; nothing half-written."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest
import torch

from revnm_client.errors import ConfigError, FileError
from revnm_server.networks.bundle import load_bundle
from revnm_training.checkpoint import Checkpoint, fill, load_checkpoint, load_trained, save_checkpoint, save_weights
from revnm_training.export import MapPolicyGraph, PolicyGraph, export_bundle, graphs
from revnm_training.kept_part import kept_part
from revnm_training.preset import Preset, load_preset
from revnm_training.train_policy import policy_network

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=["edge", "picture"])
def preset(request: pytest.FixtureRequest) -> Preset:
    torch.manual_seed(0)
    return load_preset(request.param)


@pytest.fixture(scope="module")
def checkpoints(preset: Preset, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("checkpoints")
    paths = {}
    for kind, graph in graphs(preset).items():
        wrapped = isinstance(graph.network, PolicyGraph | MapPolicyGraph)
        network = graph.network.policy if wrapped else graph.network
        for parameter in network.parameters():
            torch.nn.init.normal_(parameter, std=0.05)  # zero-initialised layers would hide differences
        record = {"seconds": 1.0, "samples": 2, "validation": {"loss": 0.5}}
        checkpoint = Checkpoint(kind, preset.name, 1, 2, 0, {}, network.state_dict(), {}, record)
        paths[kind] = folder / f"{kind}.pt"
        save_checkpoint(paths[kind], checkpoint)
    return paths


def test_onnx_equals_torch_and_the_server_loads_the_bundle(
    preset: Preset, checkpoints: dict[str, Path], tmp_path: Path
) -> None:
    report = tmp_path / "report.json"
    report.write_text(json.dumps({"rows": [{"world": "random_pillar", "success_rate": 0.5}]}))
    differences = export_bundle(preset, checkpoints, tmp_path / "bundle", reports=[report])
    assert set(differences) == {"policy", "exo2ego", "depth"}
    assert max(differences.values()) < 1e-3
    bundle = load_bundle(tmp_path / "bundle")
    assert bundle.spec == preset.observation
    assert bundle.sees == ("map" if preset.map_policy else "picture")
    assert bundle.exo2ego.prior == preset.exo2ego.prior
    for model in (tmp_path / "bundle").glob("*.onnx"):
        assert str(Path(__file__).parents[2]).encode() not in model.read_bytes()
    assert bundle.manifest["results"]["benchmark"][0]["success_rate"] == 0.5
    assert bundle.manifest["results"]["validation"]["policy"] == {"loss": 0.5}
    run = bundle.manifest["recipe"]["runs"]["policy"]
    assert (run["steps"], run["planned_steps"]) == (1, 2)  # it was stopped half way


def test_a_checkpoint_that_does_not_fit_leaves_the_old_bundle(
    preset: Preset, checkpoints: dict[str, Path], tmp_path: Path
) -> None:
    old = tmp_path / "bundle" / "kept"
    old.parent.mkdir()
    old.touch()
    wrong = checkpoints | {"policy": checkpoints["depth"]}
    with pytest.raises(FileError, match="of kind 'depth', expected 'policy'"):
        export_bundle(preset, wrong, tmp_path / "bundle")
    assert old.exists()


def test_a_missing_kind_is_named(preset: Preset, checkpoints: dict[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no checkpoint or base for depth, exo2ego"):
        export_bundle(preset, {"policy": checkpoints["policy"]}, tmp_path / "bundle")


def test_a_base_gives_what_has_no_checkpoint(preset: Preset, checkpoints: dict[str, Path], tmp_path: Path) -> None:
    export_bundle(preset, checkpoints, tmp_path / "base")
    with_exo2ego = {"exo2ego": checkpoints["exo2ego"]}
    assert set(export_bundle(preset, with_exo2ego, tmp_path / "bundle", base=tmp_path / "base")) == {"exo2ego"}
    base, bundle = (load_bundle(tmp_path / name).manifest for name in ("base", "bundle"))
    assert bundle == base

    smaller = replace(preset, observation=replace(preset.observation, ego_range_m=5.0))
    assert kept_part(tmp_path / "base", "depth", smaller).path == tmp_path / "base" / "depth.onnx"
    with pytest.raises(FileError, match=r"observation\.ego_range_m is 6\.0, but preset .* has 5\.0: its exo2ego"):
        export_bundle(smaller, {"policy": checkpoints["policy"]}, tmp_path / "none", base=tmp_path / "base")
    assert not (tmp_path / "none").exists()


def test_small_weights_make_the_same_bundle(preset: Preset, checkpoints: dict[str, Path], tmp_path: Path) -> None:
    save_weights(checkpoints, tmp_path / "weights")
    small = {kind: tmp_path / "weights" / f"{kind}.pt" for kind in checkpoints}
    assert sum(p.stat().st_size for p in small.values()) < 0.55 * sum(p.stat().st_size for p in checkpoints.values())
    networks = []
    for paths in (checkpoints, small):
        network = policy_network(preset)
        fill(network, load_checkpoint(paths["policy"], "policy"), paths["policy"])
        networks.append(network.state_dict())
    for name, value in networks[0].items():
        torch.testing.assert_close(networks[1][name], value, rtol=1e-3, atol=1e-4)


def test_the_kept_weights_are_of_the_preset() -> None:
    weights = resources.files("revnm_training") / "weights" / "edge"
    preset = load_preset("edge")
    for kind, graph in graphs(preset).items():
        if kind == "depth":
            continue
        path = Path(str(weights / f"{kind}.pt"))
        network = graph.network.policy if isinstance(graph.network, MapPolicyGraph) else graph.network
        fill(network, load_trained(path, kind, preset.name), path)
        assert sum(float(parameter.detach().abs().sum()) for parameter in network.parameters()) > 100.0
