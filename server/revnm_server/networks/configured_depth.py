"""Loads a depth network by its settings, and refuses one that does not fit them, with words that say what to change.

Anybody may have exported such a network. Its files are hashed, what ``auto`` leaves open is read from the model, its
shapes are compared with the settings, and :mod:`revnm_server.networks.depth_checks` looks at what it says of two
pictures.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from revnm_client.errors import ConfigError, FileError
from revnm_server.networks.checked_file import check_sha256
from revnm_server.networks.depth_checks import check_depth
from revnm_server.networks.depth_input import DepthInput
from revnm_server.networks.depth_network import DepthNetwork
from revnm_server.networks.depth_output import DepthOutput
from revnm_server.networks.inference import OnnxModel, Shape
from revnm_server.networks.providers import Provider
from revnm_server.settings.depth import DepthInputSettings, DepthSettings

_OUTPUTS = ("depth", "predicted_depth", "disparity", "metric_depth")
_DTYPES = ("float32", "float16", "uint8")
# ONNX names a file of weights in an entry of key and value: fields 1 and 2, each with its length before it.
_WEIGHTS_BESIDE = re.compile(rb"\x0a\x08location\x12([\x01-\x7f])")


def load_depth_network(settings: DepthSettings, *, threads: int = 2, provider: Provider = "cpu") -> DepthNetwork:
    """Load the network that the settings name, and check it.

    Args:
        settings: With a model.
        threads: Threads that one call may use.
        provider: What runs it.

    Raises:
        FileError: A file is missing, altered or no model, or the network gives something else than the settings say.
        ConfigError: A setting does not fit the model, or the provider is not installed or cannot start.
    """
    path, sha256, kind = settings.model, settings.sha256, settings.kind
    if path is None or sha256 is None or kind is None:
        raise ConfigError("depth: expected model, sha256 and kind")
    check_sha256(path, sha256)
    _check_weights(path, settings.data)
    model = OnnxModel(path, threads=threads, provider=provider)
    output = _chosen("outputs.depth", settings.outputs.depth, _likely(model.outputs), model.outputs)
    sky = settings.outputs.sky
    if sky is not None:
        _chosen("outputs.sky", sky, (), model.outputs)
    network = DepthNetwork(model, _takes(model, settings.input), DepthOutput(output, kind, sky))
    check_depth(network)
    return network


def weights_beside(path: Path) -> set[str]:
    """Return the names of the files beside an ONNX model from which it reads weights."""
    found: set[str] = set()
    if path.stat().st_size == 0:
        return found  # what is empty cannot be mapped
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for match in _WEIGHTS_BESIDE.finditer(content):
            found.add(content[match.end() : match.end() + match[1][0]].decode("utf-8", "replace"))
    return found


def _check_weights(path: Path, sums: Mapping[str, str]) -> None:
    read = weights_beside(path)
    for name in sorted(read - sums.keys()):
        raise FileError(f"{path}: reads weights from {name}, too; expected its sha256 under depth.data")
    for name in sorted(sums.keys() - read):
        raise ConfigError(f"depth.data: {path} reads nothing from {name}")
    for name, sha256 in sums.items():
        check_sha256(path.parent / name, sha256)


def _likely(names: Iterable[str]) -> tuple[str, ...]:
    only = tuple(names)
    return only if len(only) == 1 else tuple(name for name in only if name in _OUTPUTS)


def _chosen(key: str, name: str, likely: tuple[str, ...], there: Iterable[str]) -> str:
    """Return the name that is set, or the likely one where that is left open."""
    names = ", ".join(there)
    if name != "auto":
        if name not in there:
            raise ConfigError(f"depth.{key}: the model has no {name}; it has {names}")
        return name
    if len(likely) != 1:
        raise ConfigError(f"depth.{key}: cannot be told from the model's names; set one of {names}")
    return likely[0]


def _takes(model: OnnxModel, settings: DepthInputSettings) -> DepthInput:
    names = tuple(model.inputs)
    name = _chosen("input.name", settings.name, names if len(names) == 1 else (), names)
    if len(names) > 1:
        others = ", ".join(other for other in names if other != name)
        raise FileError(f"{model.path}: needs more inputs than the picture: {others}")
    shape, dtype = model.inputs[name], model.input_dtypes[name]
    if len(shape) not in (4, 5) or any(n not in (None, 1) for n in shape[:-3]) or shape[-3] not in (None, 3):
        raise FileError(
            f"{model.path}: input {name}: expected one RGB picture, (1, 3, h, w) or (1, 1, 3, h, w), got {_text(shape)}"
        )
    if dtype not in _DTYPES:
        raise FileError(f"{model.path}: input {name}: expected numbers of {', '.join(_DTYPES)}, got {dtype}")
    mean, std = settings.mean_std
    if dtype == "uint8" and (settings.range, mean, std) != ("byte", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)):
        raise ConfigError("depth.input: the model takes bytes as they are; set range: byte, and neither mean nor std")
    return DepthInput(
        name=name,
        size_hw=_size(model, shape[-2:], settings),
        mode=settings.mode,
        multiple_of=settings.multiple_of,
        range=settings.range,
        mean=mean,
        std=std,
        dtype=dtype,
        views=len(shape) == 5,
    )


def _size(model: OnnxModel, fixed: Shape, settings: DepthInputSettings) -> tuple[int, int]:
    """Return H and W of the input, or the length of one side twice, where the picture decides the other."""
    size, mode, multiple = settings.size, settings.mode, settings.multiple_of
    if mode in ("longest", "shortest") and any(n is not None for n in fixed):
        raise ConfigError(
            f"depth.input.mode: {mode} needs a network of any size, but {model.path} takes {_text(fixed)}; "
            "set fixed or letterbox"
        )
    height, width = fixed
    if size is None:
        if height is None or width is None:
            raise ConfigError(f"depth.input.size: {model.path} takes any size; expected the one to use")
        size = (height, width)
    wanted = (size, size) if isinstance(size, int) else size
    if any(n is not None and n != m for n, m in zip(fixed, wanted, strict=True)):
        raise ConfigError(f"depth.input.size: {model.path} takes {_text(fixed)} only, got {_text(wanted)}")
    if any(n % multiple for n in wanted):
        raise ConfigError(
            f"depth.input.multiple_of: {model.path} takes {_text(wanted)}, which is no multiple of {multiple}"
        )
    return wanted


def _text(shape: Shape) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
