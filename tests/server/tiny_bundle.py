"""Writes a complete model bundle of a few kilobytes, whose models do something one can predict."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from revnm_server.networks.checked_file import file_sha256
from revnm_server.networks.manifest import MANIFEST

EGO_PX = 32
DISPARITY_HW = (24, 32)
EXO_HW = (12, 16)
WAYPOINTS = 5
SPACING_M = 0.3
MAP_SPACING_M = 0.4
Steer = Literal["ahead", "goal"]
Sees = Literal["picture", "map"]


def write_tiny_bundle(folder: Path, *, steer: Steer = "goal", history: int = 1, sees: Sees = "picture") -> Path:
    """Write a bundle into a new or empty folder and return the folder.

    Depth: the brightness of the picture is the disparity. Exo2ego: the ego depth is the newest crop. Policy:
    five waypoints 0.3 m apart, straight ahead or along the straight line in the picture that leads to the goal
    (as if the camera hung above the robot and the picture were 4:3).

    Args:
        folder: Where to write.
        steer: ``"ahead"`` or ``"goal"``.
        history: N, frames of history, 0.2 s apart.
        sees: With ``"map"``, the policy believes the map as it is; waypoints are 0.4 m apart, and ``steer`` does not
            matter.
    """
    folder.mkdir(parents=True, exist_ok=True)
    onnx.save(depth_model(), folder / "depth.onnx")
    onnx.save(exo2ego_model(history, prior=sees == "map"), folder / "exo2ego.onnx")
    policy = floor_policy_model() if sees == "map" else policy_model(history, steer=steer)
    onnx.save(policy, folder / "policy.onnx")
    (folder / MANIFEST).write_text(json.dumps(manifest(folder, history, sees), indent=1))
    return folder


def manifest(folder: Path, history: int, sees: Sees = "picture") -> dict[str, Any]:
    """Return the manifest of the models that lie in the folder."""

    def model(name: str, **more: Any) -> dict[str, Any]:
        return {"file": f"{name}.onnx", "sha256": file_sha256(folder / f"{name}.onnx"), **more}

    return {
        "format": 2,
        "name": "tiny",
        "observation": {
            "history": history,
            "history_interval_s": 0.2,
            "disparity_hw": DISPARITY_HW,
            "exo_hw": EXO_HW,
            "crop_px": EGO_PX,
            "crop_span": 0.4,
            "crop_heading_up": True,
            "ego_px": EGO_PX,
            "ego_hfov_rad": 1.5,
            "ego_height_m": 0.3,
            "ego_range_m": 5.0,
            "waypoints": WAYPOINTS,
            "spacing_m": MAP_SPACING_M if sees == "map" else SPACING_M,
        },
        "models": {
            "policy": model("policy", sees=sees),
            "exo2ego": model("exo2ego", steps=2, schedule="cosine", prior=sees == "map", noise=True),
            "depth": model("depth", kind="disparity", mean=[0.0, 0.0, 0.0], std=[1.0, 1.0, 1.0]),
        },
        "recipe": {},
        "data": {},
        "results": {},
    }


def depth_model() -> onnx.ModelProto:
    """``disparity`` is the mean of the channels of ``image``."""
    height, width = DISPARITY_HW
    return _model(
        [helper.make_node("ReduceMean", ["image"], ["disparity"], axes=[1], keepdims=0)],
        {"image": (1, 3, height, width)},
        {"disparity": (1, height, width)},
    )


def exo2ego_model(history: int, *, prior: bool = False) -> onnx.ModelProto:
    """``clean`` is the newest of ``crop``, mapped to [−1, 1]; a prior is taken and not looked at."""
    ego = ("R", 1, EGO_PX, EGO_PX)
    more: dict[str, tuple[int | str, ...]] = {"prior": ("R", 2, EGO_PX, EGO_PX)} if prior else {}
    return _model(
        [
            helper.make_node("Gather", ["crop", "newest"], ["last"], axis=1),
            helper.make_node("Mul", ["last", "two"], ["doubled"]),
            helper.make_node("Sub", ["doubled", "one"], ["clean"]),
        ],
        {
            "noisy": ego,
            "crop": ("R", history, EGO_PX, EGO_PX),
            "step": ("R",),
            "robot": ("R", 2),
            "heading": ("R", 2),
            **more,
        },
        {"clean": ego},
        newest=np.array([history - 1]),
        two=np.float32(2.0),
        one=np.float32(1.0),
    )


def policy_model(history: int, *, steer: Steer) -> onnx.ModelProto:
    """``waypoints`` lie evenly along one direction in the robot frame."""
    nodes = [
        helper.make_node("Sub", ["goal", "robot"], ["offset"]),
        helper.make_node("Mul", ["offset", "aspect"], ["way"]),  # (R, 2) in heights of the picture
        # Forward is the heading (a, b); left, with v down, is (b, −a).
        helper.make_node("Mul", ["way", "heading"], ["forward_parts"]),
        helper.make_node("ReduceSum", ["forward_parts", "axis"], ["forward"], keepdims=1),
        helper.make_node("Gather", ["heading", "swapped"], ["swapped_heading"], axis=1),
        helper.make_node("Mul", ["swapped_heading", "signs"], ["left_axis"]),
        helper.make_node("Mul", ["way", "left_axis"], ["left_parts"]),
        helper.make_node("ReduceSum", ["left_parts", "axis"], ["left"], keepdims=1),
        helper.make_node("Concat", ["forward", "left"], ["goal_side"], axis=1),  # (R, 2)
        helper.make_node("Mul", ["goal_side", "follow"], ["followed"]),
        helper.make_node("Add", ["followed", "straight"], ["direction"]),
        helper.make_node("ReduceL2", ["direction"], ["length"], axes=[1], keepdims=1),
        helper.make_node("Max", ["length", "least"], ["safe_length"]),
        helper.make_node("Div", ["direction", "safe_length"], ["unit"]),
        helper.make_node("Unsqueeze", ["unit", "axis"], ["unit_row"]),  # (R, 1, 2)
        helper.make_node("Mul", ["unit_row", "distances"], ["waypoints"]),  # (R, H, 2)
    ]
    follows = steer == "goal"
    return _model(
        nodes,
        {
            "exo": ("R", history, 1, *EXO_HW),
            "ego": ("R", history, 1, EGO_PX, EGO_PX),
            "robot": ("R", 2),
            "heading": ("R", 2),
            "goal": ("R", 2),
        },
        {"waypoints": ("R", WAYPOINTS, 2)},
        aspect=np.array([4.0 / 3.0, 1.0], dtype=np.float32),
        axis=np.array([1]),
        swapped=np.array([1, 0]),
        signs=np.array([1.0, -1.0], dtype=np.float32),
        follow=np.float32(1.0 if follows else 0.0),
        straight=np.array([0.0 if follows else 1.0, 0.0], dtype=np.float32),
        least=np.float32(1e-6),
        distances=(SPACING_M * np.arange(1, WAYPOINTS + 1, dtype=np.float32))[:, None],
    )


def floor_policy_model() -> onnx.ModelProto:
    """``occupied`` is what the map says."""
    nodes = [
        helper.make_node("Gather", ["map", "obstacle"], ["occupied"], axis=1),
    ]
    return _model(
        nodes,
        {"map": ("R", 4, 96, 96), "way": ("R", 12, 2), "goal": ("R", 2), "ego": ("R", 1, EGO_PX, EGO_PX)},
        {"occupied": ("R", 96, 96)},
        obstacle=np.array(0),
    )


def _model(
    nodes: list[onnx.NodeProto],
    inputs: dict[str, tuple[int | str, ...]],
    outputs: dict[str, tuple[int | str, ...]],
    **constants: np.ndarray | np.generic,
) -> onnx.ModelProto:
    def values(shapes: dict[str, tuple[int | str, ...]]) -> list[onnx.ValueInfoProto]:
        return [
            helper.make_tensor_value_info(name, TensorProto.INT64 if name == "step" else TensorProto.FLOAT, shape)
            for name, shape in shapes.items()
        ]

    tensors = [numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "tiny", values(inputs), values(outputs), tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    return model
