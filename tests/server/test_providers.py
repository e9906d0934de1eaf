"""What runs the networks, and what is said where that is missing."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from revnm_client.errors import ConfigError
from revnm_server.assembly import load_models
from revnm_server.networks.inference import OnnxModel
from revnm_server.networks.providers import Provider, check_used, provider_names
from revnm_server.settings import load_settings

CPU, CUDA, TENSORRT = "CPUExecutionProvider", "CUDAExecutionProvider", "TensorrtExecutionProvider"


def test_the_cpu_is_always_there(tiny_bundle: Path) -> None:
    assert provider_names("cpu", [CPU]) == [CPU]
    OnnxModel(tiny_bundle / "depth.onnx", provider="cpu")


def test_cuda_takes_what_tensorrt_does_not() -> None:
    assert provider_names("tensorrt", [TENSORRT, CUDA, CPU]) == [TENSORRT, CUDA]
    assert provider_names("cuda", [TENSORRT, CUDA, CPU]) == [CUDA]


@pytest.mark.parametrize(
    ("provider", "name", "package"),
    [
        ("cuda", CUDA, "onnxruntime-gpu[cuda,cudnn]"),
        ("tensorrt", TENSORRT, "onnxruntime-gpu[cuda,cudnn]"),
        ("openvino", "OpenVINOExecutionProvider", "onnxruntime-openvino"),
    ],
)
def test_a_missing_provider_is_an_error_that_says_what_to_install(
    tiny_bundle: Path, provider: Provider, name: str, package: str
) -> None:
    """The installed onnxruntime has none of them."""
    said = rf"perception\.provider: {provider} needs {name}, but .* has .*{CPU}.*pip install '{re.escape(package)}'\)"
    settings = load_settings(overrides={"perception": {"bundle": tiny_bundle, "provider": provider}})
    with pytest.raises(ConfigError, match=said):
        load_models(settings.perception, settings.depth)


def test_falling_back_in_silence_is_an_error() -> None:
    check_used("cuda", [CUDA, CPU])
    with pytest.raises(ConfigError, match=r"cuda: CUDAExecutionProvider could not start, .* fell back to CPU.*cuDNN"):
        check_used("cuda", [CPU])
    with pytest.raises(ConfigError, match=r"tensorrt: .* fell back to CUDA.*, CPU.*; .* TensorRT"):
        check_used("tensorrt", [CUDA, CPU])


def test_an_unknown_provider_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"perception\.provider"):
        load_settings(overrides={"perception": {"provider": "npu"}})
