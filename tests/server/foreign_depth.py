"""Writes small ONNX files that behave like the depth networks of others.

They take what is lower in the picture, and what is less red, for nearer: disparity is 1 + blue − red + 2 · y, with y
from 0 at the top to 1 at the bottom, and depth is 4 minus that, in pictures of any size.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from revnm_server.networks.checked_file import file_sha256
from revnm_server.settings import DepthSettings

Says = Literal["disparity", "depth"]
Shape = tuple[int | str, ...]

_TYPES = {"float32": TensorProto.FLOAT, "float16": TensorProto.FLOAT16, "uint8": TensorProto.UINT8}


def settings_for(path: Path, kind: str, **more: object) -> DepthSettings:
    """Return the settings of a network, its sum included; by default pixels are not normalised."""
    usual = {"input": {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}}
    return DepthSettings.model_validate({"model": path, "sha256": file_sha256(path), "kind": kind, **usual, **more})


def write_depth(
    path: Path,
    *,
    says: Says = "disparity",
    shape: Shape = (1, 3, "h", "w"),
    dtype: str = "float32",
    names: tuple[str, str] = ("image", "depth"),
    extras: tuple[str, ...] = (),
    last: tuple[onnx.NodeProto, ...] = (),
    **constants: np.ndarray | np.generic,
) -> Path:
    """Write a network and return its path.

    Args:
        path: Where.
        says: Whether its output grows with nearness or with distance.
        shape: Of its input, of rank 4 or 5; letters are dynamic.
        dtype: Of input and output; with ``uint8`` the output is float32.
        names: Of input and output.
        extras: Names of further outputs, of one number each.
        last: Nodes from ``plain`` to ``said``, float32, that change what it says.
        constants: Of these nodes.
    """
    gives = "float32" if dtype == "uint8" else dtype
    sign = 1.0 if says == "disparity" else -1.0
    nodes = [
        helper.make_node("Cast", [names[0]], ["numbers"], to=TensorProto.FLOAT),
        helper.make_node("Mul", ["numbers", "weights"], ["weighted"]),
        helper.make_node("ReduceSum", ["weighted", "channels"], ["colour"], keepdims=0),
        helper.make_node("Mul", ["colour", "none"], ["zeros"]),
        helper.make_node("Add", ["zeros", "step"], ["steps"]),
        helper.make_node("CumSum", ["steps", "rows"], ["count"]),
        helper.make_node("ReduceMax", ["count"], ["last_row"], keepdims=0),
        helper.make_node("Div", ["count", "last_row"], ["down"]),  # 0 at the top, 1 at the bottom
        helper.make_node("Mul", ["down", "slope"], ["sloping"]),
        helper.make_node("Add", ["colour", "sloping"], ["lower"]),
        helper.make_node("Add", ["lower", "least"], ["plain"]),
        *last,
        helper.make_node("Cast", ["said" if last else "plain"], [names[1]], to=_TYPES[gives]),
        *(helper.make_node("Identity", ["least"], [name]) for name in extras),
    ]
    tensors: dict[str, np.ndarray | np.generic] = {
        "weights": np.float32(sign / 255.0 if dtype == "uint8" else sign) * np.float32([[[-1]], [[0]], [[1]]]),
        "channels": np.array([-3]),
        "none": np.float32(0.0),
        "step": np.float32(1.0),
        "rows": np.array(len(shape) - 3),
        "slope": np.float32(2.0 * sign),
        "least": np.float32(1.0 if says == "disparity" else 3.0),
        **constants,
    }
    infos = [helper.make_tensor_value_info(names[1], _TYPES[gives], (*shape[:-3], *shape[-2:]))]
    infos += [helper.make_tensor_value_info(name, TensorProto.FLOAT, ()) for name in extras]
    graph = helper.make_graph(
        nodes,
        "depth",
        [helper.make_tensor_value_info(names[0], _TYPES[dtype], shape)],
        infos,
        [numpy_helper.from_array(np.asarray(value), name) for name, value in tensors.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)
    return path
