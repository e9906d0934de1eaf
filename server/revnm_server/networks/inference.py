"""Runs ONNX models; the only module that imports onnxruntime.

Everything else sees :class:`OnnxModel`, so another runtime is one file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from onnxruntime.capi import onnxruntime_pybind11_state as _ort

from revnm_client.errors import ContractError, FileError
from revnm_server.networks.providers import Provider, check_used, provider_names

Shape = tuple[int | None, ...]

# onnxruntime's exceptions have no common base.
_ORT_ERRORS: tuple[type[Exception], ...] = (
    _ort.EPFail,
    _ort.Fail,
    _ort.InvalidArgument,
    _ort.InvalidGraph,
    _ort.InvalidProtobuf,
    _ort.NoModel,
    _ort.NoSuchFile,
    _ort.NotFound,
    _ort.NotImplemented,
    _ort.RuntimeException,
    RuntimeError,
    ValueError,
)
_LOG_FATAL_ONLY = 4
_DTYPES = {"tensor(float)": "float32", "tensor(float16)": "float16", "tensor(uint8)": "uint8", "tensor(int64)": "int64"}


class OnnxModel:
    """A loaded ONNX model; ``run`` and ``compute`` may be called from several threads."""

    def __init__(self, path: Path, *, threads: int = 2, provider: Provider = "cpu") -> None:
        """Load the model.

        Args:
            path: The ``.onnx`` file.
            threads: Threads that one call may use.
            provider: What runs it.

        Raises:
            FileError: The file is not there or is no model that onnxruntime can run.
            ConfigError: The provider is not installed, or cannot start.
        """
        self.path = path
        if not path.is_file():
            raise FileError(f"{path}: missing")
        names = provider_names(provider, onnxruntime.get_available_providers())
        if provider in ("cuda", "tensorrt"):
            onnxruntime.preload_dlls()  # CUDA and cuDNN, where pip installed them
        try:
            self._session = onnxruntime.InferenceSession(str(path), _session_options(threads), providers=names)
        except _ORT_ERRORS as error:
            raise FileError(f"{path}: no model that onnxruntime can run: {_first_line(error)}") from error
        check_used(provider, self._session.get_providers())

    @property
    def inputs(self) -> dict[str, Shape]:
        """Shape of each input by name; a dynamic axis is None."""
        return {value.name: _shape(value.shape) for value in self._session.get_inputs()}

    @property
    def outputs(self) -> dict[str, Shape]:
        """Shape of each output by name; a dynamic axis is None."""
        return {value.name: _shape(value.shape) for value in self._session.get_outputs()}

    @property
    def input_dtypes(self) -> dict[str, str]:
        """Name of each input's dtype, such as ``float32``; one that numpy has no name for is onnxruntime's own."""
        return {value.name: _DTYPES.get(value.type, value.type) for value in self._session.get_inputs()}

    def run(self, **arrays: NDArray[Any]) -> dict[str, NDArray[Any]]:
        """Run the model once.

        Args:
            arrays: One array per input of the model, with its dtype and shape.

        Returns:
            One array per output, by name.

        Raises:
            ContractError: An input does not fit the model, or an output is no array of finite floats.
        """
        outputs = self.compute(list(self.outputs), arrays)
        for name, value in outputs.items():
            if not np.isfinite(value).all():
                raise ContractError(f"{self.path}: output {name} is not finite")
        return outputs

    def compute(self, names: Sequence[str], arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """Run the model once for some of its outputs, which need not be finite.

        Args:
            names: The outputs.
            arrays: One array per input of the model, with its dtype and shape.

        Returns:
            One array per name.

        Raises:
            ContractError: An input does not fit the model, or an output is no array of floats.
        """
        try:
            values = self._session.run(list(names), dict(arrays))
        except _ORT_ERRORS as error:
            given = ", ".join(f"{name} {a.dtype}{list(a.shape)}" for name, a in arrays.items())
            raise ContractError(f"{self.path}: cannot run on {given}: {_first_line(error)}") from error
        for name, value in zip(names, values, strict=True):
            if not isinstance(value, np.ndarray) or value.dtype.kind != "f":
                raise ContractError(f"{self.path}: output {name} is no array of floats")
        return dict(zip(names, values, strict=True))


def _session_options(threads: int) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = _LOG_FATAL_ONLY  # errors come as exceptions
    # Threads spin between the operators of a run, since to wake one takes as long as a small operator; and no longer:
    # idle threads that spin would take the cores from the camera's decoder and from the other models.
    options.add_session_config_entry("session.intra_op.allow_spinning", "1")
    options.add_session_config_entry("session.force_spinning_stop", "1")
    options.add_session_config_entry("session.dynamic_block_base", "4")  # a thread that was held up gets less to do
    return options


def _shape(dims: list[int | str | None]) -> Shape:
    return tuple(dim if isinstance(dim, int) else None for dim in dims)


def _first_line(error: Exception) -> str:
    return str(error).strip().split("\n", maxsplit=1)[0]
