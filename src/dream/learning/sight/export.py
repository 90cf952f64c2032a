"""The network as one ONNX file that anyone can run, written layer by layer from its table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.learning.export import check_installed, written
from dream.learning.network import import_torch
from dream.learning.sight.network import CELLS, COARSE, FAINT, Layer, LayerKind, Shape
from dream.perception.sight import DEPTH, FEATURES, GRID, HEIGHT, LABELS, PICTURE, VIEW, WIDTH
from dream.types import Float32Array, Label

if TYPE_CHECKING:
    from torch.nn import Module

AGREES = 1e-3
"""By how much, at most, the file's answers may differ from PyTorch's: scores of some tens."""


def as_onnx(shape: Shape, network: Module) -> bytes:
    """The network for one picture at a time. A batch norm becomes part of its convolution.

    Raises:
        ValueError: The file would be too large, or answers otherwise than PyTorch does; or what is needed is
            not installed.
    """
    check_installed()
    import onnx
    from onnx import helper, numpy_helper

    constants: dict[str, npt.NDArray[Any]] = {}
    kept = [layer for layer in shape.layers() if layer.name != COARSE]
    nodes = [node for layer in kept for node in _nodes(layer, network, constants, helper)]
    float32 = onnx.TensorProto.FLOAT
    sizes = {
        PICTURE: (3, HEIGHT, WIDTH),
        VIEW: (3, HEIGHT, WIDTH),
        LABELS: (len(Label), HEIGHT, WIDTH),
        DEPTH: (2, *GRID),
        FEATURES: (shape.features, *GRID),
    }
    tell = {name: helper.make_tensor_value_info(name, float32, [1, *size]) for name, size in sizes.items()}
    graph = helper.make_graph(
        nodes,
        "sight",
        [tell[PICTURE], tell[VIEW]],
        [tell[LABELS], tell[DEPTH], tell[FEATURES]],
        [numpy_helper.from_array(values, name) for name, values in constants.items()],
    )
    model = written(graph)
    check(model, network)
    return model


def _nodes(layer: Layer, network: Module, constants: dict[str, npt.NDArray[Any]], helper: Any) -> list[Any]:
    """The operators of one layer; its weights go into the constants."""
    name, inputs = layer.name, list(layer.inputs)
    if layer.operator is LayerKind.CONTRAST:
        return _contrast(layer, constants, helper)
    if layer.operator is LayerKind.GREY:
        return [helper.make_node("ReduceMean", inputs, [name], axes=[1], keepdims=1)]
    if layer.operator is LayerKind.JOIN:
        return [helper.make_node("Concat", inputs, [name], axis=1)]
    if layer.operator is LayerKind.MEAN:
        return [helper.make_node("GlobalAveragePool", inputs, [name])]
    if layer.operator is LayerKind.REPEAT:
        options = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
        constants[f"{name}_size"] = np.array([1, layer.channels, *_size(layer.like)], np.int64)
        return [helper.make_node("Resize", [*inputs, "", "", f"{name}_size"], [name], **options)]
    if layer.operator is LayerKind.SHUFFLE:
        return [helper.make_node("DepthToSpace", inputs, [name], blocksize=2, mode="CRD")]
    weight, bias = _weights(network, layer)
    constants |= {f"{name}_weight": weight, f"{name}_bias": bias}
    steps = [f"{name}_{number}" for number in range(len(layer.plus) + int(layer.rectified))]
    outputs = [*steps, name]
    pad = layer.kernel // 2
    nodes = [
        helper.make_node(
            "Conv",
            [*inputs, f"{name}_weight", f"{name}_bias"],
            [outputs[0]],
            kernel_shape=[layer.kernel] * 2,
            strides=[layer.stride] * 2,
            pads=[pad] * 4,
        )
    ]
    for number, other in enumerate(layer.plus):
        nodes.append(helper.make_node("Add", [outputs[number], other], [outputs[number + 1]]))
    if layer.rectified:
        nodes.append(helper.make_node("Relu", [outputs[-2]], [name]))
    return nodes


def _contrast(layer: Layer, constants: dict[str, npt.NDArray[Any]], helper: Any) -> list[Any]:
    """What `network.contrast` computes, of a picture of the size that is written."""
    name, (picture,), node = layer.name, layer.inputs, helper.make_node
    channels = 3 if picture == PICTURE else 1
    cells = [HEIGHT // CELLS[0], WIDTH // CELLS[1]]
    pad = layer.kernel // 2
    constants |= {
        f"{name}_size": np.array([1, channels, HEIGHT, WIDTH], np.int64),
        f"{name}_faint": np.array(FAINT, np.float32),
        f"{name}_least": np.array(FAINT**2, np.float32),
    }

    def around(of: str, to: str) -> list[Any]:
        over = {"kernel_shape": [layer.kernel] * 2, "strides": [1, 1], "pads": [pad] * 4}
        return [
            node("AveragePool", [of], [f"{to}_cells"], kernel_shape=cells, strides=cells),
            node("AveragePool", [f"{to}_cells"], [to], count_include_pad=0, **over),
        ]

    def fine(of: str, to: str) -> Any:
        options = {"mode": "linear", "coordinate_transformation_mode": "half_pixel"}
        return node("Resize", [of, "", "", f"{name}_size"], [to], **options)

    mean, square, spread = f"{name}_mean", f"{name}_square", f"{name}_spread"
    return [
        *around(picture, mean),
        node("Mul", [picture, picture], [f"{square}d"]),
        *around(f"{square}d", square),
        node("Mul", [mean, mean], [f"{mean}_squared"]),
        node("Sub", [square, f"{mean}_squared"], [f"{spread}_squared"]),
        node("Max", [f"{spread}_squared", f"{name}_least"], [f"{spread}_raised"]),
        node("Sqrt", [f"{spread}_raised"], [spread]),
        node("Add", [spread, f"{name}_faint"], [f"{name}_over"]),
        node("Reciprocal", [f"{name}_over"], [f"{name}_gain"]),
        fine(mean, f"{name}_mean_there"),
        fine(f"{name}_gain", f"{name}_gain_there"),
        node("Sub", [picture, f"{name}_mean_there"], [f"{name}_differs"]),
        node("Mul", [f"{name}_differs", f"{name}_gain_there"], [name]),
    ]


def _size(name: str) -> tuple[int, int]:
    """Rows and columns of what the encoder's layer of that name gives."""
    halved = 2 ** int(name.removeprefix("e"))
    return -(-HEIGHT // halved), -(-WIDTH // halved)


def _weights(network: Module, layer: Layer) -> tuple[Float32Array, Float32Array]:
    """Of a convolution, with its batch norm in them."""
    part = network.parts[layer.name]
    weight = _array(part[0].weight)
    if not layer.normed:
        return weight, _array(part[0].bias)
    norm = part[1]
    scale = _array(norm.weight) / np.sqrt(_array(norm.running_var) + np.float32(norm.eps))
    return weight * scale[:, None, None, None], _array(norm.bias) - _array(norm.running_mean) * scale


def _array(tensor: Any) -> Float32Array:
    values: Float32Array = tensor.detach().cpu().numpy().astype(np.float32)
    return values


def check(model: bytes, network: Module) -> float:
    """By how much the file's answers differ from PyTorch's, at most; a ValueError where that is too much."""
    import onnxruntime

    torch, rng = import_torch(), np.random.default_rng(0)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    worst = 0.0
    network.eval()
    for _ in range(3):
        picture = rng.random((1, 3, HEIGHT, WIDTH), np.float32)
        view = rng.random((1, 3, HEIGHT, WIDTH), np.float32) - np.float32(0.5)
        ours = session.run([LABELS, DEPTH, FEATURES], {PICTURE: picture, VIEW: view})
        with torch.inference_mode():
            theirs = network(torch.from_numpy(picture), torch.from_numpy(view))
        worst = max(
            worst,
            *(
                float(np.abs(one - theirs[name].numpy()).max())
                for one, name in zip(ours, (LABELS, DEPTH, FEATURES), strict=True)
            ),
        )
    if not worst <= AGREES:
        raise ValueError(
            f"model: expected the answers of PyTorch within {AGREES:g}, got {worst:g}. Did training diverge?"
        )
    return worst
