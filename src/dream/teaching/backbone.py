"""A network in an ONNX file → its graph from one picture to a grid of features, and nothing else of it.

Two kinds are known: the network that comes with DREAM, whose view of the floor is then unknown; and any
network with one picture in, and features out as a grid (1, C, h, w) or as tokens (1, N, C), such as those of
DINOv2 and DINOv3.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dream import extras
from dream.perception.onnx import checked_bytes
from dream.perception.sidecar import Above, Finite, Side
from dream.perception.sight import FEATURES, PICTURE, SHIPPED, VIEW, file_sha256

TEXTURE = "texture"
"""In the place of a file: no network, colours and textures alone."""
LEAST_OPSET = 11
"""Of a network that nodes are put behind."""
MOST_TEXT = 1 << 16
"""Bytes of the file beside a network."""
MOST_FEATURES = 2_000_000
"""Of a picture, all cells together: those of every picture that is shown are kept, 4 bytes each."""
LEAST_SIDE = 4
"""Cells along a side of a grid."""
PATCHES = (14, 16, 8, 32, 4)
"""Pixels along a side of a token's patch, those of DINOv2 and DINOv3 first."""
MOST_OTHERS = 64
"""Tokens before those of the patches: class and registers."""
TOKEN_SIZE = 336, 448
"""Height and width at which a network of tokens gets a picture where nothing says so: multiples of 14 and of
16, with the proportions of a camera's picture."""
IMAGENET = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Mean and spread of the pictures that such networks were trained on."""
TEXTURE_SIZE, TEXTURE_GRID = (240, 320), (60, 80)


class BackboneCard(BaseModel):
    """What is to be known of a network: `backbone.json` beside `backbone.onnx`. All of it may be left out.

    The picture is x = (scale · rgb − mean) / std, channel by channel, as in a `Sidecar`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    output: Annotated[str, Field(max_length=200)] | None = None
    """Name of the features; else `features`, `last_hidden_state`, or the first of 3 or 4 dimensions."""
    height: Side | None = None
    """Pixels of the input, where the network leaves it open."""
    width: Side | None = None
    scale: Above = 1.0 / 255.0
    mean: tuple[Finite, Finite, Finite] | None = None
    """Of red, green and blue; that of ImageNet for tokens, 0 for a grid, where None."""
    std: tuple[Above, Above, Above] | None = None
    patch: Annotated[int, Field(ge=1, le=128)] | None = None
    """Pixels along a side of a token's patch, where several would do."""
    features: Literal["grid", "tokens"] | None = None
    """Told by the number of dimensions where None."""


@dataclass(frozen=True, slots=True)
class Backbone:
    """A graph from a picture to features, and how the picture has to be."""

    name: str
    """Of its file, for people."""
    sha256: str
    """Of its file; empty for `TEXTURE`."""
    model: Any
    """`onnx.ModelProto` with one input (1, 3, H, W) float32, and features (1, C, h, w) where it has any."""
    input: str
    """Name of that input."""
    output: str | None
    """Name of the features; None for `TEXTURE`."""
    size: tuple[int, int]
    """Height and width of the input, pixels."""
    grid: tuple[int, int]
    """Rows and columns of cells."""
    channels: int
    """Features of a cell; 0 for `TEXTURE`."""
    scale: float
    mean: tuple[float, float, float]
    std: tuple[float, float, float]


def open_backbone(path: Path | None) -> Backbone:
    """The backbone in a file; the network that comes with DREAM where None, none for `TEXTURE`.

    Raises:
        ValueError: It is refused, with the reason and what to do.
    """
    extras.check_installed("teach", "teach", "onnx", "onnxruntime")
    if path is not None and str(path) == TEXTURE:
        return _texture()
    path = SHIPPED if path is None else path
    content, found = checked_bytes(path)
    version = found.opsets.get("", 0)
    if version < LEAST_OPSET:
        raise ValueError(f"--backbone: expected opset {LEAST_OPSET} or later, got {version}. Export it again")
    import onnx

    try:
        model = onnx.load_model_from_string(content)
    except Exception as error:
        raise ValueError(f"--backbone: expected an ONNX model, got {path} ({str(error)[:200]})") from error
    card = read_card(path.with_suffix(".json")) if path != SHIPPED else BackboneCard()
    given = {one.name for one in model.graph.initializer}
    inputs = {one.name: one for one in model.graph.input if one.name not in given}
    outputs = [one.name for one in model.graph.output]
    sight = set(inputs) == {PICTURE, VIEW} and FEATURES in outputs
    if not sight and len(inputs) != 1:
        raise ValueError(
            f"--backbone: expected one input, a picture, got {', '.join(inputs)[:200] or 'none'}. "
            "Export it with a single picture as its input"
        )
    name = PICTURE if sight else next(iter(inputs))
    output = FEATURES if sight and card.output is None else _output_of(model, card)
    tokens = _is_tokens(model, output, card)
    size = _size_of(inputs[name], card, tokens)
    default_mean, default_std = IMAGENET if tokens else ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    mean, std = card.mean or default_mean, card.std or default_std
    _cut(model, inputs[name], output, size, VIEW if sight else None)
    shape = _answered(model, name, size)
    if tokens:
        output, shape = _as_grid(model, output, shape, size, card)
    channels, rows, cols = _checked(shape, size)
    return Backbone(
        name=path.name,
        sha256=file_sha256(path),
        model=model,
        input=name,
        output=output,
        size=size,
        grid=(rows, cols),
        channels=channels,
        scale=card.scale,
        mean=mean,
        std=std,
    )


def read_card(path: Path) -> BackboneCard:
    """The card in a file; an empty one where there is none.

    Raises:
        ValueError: It cannot be read, or does not say what a card may.
    """
    if not path.is_file():
        return BackboneCard()
    try:
        with path.open("rb") as file:
            text = file.read(MOST_TEXT + 1)
        if len(text) > MOST_TEXT:
            raise ValueError(f"expected at most {MOST_TEXT} bytes")
        return BackboneCard.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "all of it"
        raise ValueError(f"{path}: {where[:100]}: {first['msg'][:200]}") from error
    except (OSError, ValueError) as error:
        raise ValueError(f"{path}: expected a card of a backbone ({str(error)[:200]})") from error


def _texture() -> Backbone:
    from onnx import TensorProto, helper

    picture = helper.make_tensor_value_info(PICTURE, TensorProto.FLOAT, [1, 3, *TEXTURE_SIZE])
    graph = helper.make_graph([], TEXTURE, [picture], [])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return Backbone(
        name=TEXTURE,
        sha256="",
        model=model,
        input=PICTURE,
        output=None,
        size=TEXTURE_SIZE,
        grid=TEXTURE_GRID,
        channels=0,
        scale=1.0 / 255.0,
        mean=(0.0, 0.0, 0.0),
        std=(1.0, 1.0, 1.0),
    )


def _output_of(model: Any, card: BackboneCard) -> str:
    outputs = {one.name: len(one.type.tensor_type.shape.dim) for one in model.graph.output}
    if card.output is not None:
        if card.output not in outputs:
            raise ValueError(f"output: expected one of {', '.join(outputs)[:200]}, got {card.output}")
        return card.output
    name: str
    for name in (FEATURES, "last_hidden_state", *outputs):
        if outputs.get(name) in (3, 4):
            return name
    raise ValueError(
        "--backbone: expected an output (1, C, h, w) or (1, N, C), got "
        f"{', '.join(f'{name} of {count} dimensions' for name, count in outputs.items())[:200]}"
    )


def _is_tokens(model: Any, output: str, card: BackboneCard) -> bool:
    if card.features is not None:
        return card.features == "tokens"
    found = next(one for one in model.graph.output if one.name == output)
    return len(found.type.tensor_type.shape.dim) == 3


def _size_of(picture: Any, card: BackboneCard, tokens: bool) -> tuple[int, int]:
    """Height and width of the input: what the file says, else its card, else what suits tokens."""
    told = picture.type.tensor_type
    lengths = [dim.dim_value if dim.HasField("dim_value") else None for dim in told.shape.dim]
    if told.elem_type != 1 or len(lengths) != 4 or lengths[0] not in (1, None) or lengths[1] not in (3, None):
        raise ValueError(
            f"--backbone: expected a picture (1, 3, H, W) of float32, got {lengths} of kind {told.elem_type}"
        )
    sides = []
    for said, wanted, usual, name in zip(
        lengths[2:], (card.height, card.width), TOKEN_SIZE, ("height", "width"), strict=True
    ):
        side = said or wanted or (usual if tokens else None)
        if side is None:
            raise ValueError(f"{name}: the network takes any; expected it in a file beside it, got none")
        if said and wanted and said != wanted:
            raise ValueError(f"{name}: the network takes {said}, but the file beside it says {wanted}")
        if not 32 <= side <= 2048:
            raise ValueError(f"{name}: expected 32 to 2048 pixels, got {side}")
        sides.append(side)
    return sides[0], sides[1]


def _cut(model: Any, picture: Any, output: str, size: tuple[int, int], unknown: str | None) -> None:
    """Leave of a graph what leads from a picture of that size to one output; an unknown input is all 0."""
    from onnx import TensorProto, helper, numpy_helper

    graph = model.graph
    needed, kept = {output}, []
    for node in reversed(graph.node):
        if needed.isdisjoint(node.output):
            continue
        kept.append(node)
        needed |= _taken(node)
    weights = [one for one in graph.initializer if one.name in needed]
    nodes = list(reversed(kept))
    if unknown is not None:
        shape = f"{unknown}_shape"
        weights.append(numpy_helper.from_array(np.array([1, 3, *size], np.int64), shape))
        nodes.insert(0, helper.make_node("ConstantOfShape", [shape], [unknown]))
    whole = helper.make_tensor_value_info(picture.name, TensorProto.FLOAT, [1, 3, *size])
    found = helper.make_empty_tensor_value_info(output)
    found.type.tensor_type.elem_type = TensorProto.FLOAT
    for field, content in (
        (graph.node, nodes),
        (graph.initializer, weights),
        (graph.input, [whole]),
        (graph.output, [found]),
        (graph.value_info, []),
    ):
        content = list(content)
        del field[:]
        field.extend(content)
    del model.metadata_props[:]


def _taken(node: Any) -> set[str]:
    """Names that a node reads, those that graphs within it read from outside included."""
    taken = set(node.input)
    for attribute in node.attribute:
        for inner in [attribute.g, *attribute.graphs]:
            for one in inner.node:
                taken |= _taken(one)
    return taken


def _answered(model: Any, name: str, size: tuple[int, int]) -> tuple[int, ...]:
    """Shape of what the graph answers to a grey picture."""
    session = open_session(model.SerializeToString())
    try:
        (answer,) = session.run(None, {name: np.zeros((1, 3, *size), np.float32)})
    except Exception as error:
        first = (str(error).splitlines() or [""])[0]
        raise ValueError(f"--backbone: it fails on a picture of {size}: {first[:300]}") from error
    if not isinstance(answer, np.ndarray) or answer.dtype != np.float32:
        raise ValueError(
            f"--backbone: expected features of float32, got {getattr(answer, 'dtype', 'no array')}"
        )
    return tuple(answer.shape)


def open_session(content: bytes) -> Any:
    """An `onnxruntime.InferenceSession` of a model's bytes, on one core.

    Raises:
        ValueError: ONNX Runtime refuses it.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        first = (str(error).splitlines() or [""])[0]
        raise ValueError(f"--backbone: ONNX Runtime refuses it: {first[:300]}") from error


def _as_grid(
    model: Any, output: str, shape: tuple[int, ...], size: tuple[int, int], card: BackboneCard
) -> tuple[str, tuple[int, ...]]:
    """Put tokens (1, N, C) into their grid, without those of class and registers; its name and shape."""
    from onnx import TensorProto, helper, numpy_helper

    if len(shape) != 3 or shape[0] != 1:
        raise ValueError(f"--backbone: expected tokens (1, N, C), got {shape}")
    for patch in (card.patch,) if card.patch is not None else PATCHES:
        rows, cols = size[0] // patch, size[1] // patch
        others = shape[1] - rows * cols
        if not (size[0] % patch or size[1] % patch) and 0 <= others <= MOST_OTHERS:
            break
    else:
        raise ValueError(
            f"--backbone: {shape[1]} tokens for a picture of {size[0]} x {size[1]} fit no patches of "
            f"{card.patch or ', '.join(map(str, PATCHES))} pixels. "
            'Write "patch", "height" and "width" into a file beside it'
        )
    graph, channels = model.graph, shape[2]
    for name, values in (
        ("first", [others]),
        ("end", [np.iinfo(np.int64).max]),
        ("axis", [1]),
        ("grid", [1, channels, rows, cols]),
    ):
        graph.initializer.append(numpy_helper.from_array(np.array(values, np.int64), f"teach/{name}"))
    graph.node.extend(
        [
            helper.make_node("Slice", [output, "teach/first", "teach/end", "teach/axis"], ["teach/patches"]),
            helper.make_node("Transpose", ["teach/patches"], ["teach/turned"], perm=[0, 2, 1]),
            helper.make_node("Reshape", ["teach/turned", "teach/grid"], ["teach/features"]),
        ]
    )
    found = (1, channels, rows, cols)
    del graph.output[:]
    graph.output.append(helper.make_tensor_value_info("teach/features", TensorProto.FLOAT, found))
    return "teach/features", found


def _checked(shape: tuple[int, ...], size: tuple[int, int]) -> tuple[int, int, int]:
    """Channels, rows and columns of a grid (1, C, h, w), each of whose cells is a whole number of pixels."""
    if len(shape) != 4 or shape[0] != 1:
        raise ValueError(f"--backbone: expected features (1, C, h, w), got {shape}")
    channels, rows, cols = shape[1:]
    if min(rows, cols) < LEAST_SIDE or not 1 <= channels * rows * cols <= MOST_FEATURES:
        raise ValueError(
            f"--backbone: expected at least {LEAST_SIDE} cells a side and {MOST_FEATURES} features in all at "
            f"most, got {channels} in each of {rows} x {cols}. Choose another height and width"
        )
    if size[0] % rows or size[1] % cols:
        raise ValueError(
            f"--backbone: expected cells of whole pixels, got {rows} x {cols} for {size[0]} x {size[1]}. "
            "Choose another height and width"
        )
    return channels, rows, cols
