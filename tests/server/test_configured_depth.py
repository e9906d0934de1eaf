"""Depth networks of others load by the settings, or are refused with the setting to change."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import helper

from revnm_client.errors import ConfigError, FileError
from revnm_server.assembly import load_models
from revnm_server.frame import Frame
from revnm_server.networks.bundle import default_bundle_path
from revnm_server.networks.checked_file import file_sha256
from revnm_server.networks.configured_depth import load_depth_network, weights_beside
from revnm_server.networks.depth_checks import floor_picture
from revnm_server.observation import Image32
from revnm_server.settings import DepthSettings, load_settings
from revnm_server.stages.depth import OnnxDepth

from .foreign_depth import settings_for, write_depth
from .tiny_bundle import DISPARITY_HW

RAW = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "foreign.onnx"


def looked(settings: DepthSettings) -> Image32:
    """Load a network and return its disparity of the floor picture, in which the floor is nearer than the wall."""
    disparity = load_depth_network(settings, threads=1).disparity(floor_picture())
    height = disparity.shape[0]
    assert np.median(disparity[round(0.85 * height) :]) > 1.5 * np.median(disparity[: height // 4])
    return disparity


def test_like_depth_anything_v2_any_size(path: Path) -> None:
    write_depth(path, shape=("b", 3, "h", "w"), names=("pixel_values", "predicted_depth"))
    settings = settings_for(path, "disparity", input={**RAW, "size": 140, "mode": "shortest", "multiple_of": 14})
    assert looked(settings).shape == (140, 182)  # 640 · 140 / 480 = 186.7 = 13.3 · 14


def test_like_depth_anything_v2_of_one_size(path: Path) -> None:
    write_depth(path, shape=(1, 3, 518, 518))
    assert looked(settings_for(path, "disparity")).shape == (518, 518)


def test_like_depth_anything_3_with_views_and_more_outputs(path: Path) -> None:
    write_depth(
        path,
        says="depth",
        shape=("b", "n", 3, "h", "w"),
        names=("pixel_values", "predicted_depth"),
        extras=("confidence", "extrinsics"),
    )
    settings = settings_for(path, "depth", input={**RAW, "size": 168, "mode": "longest", "multiple_of": 14})
    assert looked(settings).shape == (126, 168)


def test_like_depth_anything_3_metric_with_its_sky(path: Path) -> None:
    """Its sky is where depth is over 2.3: the wall, and no floor."""
    last = (
        helper.make_node("Greater", ["plain", "bound"], ["beyond"]),
        helper.make_node("Cast", ["beyond"], ["sky"], to=onnx.TensorProto.FLOAT),
        helper.make_node("Identity", ["plain"], ["said"]),
    )
    write_depth(path, says="depth", shape=(1, 3, 252, 252), last=last, bound=np.float32(2.3))
    model = onnx.load(path)
    model.graph.output.append(helper.make_tensor_value_info("sky", onnx.TensorProto.FLOAT, (1, 252, 252)))
    onnx.save(model, path)
    network = load_depth_network(settings_for(path, "metric_canonical", outputs={"sky": "sky"}))
    disparity = network.disparity(floor_picture())
    assert np.median(disparity[:75]) == 0.0
    assert disparity[150:].min() > 0.3  # depth is 3 − 2 · 0.6 + 0.2 at most


def test_like_metric3d_a_letterbox_of_bytes(path: Path) -> None:
    write_depth(path, says="depth", shape=(1, 3, 308, 532), dtype="uint8")
    settings = settings_for(path, "metric_canonical", input={"range": "byte", "mode": "letterbox"})
    assert looked(settings).shape == (308, 411)  # 640 · 308 / 480 = 410.7


def test_half_precision_and_zeros_for_sky(path: Path) -> None:
    """Where it is over 2.3, it gives no depth at all."""
    last = (
        helper.make_node("Less", ["plain", "bound"], ["near"]),
        helper.make_node("Where", ["near", "plain", "none"], ["said"]),
    )
    numbers = {"bound": np.float32(2.3)}
    write_depth(path, says="depth", shape=(1, 3, 140, 252), dtype="float16", last=last, **numbers)
    network = load_depth_network(settings_for(path, "depth"))
    disparity = network.disparity(floor_picture())
    assert disparity.dtype == np.float32
    assert np.median(disparity[:40]) == 0.0
    assert disparity[84:].min() > 0.3


def test_the_shipped_network_passes_and_says_what_it_says_in_its_bundle() -> None:
    model = default_bundle_path() / "depth.onnx"
    settings = DepthSettings(model=model, sha256=file_sha256(model), kind="disparity")
    load_depth_network(settings, threads=1)
    with pytest.raises(
        FileError, match=r"depth\.onnx: output disparity: taken for depth, .* set depth\.kind: disparity"
    ):
        load_depth_network(settings.model_copy(update={"kind": "depth"}), threads=1)


@pytest.mark.parametrize(
    ("says", "kind", "advice"),
    [
        ("depth", "disparity", r"set depth\.kind: depth \(or metric_canonical\)"),
        ("disparity", "depth", r"set depth\.kind: disparity"),
        ("disparity", "metric_canonical", r"set depth\.kind: disparity"),
    ],
)
def test_the_opposite_of_its_kind_is_refused(path: Path, says: Any, kind: str, advice: str) -> None:
    write_depth(path, says=says, shape=(1, 3, 120, 160))
    with pytest.raises(FileError, match=rf"foreign\.onnx: .*taken for {kind}.*{advice}"):
        load_depth_network(settings_for(path, kind))


def test_a_sign_that_cannot_be_told_is_a_warning(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """It sees the picture's columns: nothing that a floor could tell."""
    ramp = np.linspace(0.0, 100.0, 160, dtype=np.float32)
    write_depth(path, shape=(1, 3, 120, 160), last=(helper.make_node("Add", ["plain", "ramp"], ["said"]),), ramp=ramp)
    with caplog.at_level(logging.WARNING):
        load_depth_network(settings_for(path, "disparity"))
    assert "does not tell whether it is disparity" in caplog.text


@pytest.mark.parametrize(
    ("last", "kind", "complaint"),
    [
        (("Mul", 0.0), "disparity", "the same everywhere"),
        (("Mul", 0.0), "depth", r"no depth anywhere.*\(trial run\)"),
        (("Mul", np.nan), "disparity", "not finite"),
        (("Mul", np.nan), "depth", r"no depth anywhere.*\(trial run\)"),
    ],
)
def test_an_export_that_says_nothing_is_refused(path: Path, last: Any, kind: str, complaint: str) -> None:
    node = helper.make_node(last[0], ["plain", "factor"], ["said"])
    write_depth(path, shape=(1, 3, 120, 160), last=(node,), factor=np.float32(last[1]))
    with pytest.raises(FileError, match=rf"foreign\.onnx: .*{complaint}"):
        load_depth_network(settings_for(path, kind))


def test_an_output_of_its_own_shape_is_refused_where_the_input_has_another(path: Path) -> None:
    """Exports for any size whose last resize was baked in."""
    last = (
        helper.make_node("Unsqueeze", ["plain", "axis"], ["four"]),
        helper.make_node("Resize", ["four", "", "", "sizes"], ["four_resized"], mode="linear"),
        helper.make_node("Squeeze", ["four_resized", "axis"], ["said"]),
    )
    write_depth(path, last=last, axis=np.array([1]), sizes=np.array([1, 1, 140, 140]))
    free = settings_for(path, "disparity", input={**RAW, "size": 140, "mode": "longest", "multiple_of": 14})
    with pytest.raises(FileError, match=r"140 × 140 for a picture of 112 × 140 .* set depth\.input\.mode: fixed"):
        load_depth_network(free)
    load_depth_network(settings_for(path, "disparity", input={**RAW, "size": 140}))


@pytest.mark.parametrize(
    ("shape", "given", "complaint"),
    [
        ((1, 3, 518, 518), {"size": 504}, r"depth\.input\.size: .* takes \(518, 518\) only, got \(504, 504\)"),
        (
            (1, 3, 518, 518),
            {"size": 518, "mode": "longest"},
            r"depth\.input\.mode: longest needs a network of any size",
        ),
        ((1, 3, 100, 140), {"multiple_of": 14}, r"depth\.input\.multiple_of: .* takes \(100, 140\), .* multiple of 14"),
        ((1, 3, "h", "w"), {}, r"depth\.input\.size: .* takes any size; expected the one to use"),
        (
            (1, 3, "h", "w"),
            {"size": 64, "name": "picture"},
            r"depth\.input\.name: the model has no picture; it has image",
        ),
        ((1, 1, 1, 3, 8, 8), {}, r"input image: expected one RGB picture"),
        ((2, 3, 64, 64), {}, r"input image: expected one RGB picture, .* got \(2, 3, 64, 64\)"),
    ],
)
def test_what_does_not_fit_the_model_names_the_setting(
    path: Path, shape: Any, given: dict[str, Any], complaint: str
) -> None:
    write_depth(path, shape=shape)
    with pytest.raises((ConfigError, FileError), match=complaint):
        load_depth_network(settings_for(path, "disparity", input={**RAW, **given}))


def test_bytes_are_not_normalised(path: Path) -> None:
    write_depth(path, shape=(1, 3, 64, 64), dtype="uint8")
    with pytest.raises(ConfigError, match="set range: byte, and neither mean nor std"):
        load_depth_network(settings_for(path, "disparity", input={}))


def test_an_output_that_cannot_be_guessed_is_asked_for(path: Path) -> None:
    write_depth(path, shape=(1, 3, 64, 64), names=("image", "points"), extras=("mask",))
    with pytest.raises(ConfigError, match=r"depth\.outputs\.depth: cannot be told .* set one of points, mask"):
        load_depth_network(settings_for(path, "disparity"))
    load_depth_network(settings_for(path, "disparity", outputs={"depth": "points"}))
    with pytest.raises(ConfigError, match=r"depth\.outputs\.sky: the model has no sky"):
        load_depth_network(settings_for(path, "disparity", outputs={"depth": "points", "sky": "sky"}))


def test_a_network_that_asks_for_more_than_a_picture_is_refused(path: Path) -> None:
    write_depth(path, shape=(1, 3, 64, 64))
    model = onnx.load(path)
    model.graph.input.append(helper.make_tensor_value_info("num_tokens", onnx.TensorProto.INT64, (1,)))
    onnx.save(model, path)
    with pytest.raises(FileError, match="needs more inputs than the picture: num_tokens"):
        load_depth_network(settings_for(path, "disparity", input={**RAW, "name": "image"}))


def test_weights_beside_the_model_are_hashed_too(path: Path) -> None:
    bias = helper.make_node("Add", ["plain", "bias"], ["said"])
    write_depth(path, shape=(1, 3, 64, 64), last=(bias,), bias=np.zeros((64, 64), dtype=np.float32))
    assert weights_beside(path) == set()
    onnx.save_model(onnx.load(path), path, save_as_external_data=True, location="model.onnx_data", size_threshold=1024)
    assert weights_beside(path) == {"model.onnx_data"}
    with pytest.raises(FileError, match=r"reads weights from model\.onnx_data, too; .* under depth\.data"):
        load_depth_network(settings_for(path, "disparity"))
    data = path.with_name("model.onnx_data")
    settings = settings_for(path, "disparity", data={data.name: file_sha256(data)})
    load_depth_network(settings)
    data.write_bytes(data.read_bytes()[:-1] + b"\1")
    with pytest.raises(FileError, match=r"model\.onnx_data: altered"):
        load_depth_network(settings)


def test_an_altered_model_and_sums_of_nothing_are_refused(path: Path) -> None:
    write_depth(path, shape=(1, 3, 64, 64))
    settings = settings_for(path, "disparity")
    with pytest.raises(ConfigError, match=r"depth\.data: .* reads nothing from other"):
        load_depth_network(settings.model_copy(update={"data": {"other": "0" * 64}}))
    path.write_bytes(b"")
    with pytest.raises(FileError, match=r"foreign\.onnx: altered"):
        load_depth_network(settings)
    with pytest.raises(FileError, match=r"foreign\.onnx: no model"):
        load_depth_network(settings_for(path, "disparity"))


@pytest.mark.parametrize("planner", ["revnm", "bev"])
def test_it_takes_the_place_of_the_bundles_network(path: Path, tiny_bundle: Path, planner: str) -> None:
    """The tiny bundle's disparity is brightness, a third of blue; this one has all of blue."""
    write_depth(path, shape=(1, 3, 48, 64))
    settings = load_settings(overrides={"perception": {"bundle": tiny_bundle, "planner": planner}})
    bundle = load_models(settings.perception, settings_for(path, "disparity"))
    image = np.zeros((480, 640, 3), dtype=np.uint8)
    image[:, 320:] = (0, 0, 255)
    disparity = OnnxDepth(bundle).disparity(Frame(image, 0, 0))
    assert disparity.shape == DISPARITY_HW
    np.testing.assert_allclose(disparity[:, -3] - disparity[:, 2], 1.0, atol=1e-6)


SUM = "0" * 64


@pytest.mark.parametrize(
    ("depth", "complaint"),
    [
        ({"kind": "depth"}, "model: expected the path of the network"),
        ({"model": "x.onnx", "kind": "depth"}, "sha256: expected the sum"),
        ({"model": "x.onnx", "sha256": SUM}, "kind: expected disparity, depth or metric_canonical"),
        ({"model": "x.onnx", "sha256": "abc", "kind": "depth"}, r"depth\.sha256"),
        ({"model": "x.onnx", "sha256": SUM, "kind": "points"}, r"depth\.kind"),
        ({"model": "x.onnx", "sha256": SUM, "kind": "depth", "data": {"../x": SUM}}, r"depth\.data"),
        ({"model": "x.onnx", "sha256": SUM, "kind": "depth", "input": {"mode": "longest"}}, "that of the longest side"),
        (
            {"model": "x.onnx", "sha256": SUM, "kind": "depth", "input": {"size": 500, "multiple_of": 14}},
            "multiples of 14",
        ),
        ({"model": "x.onnx", "sha256": SUM, "kind": "depth", "input": {"std": [0, 1, 1]}}, r"depth\.input\.std"),
        ({"model": "x.onnx", "sha256": SUM, "kind": "depth", "input": {"color": "bgr"}}, r"depth\.input\.color"),
    ],
)
def test_wrong_settings_are_told(depth: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        load_settings(overrides={"depth": depth})
