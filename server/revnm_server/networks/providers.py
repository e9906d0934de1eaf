"""What can run the networks: onnxruntime's execution providers, and how to get those that are missing.

onnxruntime runs on the CPU, without an error, whatever a provider does not take or cannot start for; a server with a
graphics card should rather say so than be ten times as slow. Knows names only and imports no onnxruntime.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from revnm_client.errors import ConfigError

Provider = Literal["cpu", "cuda", "tensorrt", "openvino"]


@dataclass(frozen=True, slots=True)
class _Known:
    """A provider: its names in onnxruntime, most wanted first, and what it needs on the machine."""

    names: tuple[str, ...]
    package: str
    needs: str


_KNOWN: dict[Provider, _Known] = {
    "cpu": _Known(("CPUExecutionProvider",), "onnxruntime", "nothing else"),
    "cuda": _Known(
        ("CUDAExecutionProvider",),
        "onnxruntime-gpu[cuda,cudnn]",
        "an NVIDIA driver, CUDA and cuDNN; [cuda,cudnn] brings the last two",
    ),
    # What TensorRT cannot run, CUDA takes.
    "tensorrt": _Known(
        ("TensorrtExecutionProvider", "CUDAExecutionProvider"),
        "onnxruntime-gpu[cuda,cudnn]",
        "an NVIDIA driver, CUDA, cuDNN and TensorRT; [cuda,cudnn] does not bring the last",
    ),
    "openvino": _Known(("OpenVINOExecutionProvider",), "onnxruntime-openvino", "OpenVINO, which comes with it"),
}


def provider_names(provider: Provider, available: Sequence[str]) -> list[str]:
    """Return onnxruntime's names of a provider, most wanted first.

    Args:
        provider: What the settings ask for.
        available: The providers that the installed onnxruntime was built with.

    Raises:
        ConfigError: It is not among them; the text says which package has it.
    """
    known = _KNOWN[provider]
    if known.names[0] not in available:
        raise ConfigError(
            f"perception.provider: {provider} needs {known.names[0]}, but the installed onnxruntime has "
            f"{', '.join(available)}; install {known.package} in place of the package that is there "
            f"(pip uninstall onnxruntime; pip install '{known.package}')"
        )
    return list(known.names)


def check_used(provider: Provider, used: Sequence[str]) -> None:
    """Check that a session runs on the provider that was asked for.

    Args:
        provider: What the settings ask for.
        used: The providers of the session.

    Raises:
        ConfigError: onnxruntime fell back to another; the text says what the provider needs.
    """
    known = _KNOWN[provider]
    if known.names[0] not in used:
        raise ConfigError(
            f"perception.provider: {provider}: {known.names[0]} could not start, and onnxruntime fell back to "
            f"{', '.join(used)}; {known.package} needs {known.needs}"
        )
