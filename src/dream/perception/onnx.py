"""A neural network from a file that someone else made: checked, then run on the CPU by ONNX Runtime.

The file is looked through before ONNX Runtime sees it. That keeps out what is damaged, mistaken or reaches
for other files; a graph may still ask for more time or memory than there is, so take models only from where
you would take a program.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream import extras

MOST_BYTES = 256 << 20
"""Of a file. The large segmentation and depth models for one frame a second have 100 to 200 MB."""
MOST_FIELDS = 4_000_000
"""Fields of the file's protocol buffer; more are no model of that size."""
DEEPEST = 12
"""Graphs within nodes within graphs."""
OPSETS = (7, 30)
"""Versions of the standard operators; ONNX Runtime says itself where it does not know one of these."""
DOMAINS = ("", "ai.onnx", "ai.onnx.ml", "com.microsoft")
"""Operators of other makers would need a library of theirs."""
MOST_SIDE = 2048
"""Pixels along a side of a network's input."""
MOST_VALUES = 1 << 28
"""Numbers in one output."""
MOST_NAME = 200
"""Bytes of a name in the file that are looked at."""
KINDS: dict[str, npt.DTypeLike] = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
}
"""Types that a picture may be wanted in."""
PASSING = frozenset(
    {"Cast", "CastLike", "DequantizeLinear", "Dropout", "Flatten", "Identity", "QuantizeLinear", "Reshape"}
    | {"Resize", "Slice", "Squeeze", "Transpose", "Unsqueeze", "Upsample"}
)
"""Operators that change nothing of what an output's numbers mean."""


@dataclass(frozen=True, slots=True)
class Contents:
    """What a model's file says of itself."""

    opsets: Mapping[str, int]
    """Version by domain; the standard operators have the domain ''."""
    external: int
    """Tensors whose numbers lie in other files."""
    nodes: int
    makers: Mapping[str, tuple[str, str]]
    """By what the nodes of the graph put out: operator, and the first thing it takes in."""

    def operator(self, output: str) -> str:
        """The operator whose numbers an output holds, seen through those that change nothing of them.

        Empty where no node of the graph makes it.
        """
        operator = ""
        for _ in range(len(self.makers)):
            operator, output = self.makers.get(output, ("", ""))
            if operator not in PASSING:
                break
        return operator


# The messages that lead to a tensor, and the numbers of the fields that do (onnx.proto, IR version 10).
_INSIDE: dict[str, dict[int, str]] = {
    "model": {7: "graph", 8: "opset", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 9: "opset", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
}


def contents(model: bytes) -> Contents:
    """What a serialised `onnx.ModelProto` holds, without decoding its weights.

    Raises:
        ValueError: It is no protocol buffer, or none of such a model.
    """
    opsets: dict[str, int] = {}
    counts = {"external": 0, "nodes": 0, "fields": 0, "graphs": 0}
    makers: dict[str, tuple[str, str]] = {}

    def look(part: memoryview, kind: str, depth: int) -> None:
        if depth > 4 * DEEPEST:
            raise ValueError(f"model: expected at most {DEEPEST} graphs within each other")
        counts["nodes"] += kind == "node"
        counts["graphs"] += kind == "graph"
        domain, version, elsewhere = "", 0, False
        taken, made, operator = "", [], ""
        for number, value in _fields(part, counts):
            inside = _INSIDE.get(kind, {}).get(number)
            if inside is not None:
                if not isinstance(value, memoryview):
                    raise ValueError(
                        f"model: expected a message in field {number} of a {kind}. Is it damaged?"
                    )
                look(value, inside, depth + 1)
            elif kind == "opset":
                if number == 1 and isinstance(value, memoryview):
                    domain = _name(value)
                elif number == 2 and isinstance(value, int):
                    version = value
            elif kind == "node" and isinstance(value, memoryview):
                if number == 1:
                    taken = taken or _name(value)
                elif number == 2:
                    made.append(_name(value))
                elif number == 4:
                    operator = _name(value)
            elif kind == "tensor" and (number == 13 or (number == 14 and value == 1)):
                elsewhere = True
        counts["external"] += elsewhere
        if kind == "node":
            # The names of inner graphs and functions are no outputs of the model.
            makers.update((name, (operator, taken)) for name in made if depth == 2)
        if kind == "opset":
            opsets["" if domain == "ai.onnx" else domain] = version

    look(memoryview(model), "model", 0)
    if counts["graphs"] == 0 or not opsets:
        raise ValueError("model: expected a graph and its opset, found none. Is it an ONNX file?")
    return Contents(opsets, counts["external"], counts["nodes"], makers)


def _name(value: memoryview) -> str:
    return bytes(value[:MOST_NAME]).decode("utf-8", "replace")


def _fields(part: memoryview, counts: dict[str, int]) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of every field of a protocol buffer message; fixed-width values are left out."""
    at, end = 0, len(part)
    while at < end:
        counts["fields"] += 1
        if counts["fields"] > MOST_FIELDS:
            raise ValueError(f"model: expected at most {MOST_FIELDS} fields")
        key, at = _varint(part, at)
        number, wire = key >> 3, key & 7
        if number == 0:
            raise ValueError("model: expected field numbers from 1, got 0. Is it an ONNX file?")
        if wire == 0:
            value, at = _varint(part, at)
            yield number, value
            continue
        if wire == 2:
            length, at = _varint(part, at)
        elif wire in (1, 5):
            length = 8 if wire == 1 else 4
        else:
            raise ValueError(f"model: wire type {wire} is not of ONNX. Is it an ONNX file?")
        if length > end - at:
            raise ValueError(f"model: ends {length - (end - at)} bytes too soon. Is it truncated?")
        if wire == 2:
            yield number, part[at : at + length]
        at += length


def _varint(part: memoryview, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(part):
            raise ValueError("model: ends in the middle of a number. Is it truncated?")
        byte = part[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("model: a number has more than 10 bytes. Is it an ONNX file?")


def checked_bytes(
    path: str | Path, *, most: int | None = None, sha256: str | None = None
) -> tuple[bytes, Contents]:
    """The file's bytes and what they hold, if it is a model that may be run.

    Args:
        path: Of the model.
        most: Bytes at most; `MOST_BYTES` unless given.
        sha256: Digest that the file must have; any where None.

    Raises:
        ValueError: It is too large, another file, damaged, of unknown operators, or its weights lie in other
            files.
    """
    path, most = Path(path), MOST_BYTES if most is None else most
    try:
        with path.open("rb") as file:
            model = file.read(most + 1)
    except OSError as error:
        raise ValueError(f"model: expected a readable file, got {path} ({error.strerror})") from error
    if len(model) > most:
        raise ValueError(f"model: expected at most {most >> 20} MiB, got more in {path}")
    found_sha256 = hashlib.sha256(model).hexdigest() if sha256 is not None else None
    if found_sha256 != sha256:
        raise ValueError(
            f"model: expected {path} with SHA-256 {sha256}, got {found_sha256}. Was it replaced or damaged?"
        )
    try:
        found = contents(model)
    except ValueError as error:
        raise ValueError(f"model: {path}: {str(error).removeprefix('model: ')}") from error
    if found.external:
        raise ValueError(
            f"model: expected all weights in {path}, got {found.external} tensors in other files. "
            "Save it as one file"
        )
    unknown = sorted(set(found.opsets) - set(DOMAINS))
    if unknown:
        raise ValueError(f"model: expected standard operators, got those of {', '.join(map(repr, unknown))}")
    version = found.opsets.get("", OPSETS[0])
    if not OPSETS[0] <= version <= OPSETS[1]:
        raise ValueError(f"model: expected opset {OPSETS[0]} to {OPSETS[1]}, got {version}. Export it again")
    return model, found


def sha256_of(card: Path) -> str:
    """Of the network, as its card says.

    Raises:
        ValueError: It does not.
    """
    try:
        digest = json.loads(card.read_text(encoding="utf-8"))["sha256"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"card: expected the network's sha256 in {card}, got none ({error})") from error
    return str(digest)


class Network:
    """One input picture, perhaps with more beside it, and some output arrays.

    Assumes: a batch of one.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        threads: int = 1,
        most: int | None = None,
        sha256: str | None = None,
        extra: str = "rov",
        beside: tuple[str, ...] = (),
    ) -> None:
        """Open a file.

        Args:
            path: Of the model.
            threads: That one inference may use, 1 to 8.
            most: Bytes of the file at most; `MOST_BYTES` unless given.
            sha256: Digest that the file must have; any where None.
            extra: Which of the package's extras is asked for where ONNX Runtime is not installed.
            beside: Names of inputs that the model has after its picture, each of float32.

        Raises:
            ValueError: The file is refused, with the reason; see `checked_bytes`.
        """
        if not 1 <= threads <= 8:
            raise ValueError(f"threads: expected 1 to 8, got {threads}")
        model, self._contents = checked_bytes(path, most=most, sha256=sha256)
        try:
            import onnxruntime
        except ImportError as error:
            raise ValueError(extras.missing(extra, "onnxruntime", "model")) from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
        except Exception as error:
            raise ValueError(f"model: ONNX Runtime refuses {path}: {_first_line(error)}") from error
        self.path = str(path)
        inputs = self._session.get_inputs()
        if tuple(i.name for i in inputs[1:]) == beside and all(i.type == "tensor(float)" for i in inputs[1:]):
            inputs = inputs[:1]
        if len(inputs) != 1 or inputs[0].type not in KINDS:
            got = ", ".join(f"{i.name[:MOST_NAME]}: {i.type}" for i in inputs[:4])
            raise ValueError(
                f"model: expected one input of {', '.join(KINDS)}, got {got or 'none'}. "
                "Export it with a single picture as its input"
            )
        self._name = inputs[0].name
        self.kind = np.dtype(KINDS[inputs[0].type])
        """Of the numbers of a picture."""
        self.input_shape: tuple[int | None, ...] = _shape(inputs[0].shape)
        """None where any length will do."""
        if len(self.input_shape) != 4 or self.input_shape[0] not in (1, None):
            raise ValueError(
                f"model: expected an input of one picture in 4 dimensions, got {inputs[0].shape}"
            )
        self.outputs: dict[str, tuple[int | None, ...]] = {
            output.name: _shape(output.shape) for output in self._session.get_outputs()
        }
        """Shapes by name, in order; None where the file does not say."""
        self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        """What the file's maker wrote into it."""

    def operator(self, output: str) -> str:
        """The operator whose numbers an output holds; see `Contents.operator`."""
        return self._contents.operator(output)

    def run(
        self,
        picture: npt.NDArray[Any],
        names: list[str],
        beside: Mapping[str, npt.NDArray[np.float32]] | None = None,
    ) -> list[npt.NDArray[Any]]:
        """Outputs for one picture, as they come: whole numbers, booleans or floats, finite or not.

        Args:
            picture: As the input's shape asks; float32, or uint8 where the input is.
            names: Of the outputs.
            beside: The inputs after the picture, by name.

        Raises:
            ValueError: The picture's numbers are of another kind, ONNX Runtime fails, or an output is no
                array of numbers.
        """
        if not np.can_cast(picture.dtype, self.kind, "same_kind"):
            raise ValueError(f"model: {self.path} takes a tensor of {self.kind}, got one of {picture.dtype}")
        with np.errstate(over="ignore"):  # Of half precision: an inf comes out as one, and is told there.
            fed = picture.astype(self.kind, copy=False)
        try:
            answers: list[npt.NDArray[Any]] = self._session.run(names, {self._name: fed, **(beside or {})})
        except Exception as error:
            raise ValueError(f"model: {self.path} fails on {picture.shape}: {_first_line(error)}") from error
        for name, answer in zip(names, answers, strict=True):
            if not isinstance(answer, np.ndarray) or answer.dtype.kind not in "biuf":
                got = getattr(answer, "dtype", "no array")
                raise ValueError(f"model: expected numbers in {name[:MOST_NAME]}, got {got}")
            if answer.size > MOST_VALUES:
                raise ValueError(
                    f"model: expected at most {MOST_VALUES} numbers in {name[:MOST_NAME]}, got {answer.size}"
                )
        return answers


def _shape(shape: list[Any]) -> tuple[int | None, ...]:
    return tuple(length if isinstance(length, int) and length > 0 else None for length in shape or [])


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines() or [type(error).__name__]
    return lines[0][:300]


def input_side(side: int | None, wanted: int | None, name: str) -> int:
    """Length of one side of the input: what the file says, or what is wanted where it leaves that open."""
    length = side if side is not None else wanted
    if length is None:
        raise ValueError(f"{name}: the model takes any; expected it in the sidecar")
    if wanted is not None and wanted != length:
        raise ValueError(f"{name}: the model takes {length}, but its sidecar says {wanted}")
    if not 8 <= length <= MOST_SIDE or not math.isfinite(length):
        raise ValueError(f"{name}: expected 8 to {MOST_SIDE} pixels, got {length}")
    return length
