"""PyTorch eager as a runtime to compare with: the networks that a bundle's manifest tells, robot after robot."""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from revnm_client.errors import FileError
from revnm_server.networks.bundle import default_bundle_path, load_bundle
from revnm_server.networks.manifest import MANIFEST
from revnm_server.speed.baseline import GROUP, run_networks
from revnm_training.eager import eager_networks


def test_the_training_package_declares_it() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "training" / "pyproject.toml").read_text())["project"]
    ((name, value),) = project["entry-points"][GROUP].items()
    assert EntryPoint(name, value, GROUP).load() is eager_networks
    assert name == "torch_eager"


def test_the_shipped_bundles_networks_run() -> None:
    bundle = load_bundle(default_bundle_path(), threads=1)
    networks = eager_networks(bundle)
    assert "eager" in networks.note
    taken = run_networks(networks, bundle, robots=2, rounds=2, longest_s=60.0)
    assert len(taken) == 2
    assert min(min(each.values()) for each in taken) > 0.0


def test_a_bundle_that_does_not_tell_how_it_is_built_is_refused() -> None:
    bundle = load_bundle(default_bundle_path(), threads=1)
    bundle.manifest["recipe"].pop("preset")
    with pytest.raises(FileError, match=r"manifest\.json: recipe\.preset: expected a mapping, got None"):
        eager_networks(bundle)
    bundle.manifest["recipe"]["preset"] = json.loads((default_bundle_path() / MANIFEST).read_text())["recipe"]["preset"]
    bundle.manifest["recipe"]["preset"]["depth"] = None
    with pytest.raises(FileError, match=r"recipe\.preset\.depth: null"):
        eager_networks(bundle)
