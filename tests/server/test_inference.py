from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

from revnm_client.errors import ContractError, FileError
from revnm_server.networks.inference import OnnxModel

from .tiny_bundle import DISPARITY_HW


def test_runs_a_model_and_tells_its_shapes(tiny_bundle: Path) -> None:
    model = OnnxModel(tiny_bundle / "depth.onnx", threads=1)
    height, width = DISPARITY_HW
    assert model.inputs == {"image": (1, 3, height, width)}
    assert model.outputs == {"disparity": (1, height, width)}
    image = np.random.default_rng(0).random((1, 3, height, width), dtype=np.float32)
    np.testing.assert_allclose(model.run(image=image)["disparity"], image.mean(axis=1), rtol=1e-5)


def test_a_dynamic_axis_has_no_number_and_takes_any_batch(tiny_bundle: Path) -> None:
    model = OnnxModel(tiny_bundle / "exo2ego.onnx")
    assert model.inputs["noisy"] == (None, 1, 32, 32)
    for count in (1, 16):
        ego = np.full((count, 1, 32, 32), 0.25, np.float32)
        pose = np.zeros((count, 2), np.float32)
        step = np.full(count, 999)
        result = model.run(noisy=ego, crop=ego, step=step, robot=pose, heading=pose)
        np.testing.assert_allclose(result["clean"], 2 * ego - 1)


def test_an_input_that_does_not_fit_names_file_and_input(tiny_bundle: Path, capfd: pytest.CaptureFixture[str]) -> None:
    model = OnnxModel(tiny_bundle / "depth.onnx")
    with pytest.raises(ContractError, match=r"depth\.onnx: cannot run on image float64\[1, 3\]"):
        model.run(image=np.zeros((1, 3)))
    with pytest.raises(ContractError, match=r"depth\.onnx: cannot run on picture"):
        model.run(picture=np.zeros((1, 3, *DISPARITY_HW), np.float32))
    assert capfd.readouterr().err == ""


def test_an_output_that_is_not_finite_is_an_error(tiny_bundle: Path) -> None:
    model = OnnxModel(tiny_bundle / "depth.onnx")
    image = np.full((1, 3, *DISPARITY_HW), np.nan, np.float32)
    with pytest.raises(ContractError, match="output disparity is not finite"):
        model.run(image=image)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"none\.onnx: missing"):
        OnnxModel(tmp_path / "none.onnx")


def test_several_threads_may_run_one_model(tiny_bundle: Path) -> None:
    model = OnnxModel(tiny_bundle / "depth.onnx", threads=1)
    means: dict[int, set[float]] = {}

    def work(value: int) -> None:
        image = np.full((1, 3, *DISPARITY_HW), value, np.float32)
        means[value] = {float(model.run(image=image)["disparity"].mean()) for _ in range(50)}

    threads = [threading.Thread(target=work, args=(value,)) for value in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert means == {value: {float(value)} for value in range(4)}
