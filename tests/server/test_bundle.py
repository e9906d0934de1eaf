from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from revnm_client.errors import FileError
from revnm_server.networks.bundle import load_bundle, load_depth_bundle, missing_models
from revnm_server.networks.checked_file import file_sha256

from .tiny_bundle import DISPARITY_HW, EGO_PX, depth_model, policy_model, write_tiny_bundle


def _edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    change(manifest)
    path.write_text(json.dumps(manifest))


def _replace_model(folder: Path, name: str, model: onnx.ModelProto) -> None:
    """Replace a model and keep the manifest's sha256 right."""
    path = folder / f"{name}.onnx"
    onnx.save(model, path)

    def change(manifest: dict[str, Any]) -> None:
        manifest["models"][name]["sha256"] = file_sha256(path)

    _edit(folder, change)


def test_a_complete_bundle_loads(tiny_bundle: Path) -> None:
    bundle = load_bundle(tiny_bundle)
    assert bundle.name == "tiny"
    assert bundle.spec.disparity_hw == DISPARITY_HW
    assert bundle.exo2ego.steps == 2
    assert bundle.depth.takes.std == (1.0, 1.0, 1.0)
    assert set(bundle.policy.inputs) == {"exo", "ego", "robot", "heading", "goal"}
    assert bundle.manifest["models"]["depth"]["kind"] == "disparity"


def test_a_bundle_may_have_a_policy_that_sees_the_map(tmp_path: Path) -> None:
    bundle = load_bundle(write_tiny_bundle(tmp_path / "m", sees="map"))
    assert bundle.sees == "map"
    assert bundle.exo2ego.prior
    assert set(bundle.policy.inputs) == {"map", "way", "goal", "ego"}


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda m: m["models"]["policy"].update(sees="sound"), r"models\.policy\.sees"),
        (lambda m: m["observation"].update(history=5), "a policy that sees the map has a history of 1"),
        (lambda m: m["models"]["policy"].update(sees="picture"), "needs a policy that sees the map"),
    ],
)
def test_what_the_policy_sees_must_fit_the_rest(
    tmp_path: Path, change: Callable[[dict[str, Any]], None], complaint: str
) -> None:
    folder = write_tiny_bundle(tmp_path / "m", sees="map")
    _edit(folder, change)
    with pytest.raises(FileError, match=complaint):
        load_bundle(folder)


def test_sha256_of_a_known_text(tmp_path: Path) -> None:
    # FIPS 180-2, appendix B.1
    path = tmp_path / "abc"
    path.write_bytes(b"abc")
    assert file_sha256(path) == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


@pytest.mark.parametrize("file", ["manifest.json", "policy.onnx", "exo2ego.onnx", "depth.onnx"])
def test_a_missing_file_is_named(tiny_bundle: Path, file: str) -> None:
    (tiny_bundle / file).unlink()
    with pytest.raises(FileError, match=rf"{file}: missing"):
        load_bundle(tiny_bundle)


@pytest.mark.parametrize("file", ["manifest.json", "depth.onnx"])
def test_a_file_that_cannot_be_read_is_named(tiny_bundle: Path, file: str) -> None:
    (tiny_bundle / file).unlink()
    (tiny_bundle / file).symlink_to("/proc/self/mem")  # can be opened by anybody; reading its start fails
    with pytest.raises(FileError, match=rf"{file}: cannot be read: Input/output error"):
        load_bundle(tiny_bundle)


def test_an_altered_file_is_named_with_both_hashes(tiny_bundle: Path) -> None:
    path = tiny_bundle / "exo2ego.onnx"
    before = file_sha256(path)
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    with pytest.raises(FileError, match=rf"exo2ego\.onnx: altered.*{before}.*{file_sha256(path)}"):
        load_bundle(tiny_bundle)


def test_a_file_that_is_no_model_is_named(tiny_bundle: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tiny_bundle / "depth.onnx").write_bytes(b"not a model")
    _edit(tiny_bundle, lambda m: m["models"]["depth"].update(sha256=file_sha256(tiny_bundle / "depth.onnx")))
    with pytest.raises(FileError, match=r"depth\.onnx: no model"):
        load_bundle(tiny_bundle)
    assert capfd.readouterr().err == ""


def test_an_input_of_the_wrong_shape_is_named_with_both_shapes(tiny_bundle: Path) -> None:
    _replace_model(tiny_bundle, "policy", policy_model(3, steer="goal"))  # three frames of history, not one
    with pytest.raises(
        FileError,
        match=r"policy\.onnx: input exo: shape expected \(any, 1, 1, 12, 16\), got \(any, 3, 1, 12, 16\)",
    ):
        load_bundle(tiny_bundle)


def test_a_batch_of_one_only_is_refused(tiny_bundle: Path) -> None:
    model = policy_model(1, steer="goal")
    for value in (*model.graph.input, *model.graph.output):
        value.type.tensor_type.shape.dim[0].ClearField("dim_param")
        value.type.tensor_type.shape.dim[0].dim_value = 1
    _replace_model(tiny_bundle, "policy", model)
    with pytest.raises(FileError, match=r"policy\.onnx: .* expected \(any, .* got \(1, "):
        load_bundle(tiny_bundle)


def test_a_model_that_gives_nan_is_refused(tiny_bundle: Path) -> None:
    model = depth_model()
    model.graph.node.append(onnx.helper.make_node("Log", ["mean"], ["disparity"]))  # of zero: −inf
    model.graph.node[0].output[0] = "mean"
    _replace_model(tiny_bundle, "depth", model)
    with pytest.raises(FileError, match=r"depth\.onnx: output disparity is not finite"):
        load_bundle(tiny_bundle)


def test_a_model_that_gives_text_is_refused(tiny_bundle: Path) -> None:
    model = depth_model()
    model.graph.node.append(onnx.helper.make_node("Cast", ["mean"], ["disparity"], to=onnx.TensorProto.STRING))
    model.graph.node[0].output[0] = "mean"
    model.graph.output[0].type.tensor_type.elem_type = onnx.TensorProto.STRING
    _replace_model(tiny_bundle, "depth", model)
    with pytest.raises(FileError, match=r"depth\.onnx: output disparity is no array of floats"):
        load_bundle(tiny_bundle)


def test_the_wrong_model_under_a_name_is_refused(tiny_bundle: Path) -> None:
    _replace_model(tiny_bundle, "policy", depth_model())
    with pytest.raises(FileError, match=r"policy\.onnx: inputs expected \['ego', 'exo'.*got \['image'\]"):
        load_bundle(tiny_bundle)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: m.update(colour="blue"), "colour: unknown key"),
        (lambda m: m["observation"].update(hfov=1.0), r"observation\.hfov: unknown key"),
        (lambda m: m["observation"].pop("history"), r"observation\.history: Field required"),
        (lambda m: m["observation"].update(history=0), r"observation\.history"),
        (lambda m: m["observation"].update(history="1"), r"observation\.history"),
        (lambda m: m["observation"].update(spacing_m=float("nan")), r"spacing_m|JSON"),
        (lambda m: m["models"]["depth"].update(std=[1.0, 0.0, 1.0]), r"models\.depth\.std"),
        (lambda m: m["models"]["policy"].update(file="../policy.onnx"), r"models\.policy\.file"),
        (lambda m: m["models"]["exo2ego"].update(schedule="linear"), r"models\.exo2ego\.schedule"),
        (lambda m: m.update(format=1), "format"),
    ],
)
def test_a_wrong_key_is_named(tiny_bundle: Path, change: Callable[[dict[str, Any]], None], message: str) -> None:
    _edit(tiny_bundle, change)
    with pytest.raises(FileError, match=rf"manifest\.json: .*({message})"):
        load_bundle(tiny_bundle)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", '"x"', "\x00" * 50, "9" * 2_000_000])
def test_garbage_for_a_manifest_is_an_error_of_ours(tiny_bundle: Path, text: str) -> None:
    (tiny_bundle / "manifest.json").write_text(text)
    with pytest.raises(FileError, match=r"manifest\.json"):
        load_bundle(tiny_bundle)


def test_the_tiny_policy_steers_to_the_side_of_the_goal(tiny_bundle: Path) -> None:
    policy = load_bundle(tiny_bundle).policy
    result = policy.run(
        exo=np.zeros((2, 1, 1, 12, 16), np.float32),
        ego=np.zeros((2, 1, 1, EGO_PX, EGO_PX), np.float32),
        robot=np.full((2, 2), 0.5, np.float32),
        heading=np.array([[0, -1], [0, -1]], np.float32),  # up in the picture
        goal=np.array([[0.5, 0.1], [0.1, 0.5]], np.float32),  # ahead; to the left
    )["waypoints"]
    np.testing.assert_allclose(result[0, 0], [0.3, 0.0], atol=1e-6)
    np.testing.assert_allclose(result[1, 4], [0.0, 1.5], atol=1e-6)


def test_a_tiny_bundle_with_history_loads(tmp_path: Path) -> None:
    assert load_bundle(write_tiny_bundle(tmp_path / "b", steer="ahead", history=5)).spec.history == 5


def test_a_map_needs_the_depth_network_only(tiny_bundle: Path) -> None:
    assert load_depth_bundle(tiny_bundle).missing == ()
    (tiny_bundle / "policy.onnx").unlink()
    bundle = load_depth_bundle(tiny_bundle)
    assert bundle.missing == missing_models(tiny_bundle) == ("policy.onnx",)
    assert bundle.spec.disparity_hw == DISPARITY_HW
    (tiny_bundle / "exo2ego.onnx").unlink()
    assert missing_models(tiny_bundle) == ("policy.onnx", "exo2ego.onnx")
    (tiny_bundle / "depth.onnx").unlink()
    with pytest.raises(FileError, match=r"depth\.onnx: missing"):
        load_depth_bundle(tiny_bundle)


@pytest.mark.parametrize("file", ["policy.onnx", "depth.onnx"])
def test_what_is_there_must_not_be_altered_even_where_it_is_not_needed(tiny_bundle: Path, file: str) -> None:
    (tiny_bundle / "exo2ego.onnx").unlink()
    (tiny_bundle / file).write_bytes(b"altered")
    with pytest.raises(FileError, match=rf"{file}: altered"):
        load_depth_bundle(tiny_bundle)


def test_a_link_to_nowhere_is_an_error_and_not_missing(tiny_bundle: Path) -> None:
    (tiny_bundle / "policy.onnx").unlink()
    (tiny_bundle / "policy.onnx").symlink_to("/nowhere")
    assert missing_models(tiny_bundle) == ()
    with pytest.raises(FileError, match=r"policy\.onnx: missing"):
        load_bundle(tiny_bundle)
