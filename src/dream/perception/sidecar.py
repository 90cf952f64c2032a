"""What has to be known of a network to use it: a small file beside the model, or the model's own metadata."""

from __future__ import annotations

import ast
import json
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from dream.perception.onnx import MOST_SIDE
from dream.types import Label

MOST_TEXT = 1 << 18
"""Bytes of a sidecar, and of one entry of a model's metadata."""
MOST_CLASSES = 1000

LABELS = {label.name.lower(): label for label in Label}
WORDS = {
    Label.TARGET: "oyster shell clam mussel reef wreck shipwreck hull",
    Label.OBSTACLE: "wall pipe pole post rock boulder net diver robot",
    Label.SEABED: "floor sand mud gravel liner ground",
    Label.WATER: "background surface open_water",
}
"""Class names that say themselves which label they are, but for an s at the end."""

Side = Annotated[int, Field(ge=8, le=MOST_SIDE)]
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Above = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e6)]
LabelName = Literal["water", "seabed", "target", "obstacle"]


class Sidecar(BaseModel):
    """How a network wants its picture, and what its output means.

    The picture is x = (scale · rgb − mean) / std, channel by channel.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    output: Literal["logits", "instances", "metric_depth", "relative_depth", "inverse_depth"]
    """Class scores per pixel; boxes and prototype masks as Ultralytics exports them; metres along the optical
    axis; the same up to a factor; a reciprocal of it up to a factor and an offset."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    """Of the input, and of logits."""
    width: Side | None = None
    """Of the input in pixels, where the model leaves it open."""
    height: Side | None = None
    colours: Literal["RGB", "BGR"] = "RGB"
    scale: Above = 1.0 / 255.0
    mean: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    """In the order of `colours`."""
    std: tuple[Above, Above, Above] = (1.0, 1.0, 1.0)
    letterbox: bool = False
    """Whether the picture keeps its proportions, on grey; else it is stretched."""
    classes: dict[Annotated[str, Field(max_length=100)], LabelName] = Field({}, max_length=MOST_CLASSES)
    """Label by class name, in the order of the network's classes."""
    name: Annotated[str, Field(max_length=200)] | None = None
    """Of the output; the first where None."""
    least_score: Annotated[float, Field(ge=0.0, le=1.0)] = 0.25
    """Of an instance."""

    @model_validator(mode="after")
    def _classes_where_labels(self) -> Sidecar:
        if self.output in ("logits", "instances") and not self.classes:
            raise ValueError(
                f'classes: expected names and labels, like {{"oyster": "target"}}, for {self.output}'
            )
        return self

    @field_validator("std")
    @classmethod
    def _not_tiny(cls, std: tuple[float, float, float]) -> tuple[float, float, float]:
        if min(std) < 1e-6:
            raise ValueError(f"std: expected at least 1e-6, got {min(std)}")
        return std

    @property
    def labels(self) -> list[Label]:
        """Label of every class."""
        return [LABELS[name] for name in self.classes.values()]


def read_sidecar(path: str | Path) -> Sidecar:
    """The sidecar in a .json or .toml file.

    Raises:
        ValueError: It cannot be read, or does not say what a sidecar has to.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            raw = file.read(MOST_TEXT + 1)
    except OSError as error:
        raise ValueError(f"sidecar: expected a readable file, got {path} ({error.strerror})") from error
    if len(raw) > MOST_TEXT:
        raise ValueError(f"sidecar: expected at most {MOST_TEXT} bytes, got more in {path}")
    try:
        text = raw.decode()
        content = tomllib.loads(text) if path.suffix == ".toml" else json.loads(text)
        return Sidecar.model_validate(content)
    except ValidationError as error:
        raise ValueError(f"sidecar {path}: {_reasons(error)}") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"sidecar {path}: expected JSON or TOML ({error})") from error


def sidecar_beside(model: str | Path) -> Path | None:
    """`model.json` or `model.toml` beside `model.onnx`; None without."""
    for suffix in (".json", ".toml"):
        path = Path(model).with_suffix(suffix)
        if path.is_file():
            return path
    return None


def ultralytics(metadata: Mapping[str, str], classes: Mapping[str, str] | None = None) -> Sidecar:
    """The sidecar of a model that Ultralytics exported, from the metadata in its file.

    They are text: `task` ("segment"), `imgsz` ("[480, 640]", height first), `names` ("{0: 'oyster'}").

    Args:
        metadata: Of the model.
        classes: Label name by class name; names that are not in it are looked up among common words.

    Raises:
        ValueError: It is no segmentation model, or there is no label for one of its classes.
    """
    task = metadata.get("task")
    if task != "segment":
        raise ValueError(
            f"model: expected a sidecar beside it, or Ultralytics' metadata of task 'segment', got {task!r}"
        )
    names, size = _literal(metadata, "names"), _literal(metadata, "imgsz")
    if isinstance(names, list):
        names = dict(enumerate(names))
    if (
        not isinstance(names, dict)
        or not 1 <= len(names) <= MOST_CLASSES
        or sorted(names) != list(range(len(names)))
    ):
        raise ValueError(f"names: expected a name for each class from 0, got {str(names)[:100]}")
    if isinstance(size, int):
        size = [size, size]
    if not isinstance(size, list) or len(size) != 2:
        raise ValueError(f"imgsz: expected height and width, got {str(size)[:100]}")
    known = {name: label_of(str(name), classes or {}) for _, name in sorted(names.items())}
    if len(known) != len(names):
        raise ValueError("names: expected a different name for each class")
    try:
        return Sidecar.model_validate(
            {
                "output": "instances",
                "height": size[0],
                "width": size[1],
                "letterbox": True,
                "classes": {str(name): label.name.lower() for name, label in known.items()},
            }
        )
    except ValidationError as error:
        raise ValueError(f"model's metadata: {_reasons(error)}") from error


def label_of(name: str, classes: Mapping[str, str]) -> Label:
    """The label that a class is.

    Raises:
        ValueError: Neither the table nor the name says it.
    """
    said = classes.get(name, name).strip().lower().replace(" ", "_")
    for word in (said, said.removesuffix("s")):
        if word in LABELS:
            return LABELS[word]
        for label, words in WORDS.items():
            if word in words.split():
                return label
    raise ValueError(
        f"class {name!r}: expected to know whether it is {', '.join(LABELS)}. "
        f'Say so in `classes`, like {{{name!r}: "target"}}'
    )


def _literal(metadata: Mapping[str, str], name: str) -> object:
    text = metadata.get(name, "")
    if not 0 < len(text) <= MOST_TEXT:
        raise ValueError(f"{name}: expected it in the model's metadata, got {len(text)} characters")
    try:
        value: object = ast.literal_eval(text)
    except (ValueError, SyntaxError, MemoryError, RecursionError) as error:
        raise ValueError(f"{name}: expected a Python literal, got {text[:100]!r}") from error
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{name}: expected finite numbers")
    return value


def _reasons(error: ValidationError) -> str:
    return "; ".join(
        f"{'.'.join(map(str, item['loc'])) or 'all of it'}: {item['msg']}" for item in error.errors()[:4]
    )
