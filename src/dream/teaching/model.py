"""A backbone → the features of a picture's cells; and with a head behind it, a model that labels a target.

Beside the backbone's own features a cell has colour and texture: brightness, two hues, and the strength of
edges in ten kinds, each of the cell itself and of its neighbourhood. All of these are relative to the
picture's mean, in logarithms: what water takes away from all of a picture then changes nothing.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.files import write_whole
from dream.perception.outputs import Form, labelled
from dream.perception.placing import Frame, picture, placed
from dream.perception.sidecar import Sidecar
from dream.teaching.backbone import Backbone, open_session
from dream.types import Float32Array, Label, UInt8Array

CELLS, LOGITS = "teach/cells", "target"
"""Names of what the extractor and the taught model put out."""
DARK = 0.05
"""Of full brightness: what is darker has no colour worth telling."""
FLAT = 0.01
"""Edges of that strength, in logarithms of brightness, are noise."""
AROUND = 12
"""A neighbourhood is a square of a 12th of the grid's rows, at least of 3 cells."""
NEVER_MORE = np.float32(1e4)
"""Of a feature, whatever a backbone says: beyond it, it says nothing."""

_EDGES = np.array(
    [
        [[0, 0, 0], [-1, 0, 1], [0, 0, 0]],
        [[0, -1, 0], [0, 0, 0], [0, 1, 0]],
        [[-0.7, 0, 0], [0, 0, 0], [0, 0, 0.7]],
        [[0, 0, -0.7], [0, 0, 0], [0.7, 0, 0]],
        [[0, -1, 0], [-1, 4, -1], [0, -1, 0]],
    ],
    np.float32,
)
"""Differences across, down and along both diagonals, and from the four neighbours."""


@dataclass(frozen=True, slots=True, eq=False)
class Head:
    """What is taught: logit = weights · cell + bias."""

    weights: npt.NDArray[np.float64]
    """(C,), for features as they come."""
    bias: float

    def logits(self, cells: Float32Array) -> Float32Array:
        """(1, h, w) of the target, for cells (C, h, w)."""
        flat = cells.reshape(len(cells), -1)
        found = self.weights.astype(np.float32) @ flat + np.float32(self.bias)
        return found.reshape(1, *cells.shape[1:]).astype(np.float32)


class Extractor:
    """Picture → features of its cells, by the graph that the taught model has before its head."""

    def __init__(self, backbone: Backbone) -> None:
        """Of that backbone."""
        self.backbone = backbone
        self.graph = _extractor(backbone)
        """`onnx.ModelProto`, (1, 3, H, W) → (1, C, h, w)."""
        self._session = open_session(self.graph.SerializeToString())
        self._sidecar = sidecar_of(backbone, "target")

    def cells(self, rgb: UInt8Array) -> Float32Array:
        """(C, h, w) of a picture (H, W, 3).

        Raises:
            ValueError: The backbone's answer is not finite.
        """
        x = picture(rgb, self.frame(rgb.shape), self._sidecar)
        (cells,) = self._session.run(None, {self.backbone.input: x})
        if not np.isfinite(cells).all():
            raise ValueError("--backbone: expected finite features, got others for a picture")
        found: Float32Array = cells[0]
        return found

    def frame(self, shape: tuple[int, ...]) -> Frame:
        """Where a picture of that shape lies in the network's input."""
        return placed(shape, *self.backbone.size, letterbox=False)

    def target(self, logits: Float32Array, frame: Frame, shape: tuple[int, int]) -> npt.NDArray[np.bool_]:
        """(H, W) whether a pixel is target by logits (1, h, w), as `LearnedLabels` has it."""
        labels, _, _ = labelled(logits[None], Form.SINGLE_SCORES, self._sidecar, frame, shape)
        return np.asarray(labels == Label.TARGET)


def sidecar_of(backbone: Backbone, name: str) -> Sidecar:
    """What a model that is taught on a backbone wants and says; `name` is that of its one class."""
    return Sidecar.model_validate(
        {
            "output": "logits",
            "exclusive": False,
            "height": backbone.size[0],
            "width": backbone.size[1],
            "scale": backbone.scale,
            "mean": backbone.mean,
            "std": backbone.std,
            "classes": {name: "target"},
            "name": LOGITS,
        }
    )


def taught_model(extractor: Extractor, head: Head) -> bytes:
    """The extractor with the head behind it: a picture in, (1, 1, h, w) logits of the target out."""
    from onnx import TensorProto, helper, numpy_helper

    model = copy.deepcopy(extractor.graph)
    graph = model.graph
    weights = head.weights.astype(np.float32).reshape(1, -1, 1, 1)
    for name, values in (("weights", weights), ("bias", np.array([head.bias], np.float32))):
        graph.initializer.append(numpy_helper.from_array(values, f"teach/{name}"))
    graph.node.append(helper.make_node("Conv", [CELLS, "teach/weights", "teach/bias"], [LOGITS]))
    del graph.output[:]
    shape = [1, 1, *extractor.backbone.grid]
    graph.output.append(helper.make_tensor_value_info(LOGITS, TensorProto.FLOAT, shape))
    model.producer_name = "dream"
    written: bytes = model.SerializeToString(deterministic=True)
    return written


def save(path: Path, extractor: Extractor, head: Head, name: str, card: Mapping[str, Any]) -> None:
    """Write a model, its sidecar and its card, each whole or not at all; and see that the model opens.

    Args:
        path: Of the .onnx file; `.json` and `.card.json` come beside it.
        extractor: That the head was taught on.
        head: What was taught.
        name: Of the class.
        card: What there is to say of how it was taught.

    Raises:
        OSError: It could not be written.
        ValueError: The model does not open.
    """
    from dream.perception.learned import LearnedLabels

    path.parent.mkdir(parents=True, exist_ok=True)
    sidecar = sidecar_of(extractor.backbone, name)
    # A sidecar of another model beside this one would be wrong, even for a moment.
    path.with_suffix(".json").unlink(missing_ok=True)
    write_whole(path, taught_model(extractor, head))
    write_whole(path.with_suffix(".json"), _json(sidecar.model_dump(exclude_none=True)))
    write_whole(path.with_suffix(".card.json"), _json(card))
    LearnedLabels(path)


def _json(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def _extractor(backbone: Backbone) -> Any:
    """The backbone's graph with colour and texture beside its features: (1, 3, H, W) → (1, C, h, w)."""
    from onnx import TensorProto, helper, numpy_helper

    model = copy.deepcopy(backbone.model)
    graph = model.graph
    rows, cols = backbone.grid
    high, wide = backbone.size[0] // rows, backbone.size[1] // cols
    build = _Building(graph, helper, numpy_helper)
    full = backbone.scale * 255.0
    per_channel = np.array(backbone.std, np.float32) / full, np.array(backbone.mean, np.float32) / full
    factor, offset = (values.astype(np.float32).reshape(1, 3, 1, 1) for values in per_channel)
    bright = build("Mul", backbone.input, build.constant(factor))
    bright = build("Log", build("Add", bright, build.constant(offset + np.float32(DARK))))
    mean = np.full(3, 1.0 / 3.0, np.float32)
    hues = np.stack([mean, np.array([1, 0, 0], np.float32) - mean, np.array([0, 1, 0], np.float32) - mean])
    tones = build("Conv", bright, build.constant(hues.reshape(3, 3, 1, 1)))
    light = build("Conv", bright, build.constant(mean.reshape(1, 3, 1, 1)))
    parts = [build.pooled(tones, high, wide), build.edges(light, high, wide)]
    if high % 2 == 0 and wide % 2 == 0:
        parts.append(build.edges(build.pooled(light, 2, 2), high // 2, wide // 2))
    near = build("Concat", *parts, axis=1)
    # An odd one lies evenly around its cell.
    both = build("Concat", near, build.around(near, max(rows // AROUND, 3) | 1), axis=1)
    relative = build("Sub", both, build("GlobalAveragePool", both))
    if backbone.output is None:
        build("Identity", relative, output=CELLS)
    else:
        top = build.constant(np.array(NEVER_MORE, np.float32))
        bottom = build.constant(np.array(-NEVER_MORE, np.float32))
        kept = build("Max", build("Min", backbone.output, top), bottom)
        build("Concat", kept, relative, axis=1, output=CELLS)
    del graph.output[:]
    found = helper.make_empty_tensor_value_info(CELLS)
    found.type.tensor_type.elem_type = TensorProto.FLOAT
    graph.output.append(found)
    return model


class _Building:
    """Adds nodes to a graph, all of operators that mean the same from opset 11 on."""

    def __init__(self, graph: Any, helper: Any, numpy_helper: Any) -> None:
        self._graph, self._helper, self._numpy = graph, helper, numpy_helper
        self._count = 0

    def __call__(self, operator: str, *inputs: str, output: str | None = None, **options: Any) -> str:
        name = output or self._name()
        self._graph.node.append(self._helper.make_node(operator, list(inputs), [name], **options))
        return name

    def constant(self, values: npt.NDArray[Any]) -> str:
        name = self._name()
        self._graph.initializer.append(self._numpy.from_array(values, name))
        return name

    def pooled(self, of: str, high: int, wide: int) -> str:
        """Means over blocks of pixels."""
        return self("AveragePool", of, kernel_shape=[high, wide], strides=[high, wide])

    def around(self, of: str, side: int) -> str:
        """Means over the square of so many cells around each, or what of it lies in the picture."""
        half = side // 2
        across = self("AveragePool", of, kernel_shape=[1, side], pads=[0, half, 0, half])
        return self("AveragePool", across, kernel_shape=[side, 1], pads=[half, 0, half, 0])

    def edges(self, of: str, high: int, wide: int) -> str:
        """Logarithm of the mean strength of edges in blocks of pixels, kind by kind."""
        around = self.constant(np.array([0, 0, 1, 1, 0, 0, 1, 1], np.int64))
        padded = self("Pad", of, around, mode="edge")
        found = self("Abs", self("Conv", padded, self.constant(_EDGES[:, None])))
        strength = self("Add", self.pooled(found, high, wide), self.constant(np.array(FLAT, np.float32)))
        return self("Log", strength)

    def _name(self) -> str:
        self._count += 1
        return f"teach/{self._count}"
