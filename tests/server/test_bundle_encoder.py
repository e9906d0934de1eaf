"""Bundles whose policy is in two parts, an encoder of pictures and the rest, and those whose parts do not fit."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from revnm_client.errors import FileError
from revnm_server.assembly import build_pipeline
from revnm_server.frame import Frame
from revnm_server.networks.bundle import load_bundle, missing_models
from revnm_server.networks.checked_file import file_sha256
from revnm_server.networks.manifest import MANIFEST
from revnm_server.settings import PerceptionSettings

from .tiny_bundle import EXO_HW, policy_model, write_tiny_bundle

HISTORY = 2


def encoder_model() -> onnx.ModelProto:
    """A row of an image is a token."""
    nodes = [helper.make_node("Squeeze", ["images", "axis"], ["features"])]
    images = helper.make_tensor_value_info("images", TensorProto.FLOAT, ("K", 1, *EXO_HW))
    features = helper.make_tensor_value_info("features", TensorProto.FLOAT, ("K", *EXO_HW))
    axis = helper.make_tensor("axis", TensorProto.INT64, [1], [1])
    graph = helper.make_graph(nodes, "encoder", [images], [features], [axis])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def feature_policy(tokens: int) -> onnx.ModelProto:
    """The tiny policy, which sees features, and looks at none."""
    model = policy_model(HISTORY, steer="goal")
    for value in model.graph.input:
        if value.name in ("exo", "ego"):
            shape = ("R", HISTORY, tokens, EXO_HW[1])
            value.CopyFrom(helper.make_tensor_value_info(value.name, TensorProto.FLOAT, shape))
    return model


def edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    change(manifest)
    (folder / MANIFEST).write_text(json.dumps(manifest))


def write(folder: Path, *, tokens: int = EXO_HW[0]) -> Path:
    write_tiny_bundle(folder, history=HISTORY)
    onnx.save(encoder_model(), folder / "encoder.onnx")
    onnx.save(feature_policy(tokens), folder / "policy.onnx")

    def change(manifest: dict[str, Any]) -> None:
        policy = manifest["models"]["policy"]
        policy["sha256"] = file_sha256(folder / "policy.onnx")
        policy["encoder"] = {"file": "encoder.onnx", "sha256": file_sha256(folder / "encoder.onnx")}

    edit(folder, change)
    return folder


def test_it_loads_and_ticks(tmp_path: Path) -> None:
    bundle = load_bundle(write(tmp_path / "b"))
    assert bundle.encoder is not None
    assert bundle.encoder.outputs == {"features": (None, *EXO_HW)}
    pipeline = build_pipeline(bundle, PerceptionSettings(), {"rover": 0})
    assert pipeline.step(Frame(np.zeros((48, 64, 3), np.uint8), 0, 0), {}).plans == ()


def test_an_encoder_that_is_missing_is_told_and_one_that_was_altered_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "b")
    (folder / "encoder.onnx").write_bytes(b"other")
    with pytest.raises(FileError, match=r"encoder\.onnx: altered"):
        load_bundle(folder)
    (folder / "encoder.onnx").unlink()
    assert missing_models(folder) == ("encoder.onnx",)
    with pytest.raises(FileError, match=r"encoder\.onnx: missing"):
        load_bundle(folder)


def test_features_that_the_policy_does_not_take(tmp_path: Path) -> None:
    with pytest.raises(
        FileError, match=r"policy\.onnx: input exo: shape expected \(any, 2, 12, 16\), got \(any, 2, 7,"
    ):
        load_bundle(write(tmp_path / "b", tokens=7))


def test_an_encoder_whose_features_have_no_size(tmp_path: Path) -> None:
    folder = write(tmp_path / "b")
    model = encoder_model()
    for value, axis in ((model.graph.input[0], 2), (model.graph.output[0], 1)):
        value.type.tensor_type.shape.dim[axis].dim_param = "T"
    onnx.save(model, folder / "encoder.onnx")
    sha256 = file_sha256(folder / "encoder.onnx")
    edit(folder, lambda manifest: manifest["models"]["policy"]["encoder"].update(sha256=sha256))
    with pytest.raises(FileError, match=r"encoder\.onnx: output features: shape expected \(any, tokens, channels\)"):
        load_bundle(folder)


def test_a_policy_that_sees_the_map_has_none(tmp_path: Path) -> None:
    folder = write_tiny_bundle(tmp_path / "b", sees="map")
    encoder = {"file": "encoder.onnx", "sha256": "0" * 64}
    edit(folder, lambda manifest: manifest["models"]["policy"].update(encoder=encoder))
    with pytest.raises(FileError, match="needs a policy that sees the picture"):
        load_bundle(folder)
