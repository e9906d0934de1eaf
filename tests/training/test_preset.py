"""Presets: sizes of the paper, and files that do not fit."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from torch import nn

from revnm_client.errors import FileError
from revnm_training.networks.act import ActPolicy
from revnm_training.networks.dit import Denoiser
from revnm_training.preset import load_preset


def millions(network: nn.Module) -> float:
    return sum(parameter.numel() for parameter in network.parameters()) / 1e6


def test_the_paper_preset_has_the_papers_parameter_counts() -> None:
    preset = load_preset("paper")
    assert millions(ActPolicy(preset.policy, preset.observation)) == pytest.approx(63.6, rel=0.01)
    assert millions(Denoiser(preset.exo2ego, preset.observation)) == pytest.approx(32.8, rel=0.01)


def altered(tmp_path: Path, **changes: object) -> Path:
    source = Path(__file__).parents[2] / "training" / "revnm_training" / "presets" / "edge.yaml"
    content = yaml.safe_load(source.read_text()) | changes
    path = tmp_path / "altered.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"colour": "red"}, r"altered\.yaml: colour: unknown key"),
        ({"name": 3}, r"altered\.yaml: name: expected str, got 3"),
        ({"exo2ego": {"width": 64}}, r"altered\.yaml: exo2ego: depth: missing key"),
        ({"exo2ego": None}, r"altered\.yaml: exo2ego: expected a mapping"),
        ({"map_policy": None}, r"altered\.yaml: expected a policy or a map_policy"),
    ],
)
def test_a_preset_that_does_not_fit_names_file_and_key(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(FileError, match=message):
        load_preset(str(altered(tmp_path, **changes)))


def test_an_unknown_preset_is_named() -> None:
    with pytest.raises(FileError, match="huge: no such preset"):
        load_preset("huge")
