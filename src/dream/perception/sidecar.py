"""What has to be known of a network to use it: a small file beside the model, or the model's own metadata."""

from __future__ import annotations

import ast
import json
import math
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from dream.perception.onnx import MOST_SIDE
from dream.types import Label

MOST_TEXT = 1 << 18
"""Bytes of a sidecar, and of one entry of a model's metadata."""
MOST_CLASSES = 1000
MOST_SHOWN = 8
"""Names of a list that a message shows."""

LABELS = {label.name.lower(): label for label in Label}
WORDS = {
    Label.TARGET: "oyster shell clam mussel reef wreck shipwreck hull",
    Label.OBSTACLE: "wall pipe pole post rock boulder net diver robot",
    Label.SEABED: "floor sand mud gravel liner ground",
    Label.WATER: "background surface open_water",
}
"""Class names that say themselves which label they are, but for an s at the end."""
NAMED = ("names", "id2label", "classes", "class_names", "labels")
"""Entries of a model's metadata in which exporters write its classes: Ultralytics the first, Hugging Face the
second."""
NOT_NAMED = re.compile(r"(label|class)?[ _-]?\d+")
"""Names that an exporter makes up where it knows none."""

LABELLING = ("logits", "probabilities", "classes", "instances")
"""Outputs that labels are made of."""

Side = Annotated[int, Field(ge=8, le=MOST_SIDE)]
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e6, le=1e6)]
Above = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=1e6)]
LabelName = Literal["water", "seabed", "target", "obstacle"]


class Sidecar(BaseModel):
    """How a network wants its picture, and what its output means.

    The picture is x = (scale · rgb − mean) / std, channel by channel.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    output: Literal[
        "logits", "probabilities", "classes", "instances", "metric_depth", "relative_depth", "inverse_depth"
    ]
    """Scores of the classes per pixel, before a softmax or sigmoid; the same after it; the number of a class
    per pixel, or masks; boxes and prototype masks as Ultralytics exports them; metres along the optical axis;
    the same up to a factor; a reciprocal of it up to a factor and an offset."""
    exclusive: bool = True
    """Whether each pixel is of one of several classes (softmax); else each class is told by itself (sigmoid),
    as a single one always is, and a pixel may be of none."""
    layout: Literal["NCHW", "NHWC"] = "NCHW"
    """Of the input, and of scores where both could be."""
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
    names_from: Literal["both", "sidecar"] = "both"
    """Whether the model's own metadata, where they name its classes, must say the same as `classes`; with
    `sidecar` they are wrong, and are not looked at."""
    name: Annotated[str, Field(max_length=200)] | None = None
    """Of the output; the first where None."""
    least_score: Annotated[float, Field(ge=0.0, le=1.0)] = 0.25
    """Of an instance."""

    @model_validator(mode="after")
    def _classes_where_labels(self) -> Sidecar:
        if self.output in LABELLING and not self.classes:
            raise ValueError(
                f'classes: expected names and labels, like {{"oyster": "target"}}, for {self.output}'
            )
        if not self.exclusive and self.output not in ("logits", "probabilities"):
            raise ValueError(f"exclusive: expected only with logits or probabilities, got {self.output}")
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
        text = raw.decode("utf-8-sig")
        toml = path.suffix == ".toml"
        content = tomllib.loads(text) if toml else json.loads(text, object_pairs_hook=_each_once)
        return Sidecar.model_validate(content)
    except ValidationError as error:
        raise ValueError(f"sidecar {path}: {_reasons(error)}") from error
    except (ValueError, RecursionError) as error:
        raise ValueError(f"sidecar {path}: expected JSON or TOML ({str(error)[:200]})") from error


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """An object of JSON; of two equal names the standard reader keeps one, and a class would be lost."""
    content = dict(pairs)
    if len(content) != len(pairs):
        twice = next(name for n, (name, _) in enumerate(pairs) if name in dict(pairs[:n]))
        raise ValueError(f"expected each name once, got {twice[:100]!r} twice")
    return content


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
    try:
        known = {name: label_of(str(name), classes or {}) for _, name in sorted(names.items())}
    except ValueError as error:
        wanted = _table({str(name): "?" for _, name in sorted(names.items())[:MOST_SHOWN]})
        raise ValueError(
            f'{error} or in a file beside the model: {{"output": "instances", "letterbox": true, '
            f'"classes": {wanted}}}'
        ) from error
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


def named(metadata: Mapping[str, str], known: Iterable[str]) -> tuple[str, list[str]] | None:
    """The entry of a model's metadata that names its classes, and the names in their order.

    None where there is no such entry, it cannot be read, or its names are made up by the exporter.
    """
    for entry in NAMED:
        names = _listed(metadata.get(entry, ""), known)
        if names and not all(NOT_NAMED.fullmatch(name.strip().lower()) for name in names):
            return entry, names
    return None


def _listed(text: str, known: Iterable[str]) -> list[str] | None:
    """Names in a list, or in a table from their numbers, of JSON or Python; else between commas or lines.

    The latter only where one of them is known: any sentence may have commas.
    """
    if not 0 < len(text) <= MOST_TEXT:
        return None
    try:
        value: object = json.loads(text)
    except (ValueError, RecursionError):
        try:
            value = ast.literal_eval(text)
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            # A sentence names nothing, and what looks like a table or a call is no list of names.
            value = re.split(r"[,\n]", text.strip()) if not re.search(r"[\[\]{}()]", text) else None
            told = {_plain(name) for name in value or ()}
            value = value if len(told) > 1 and not told.isdisjoint(map(_plain, known)) else None
    if isinstance(value, dict):
        try:
            by_number = {int(number): name for number, name in value.items()}
        except (ValueError, TypeError):
            return None
        if len(by_number) != len(value) or sorted(by_number) != list(range(len(by_number))):
            return None
        value = [by_number[number] for number in range(len(by_number))]
    if not isinstance(value, list | tuple) or not 0 < len(value) <= MOST_CLASSES:
        return None
    names = [name.strip() for name in value if isinstance(name, str)]
    return names if len(names) == len(value) else None


def check_names(sidecar: Sidecar, metadata: Mapping[str, str]) -> None:
    """Refuse a sidecar whose classes are not those that the model itself names, or in another order.

    Raises:
        ValueError: The message has both lists, and what to write for either to be right.
    """
    own = named(metadata, sidecar.classes)
    if own is None or sidecar.names_from == "sidecar" or sidecar.output not in LABELLING:
        return
    entry, names = own
    said = list(sidecar.classes)
    if [_plain(name) for name in said] == [_plain(name) for name in names]:
        return
    label_by = {_plain(name): label for name, label in sidecar.classes.items()}
    mended = {name: label_by.get(_plain(name), "?") for name in names[:MOST_SHOWN]}
    more = ", ..." if len(names) > MOST_SHOWN else ""
    raise ValueError(
        f"classes: the sidecar says {shown(said)}, but the model's own {entry!r} say {shown(names)}. "
        f'Where the model is right, write "classes": {_table(mended)}{more}; '
        'where the sidecar is, add "names_from": "sidecar"'
    )


def _plain(name: str) -> str:
    return re.sub(r"[ _-]+", " ", name.strip().lower())


def _table(names: Mapping[str, str]) -> str:
    short = {_cut(name): label for name, label in names.items()}
    return json.dumps(short, ensure_ascii=False)


def _cut(text: str, most: int = 40) -> str:
    return text if len(text) <= most else text[: most - 3] + "..."


def shown(names: Iterable[str]) -> str:
    """A list of names for a message, of which no length is known."""
    names = list(names)
    few = ", ".join(_cut(name) for name in names[:MOST_SHOWN])
    return f"[{few}, ... {len(names)} in all]" if len(names) > MOST_SHOWN else f"[{few}]"


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
        f"class {_cut(name)!r}: expected to know whether it is {', '.join(LABELS)}. "
        f'Say so in `classes`, like {{"{_cut(name)}": "target"}}'
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
        f"{_cut('.'.join(map(str, item['loc'])), 100) or 'all of it'}: {item['msg'][:300]}"
        for item in error.errors()[:4]
    )
