"""Tiny networks in ONNX files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from dream.perception.sight import GRID, HEIGHT, WIDTH

OPSET = 17


def save(
    path: Path,
    nodes: list[onnx.NodeProto],
    weights: Mapping[str, np.ndarray],
    shape: list[int | str],
    outputs: Mapping[str, list[int | str]],
    *,
    metadata: Mapping[str, str] | None = None,
    kind: int = TensorProto.FLOAT,
    out: int = TensorProto.FLOAT,
    opset: int = OPSET,
) -> Path:
    """Write a model with the input `images`; weights that are no whole numbers become float32."""
    tensors = [
        numpy_helper.from_array(value if value.dtype.kind == "i" else value.astype(np.float32), name)
        for name, value in weights.items()
    ]
    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info("images", kind, shape)],
        [helper.make_tensor_value_info(name, out, size) for name, size in outputs.items()],
        tensors,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    helper.set_model_props(model, dict(metadata or {}))
    path.write_bytes(model.SerializeToString())
    return path


def redness(path: Path, *, gain: float = 50.0, open_size: bool = False) -> Path:
    """Scores of three classes: floor 0, shell R − B − 0.35, pipe G − 2 R − 0.12; a convolution."""
    weights = np.zeros((3, 3, 1, 1))
    weights[1, :, 0, 0] = gain, 0.0, -gain
    weights[2, :, 0, 0] = -2.0 * gain, gain, 0.0
    size: list[int | str] = [1, 3, "h", "w"] if open_size else [1, 3, 24, 32]
    return save(
        path,
        [helper.make_node("Conv", ["images", "weights", "bias"], ["scores"])],
        {"weights": weights, "bias": gain * np.array([0.0, -0.35, -0.12])},
        size,
        {"scores": size},
    )


def redness_last(path: Path) -> Path:
    """`redness` with its channels last, on either side."""
    model = onnx.load(redness(path))
    (conv,) = model.graph.node
    conv.input[0], conv.output[0] = "first", "inner"
    before = helper.make_node("Transpose", ["images"], ["first"], perm=[0, 3, 1, 2])
    after = helper.make_node("Transpose", ["inner"], ["scores"], perm=[0, 2, 3, 1])
    weights = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    size: list[int | str] = [1, 24, 32, 3]
    return save(path, [before, conv, after], weights, size, {"scores": size})


def ending(
    path: Path,
    scores: np.ndarray,
    *ends: onnx.NodeProto,
    weights: Mapping[str, np.ndarray] | None = None,
    kind: int = TensorProto.FLOAT,
    out: int = TensorProto.FLOAT,
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """Scores of red, green, blue and one (C, 4) for each class, and whatever ends make `out` of `scores`.

    For a picture of 24 × 32.
    """
    nodes = [
        helper.make_node("Cast", ["images"], ["floats"], to=TensorProto.FLOAT),
        helper.make_node("Conv", ["floats", "weights", "bias"], ["scores"]),
        *(ends or [helper.make_node("Identity", ["scores"], ["out"])]),
    ]
    own = {"weights": scores[:, :3, None, None], "bias": scores[:, 3], **(weights or {})}
    size: list[int | str] = [1, 3, 24, 32]
    graph = save(path, nodes, own, size, {"out": []}, metadata=metadata, kind=kind, out=out)
    model = onnx.load(graph)
    # Exporters leave open what they do not know; so is the shape here.
    model.graph.output[0].type.tensor_type.ClearField("shape")
    path.write_bytes(model.SerializeToString())
    return path


def constant(path: Path, value: np.ndarray) -> Path:
    """Says the same of every picture: a map (h, w)."""
    return save(
        path,
        [
            helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=1),
            helper.make_node("Mul", ["mean", "nought"], ["nothing"]),
            helper.make_node("Add", ["nothing", "value"], ["depth"]),
        ],
        {"nought": np.zeros(1), "value": value[None, None]},
        [1, 3, 24, 32],
        {"depth": [1, 1, *value.shape]},
    )


def instances(
    path: Path, table: np.ndarray, masks: np.ndarray, metadata: Mapping[str, str], *, size: int = 64
) -> Path:
    """Says of every picture that it shows these instances, as Ultralytics' segmentation models do."""
    both = {"output0": table[None], "output1": masks[None]}
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], axes=[1, 2, 3], keepdims=0),
        helper.make_node("Mul", ["mean", "nought"], ["nothing"]),
    ]
    nodes += [helper.make_node("Add", ["nothing", f"{name}_value"], [name]) for name in both]
    return save(
        path,
        nodes,
        {"nought": np.zeros(1), **{f"{name}_value": value for name, value in both.items()}},
        [1, 3, size, size],
        {name: list(value.shape) for name, value in both.items()},
        metadata=metadata,
    )


def frozen_network(path: Path) -> Path:
    """A network of the right shape, whose answers have nothing to do with what goes in."""
    rng = np.random.default_rng(1)
    sizes = {"labels": (1, 4, HEIGHT, WIDTH), "depth": (1, 2, *GRID), "features": (1, 72, *GRID)}
    float32 = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        [helper.make_node("Identity", [f"{name}_kept"], [name]) for name in sizes],
        "frozen",
        [helper.make_tensor_value_info(name, float32, [1, 3, HEIGHT, WIDTH]) for name in ("picture", "view")],
        [helper.make_tensor_value_info(name, float32, list(size)) for name, size in sizes.items()],
        [
            numpy_helper.from_array((3.0 * rng.random(size) - 1.0).astype(np.float32), f"{name}_kept")
            for name, size in sizes.items()
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path
