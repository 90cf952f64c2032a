"""A student as one ONNX file that anyone can run.

The graph is put together here, layer by layer. PyTorch's own exporter would write the places of its sources
into the file, and needs one more package.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dream import extras
from dream.learning.expert import TURNS
from dream.learning.network import PLANES, import_torch
from dream.learning.training import answers_of
from dream.perception.representation import HEIGHT, WIDTH
from dream.types import Float32Array

if TYPE_CHECKING:
    import torch

INPUT, OUTPUT = "representation", "logits"
OPSET, IR = 17, 8
"""Old enough for every ONNX Runtime that DREAM asks for."""
MOST_BYTES = 3_000_000
AGREES = 1e-5
"""By how much, at most, the file's answers may differ from PyTorch's."""


def check_installed() -> None:
    """Raise a ValueError where what writes the file, or runs it, is not installed."""
    extras.check_installed("train", "train", "onnx", "onnxruntime")


def as_onnx(student: torch.nn.Sequential) -> bytes:
    """The student with its mirror image: (n, 2, 72, 96) float32 in [0, 1] → (n, 7) logits of `TURNS`.

    Every picture goes through the network twice, once mirrored, and the answers are averaged, the second
    with the turns to the other side; so that what is left and right can make no difference. A batch norm
    becomes part of its convolution. The same student gives the same bytes.

    Raises:
        ValueError: The file would be too large, or answers otherwise than PyTorch does; or what is needed is
            not installed.
    """
    check_installed()
    import onnx
    from onnx import helper, numpy_helper

    constants: dict[str, Any] = {
        "back": np.array([-1], np.int64),
        "far": np.array([np.iinfo(np.int64).min], np.int64),
        "columns": np.array([3], np.int64),
        "turns": np.array([1], np.int64),
        "half": np.array(0.5, np.float32),
    }
    reverse = ("back", "far")
    nodes = [
        helper.make_node("Slice", [INPUT, *reverse, "columns", "back"], ["mirrored"]),
        helper.make_node("Concat", [INPUT, "mirrored"], ["both"], axis=0),
    ]
    at = "both"
    for number, (kind, parameters) in enumerate(_layers(student)):
        names = [f"{kind.lower()}{number}_{part}" for part in ("weight", "bias")][: len(parameters)]
        constants |= dict(zip(names, parameters, strict=True))
        options: dict[str, Any] = {}
        if kind == "Conv":
            options = {"kernel_shape": [3, 3], "strides": [2, 2], "pads": [1, 1, 1, 1]}
        elif kind == "Gemm":
            options = {"transB": 1}
        nodes.append(helper.make_node(kind, [at, *names], [f"x{number}"], **options))
        at = f"x{number}"
    nodes += [
        helper.make_node("Split", [at], ["straight", "crossed"], axis=0),
        helper.make_node("Slice", ["crossed", *reverse, "turns", "back"], ["uncrossed"]),
        helper.make_node("Add", ["straight", "uncrossed"], ["sum"]),
        helper.make_node("Mul", ["sum", "half"], [OUTPUT]),
    ]
    float32 = onnx.TensorProto.FLOAT
    graph = helper.make_graph(
        nodes,
        "uivnav",
        [helper.make_tensor_value_info(INPUT, float32, ["n", PLANES, HEIGHT, WIDTH])],
        [helper.make_tensor_value_info(OUTPUT, float32, ["n", len(TURNS)])],
        [numpy_helper.from_array(values, name) for name, values in constants.items()],
    )
    model = written(graph)
    check(model, student)
    return model


def written(graph: Any) -> bytes:
    """A file with that `onnx.GraphProto`; the same graph gives the same bytes.

    Raises:
        ValueError: It would be too large.
    """
    import onnx
    from onnx import helper

    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="dream", ir_version=IR
    )
    onnx.checker.check_model(model, full_check=True)
    content: bytes = model.SerializeToString(deterministic=True)
    if len(content) > MOST_BYTES:
        raise ValueError(
            f"model: expected at most {MOST_BYTES} bytes, got {len(content)}. Take a smaller network"
        )
    return content


def check(model: bytes, student: torch.nn.Sequential) -> float:
    """By how much the file's answers differ from PyTorch's, at most; a ValueError where that is too much."""
    images = np.random.default_rng(0).integers(0, 256, (8, PLANES, HEIGHT, WIDTH), np.uint8)
    ours, theirs = (
        answers_in(model, images.astype(np.float32) / np.float32(255.0)),
        answers_of(student, images),
    )
    worst = float(np.abs(ours - theirs).max())
    if not worst <= AGREES:
        raise ValueError(
            f"model: expected the answers of PyTorch within {AGREES:g}, got {worst:g}. Did training diverge?"
        )
    return worst


def answers_in(model: bytes, pictures: Float32Array) -> Float32Array:
    """(n, 7) logits for (n, 2, 72, 96) float32 pictures, on one core."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    answers: Float32Array = session.run([OUTPUT], {INPUT: pictures})[0]
    return answers


def _layers(student: torch.nn.Sequential) -> list[tuple[str, tuple[Float32Array, ...]]]:
    """Each layer's operator with its weights, what only training needs left out."""
    nn = import_torch().nn
    layers: list[tuple[str, tuple[Float32Array, ...]]] = []
    for layer in student:
        if isinstance(layer, nn.Conv2d):
            layers.append(("Conv", (_array(layer.weight),)))
        elif isinstance(layer, nn.BatchNorm2d):
            ((weight,),) = [parameters for _, parameters in [layers.pop()]]
            scale = _array(layer.weight) / np.sqrt(_array(layer.running_var) + np.float32(layer.eps))
            bias = _array(layer.bias) - _array(layer.running_mean) * scale
            layers.append(("Conv", (weight * scale[:, None, None, None], bias)))
        elif isinstance(layer, nn.ReLU):
            layers.append(("Relu", ()))
        elif isinstance(layer, nn.Flatten):
            layers.append(("Flatten", ()))
        elif isinstance(layer, nn.Linear):
            layers.append(("Gemm", (_array(layer.weight), _array(layer.bias))))
        elif not isinstance(layer, nn.Dropout):
            raise ValueError(f"student: expected the layers of Network.build, got {type(layer).__name__}")
    return layers


def _array(tensor: Any) -> Float32Array:
    values: Float32Array = tensor.detach().cpu().numpy().astype(np.float32)
    return values
