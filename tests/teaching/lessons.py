"""Pictures that anyone could label, marks on them, and tiny backbones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from PIL import Image
from scipy import ndimage

from dream.perception.sight import FEATURES, PICTURE, VIEW
from dream.teaching.backbone import TEXTURE, open_backbone
from dream.teaching.marks import OTHER, TARGET, UNMARKED
from dream.teaching.model import Extractor
from dream.types import BoolArray, UInt8Array

SIZE = 240, 320
OPSET = 17


def scene(number: int, size: tuple[int, int] = SIZE) -> tuple[UInt8Array, BoolArray]:
    """A picture of rough, reddish discs before smooth blue water, and where they are."""
    rng = np.random.default_rng(number)
    rows, cols = np.mgrid[: size[0], : size[1]]
    inside = np.zeros(size, np.bool_)
    for _ in range(3):
        y, x = rng.uniform(0.2, 0.8) * size[0], rng.uniform(0.2, 0.8) * size[1]
        inside |= np.hypot(rows - y, cols - x) < rng.uniform(0.1, 0.16) * size[1]
    water = np.array([20.0, 90.0, 130.0]) * rng.uniform(0.7, 1.3) + 10.0 * (rows / size[0])[..., None]
    coarse = rng.normal(size=(size[0] // 4 + 1, size[1] // 4 + 1))
    rough = np.kron(coarse, np.ones((4, 4)))[: size[0], : size[1], None]
    shell = np.array([150.0, 80.0, 60.0]) + 40.0 * rough
    rgb = np.where(inside[..., None], shell, water) + rng.normal(size=(*size, 3)) * 2.0
    return np.clip(rgb, 0, 255).astype(np.uint8), inside


def strokes(inside: BoolArray) -> UInt8Array:
    """Marks as a person makes them: a part of what is target, and a part of what is not."""
    marks = np.full(inside.shape, UNMARKED, np.uint8)
    deep = ndimage.binary_erosion(inside, iterations=8)
    far = ~ndimage.binary_dilation(inside, iterations=8)
    band = (np.arange(inside.shape[0]) % 40 < 14)[:, None]
    marks[deep & band], marks[far & band] = TARGET, OTHER
    return marks


def save_picture(path: Path, rgb: UInt8Array) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(rgb).save(path)
    return path


def save_masks(folder: Path, numbers: list[int], marked: list[int]) -> tuple[Path, Path]:
    """A folder of pictures, and one of marks as some program paints them."""
    photos, masks = folder / "photos", folder / "masks"
    masks.mkdir(parents=True)
    for n in numbers:
        rgb, inside = scene(n)
        save_picture(photos / f"p{n}.png", rgb)
        if n in marked:
            levels = np.array([128, 255, 0], np.uint8)
            Image.fromarray(levels[strokes(inside)]).save(masks / f"p{n}.png")
    return photos, masks


def texture() -> Extractor:
    return Extractor(open_backbone(Path(TEXTURE)))


def _saved(
    path: Path,
    nodes: list[onnx.NodeProto],
    weights: dict[str, np.ndarray],
    inputs: dict[str, list[int | str]],
    outputs: dict[str, list[int | str]],
    opset: int = OPSET,
) -> Path:
    tensors = [
        numpy_helper.from_array(value if value.dtype.kind == "i" else value.astype(np.float32), name)
        for name, value in weights.items()
    ]
    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in inputs.items()],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name, shape in outputs.items()],
        tensors,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def save_sight(path: Path, channels: int = 6) -> Path:
    """As the network that comes with DREAM: a picture and a view in; labels, depth and features out."""
    rng = np.random.default_rng(0)
    nodes = [
        helper.make_node("Concat", [PICTURE, VIEW], ["both"], axis=1),
        helper.make_node("Conv", ["both", "w"], ["rough"], kernel_shape=[4, 4], strides=[4, 4]),
        helper.make_node("Relu", ["rough"], [FEATURES]),
        helper.make_node("Conv", [FEATURES, "d"], ["depth"]),
        helper.make_node("Conv", ["both", "l"], ["labels"]),
    ]
    weights = {
        "w": rng.normal(size=(channels, 6, 4, 4)),
        "d": rng.normal(size=(2, channels, 1, 1)),
        "l": rng.normal(size=(4, 6, 1, 1)),
    }
    whole: list[int | str] = ["n", 3, *SIZE]
    return _saved(
        path,
        nodes,
        weights,
        {PICTURE: whole, VIEW: whole},
        {"labels": ["n", 4, *SIZE], "depth": ["n", 2, 60, 80], FEATURES: ["n", channels, 60, 80]},
    )


def save_tokens(path: Path, patch: int = 14, others: int = 1, channels: int = 8, opset: int = OPSET) -> Path:
    """As DINOv2 and DINOv3: patches as tokens, behind those of class and registers, at any size."""
    rng = np.random.default_rng(1)
    nodes = [
        helper.make_node(
            "Conv", ["pixel_values", "w"], ["grid"], kernel_shape=[patch, patch], strides=[patch, patch]
        ),
        helper.make_node("Reshape", ["grid", "flat"], ["turned"]),
        helper.make_node("Transpose", ["turned"], ["patches"], perm=[0, 2, 1]),
        helper.make_node("Concat", ["first", "patches"], ["last_hidden_state"], axis=1),
    ]
    weights = {
        "w": rng.normal(size=(channels, 3, patch, patch)) / patch,
        "flat": np.array([1, channels, -1], np.int64),
        "first": rng.normal(size=(1, others, channels)) * 100.0,
    }
    return _saved(
        path,
        nodes,
        weights,
        {"pixel_values": ["batch", 3, "height", "width"]},
        {"last_hidden_state": ["batch", "tokens", channels]},
        opset,
    )
