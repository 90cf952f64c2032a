"""What a person says of a picture's pixels: target, other, or nothing. One PNG for each picture.

White is target, black is other, anything else says nothing; so is what is transparent. Any program that
paints can make such a file.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from PIL import Image, ImageDraw, PngImagePlugin
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from dream.files import write_whole
from dream.teaching.pictures import MOST_PIXELS
from dream.types import UInt8Array

UNMARKED, TARGET, OTHER = 0, 1, 2
"""Values of marks."""
MOST_BYTES = 32 << 20
"""Of a file of marks."""
MOST_POINTS = 4000
"""Of a stroke."""
MOST_KEPT = 40
"""Strokes on a picture that can be taken back."""
SUFFIX = ".png"

_GREY = {UNMARKED: 128, TARGET: 255, OTHER: 0}
_OF_PICTURE = "picture-sha256"
_WHITE, _BLACK = 250, 5
"""From which and up to which a channel counts as white and as black: some programs convert colours."""
_BOMBS = (Image.DecompressionBombError, Image.DecompressionBombWarning)

Share = Annotated[float, Field(ge=-1.0, le=2.0, allow_inf_nan=False)]


class MarkStroke(BaseModel):
    """One stroke or box over a picture."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    picture: Annotated[int, Field(ge=0, le=100_000)]
    """Its place in the list."""
    tool: Literal["brush", "box"]
    """A line along the points, or the rectangle between the first and the last."""
    mark: Literal["target", "other", "none"]
    """What its pixels are; none takes marks away."""
    width: Annotated[float, Field(gt=0.0, le=0.5, allow_inf_nan=False)]
    """Of a line, as a share of the picture's width."""
    points: Annotated[list[tuple[Share, Share]], Field(min_length=1, max_length=MOST_POINTS)]
    """From left and from above, as shares of the picture's width and height."""

    @classmethod
    def read(cls, text: bytes) -> MarkStroke:
        """From JSON.

        Raises:
            ValueError: It is none.
        """
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(map(str, first["loc"])) or "stroke"
            raise ValueError(f"{where[:100]}: {first['msg'][:200]}") from error

    def drawn(self, marks: UInt8Array) -> UInt8Array:
        """The marks (H, W) with the stroke over them; a new array."""
        value = {"target": TARGET, "other": OTHER, "none": UNMARKED}[self.mark]
        image = Image.fromarray(marks)
        draw, (height, width) = ImageDraw.Draw(image), marks.shape
        # A pixel's middle lies half a pixel from its edges.
        points = [(x * width - 0.5, y * height - 0.5) for x, y in self.points]
        if self.tool == "box":
            (x0, y0), (x1, y1) = points[0], points[-1]
            draw.rectangle((min(x0, x1), min(y0, y1), max(x0, x1), max(y0, y1)), fill=value)
        else:
            across = max(1.0, self.width * width)
            draw.line(points, fill=value, width=round(across), joint="curve")
            for x, y in (points[0], points[-1]):
                draw.ellipse((x - across / 2, y - across / 2, x + across / 2, y + across / 2), fill=value)
        return np.array(image)


@dataclass(slots=True)
class MarkSheet:
    """The marks of one picture, and what they were before the last strokes."""

    marks: UInt8Array
    """(H, W) `UNMARKED`, `TARGET` or `OTHER`."""
    before: list[UInt8Array] = field(default_factory=list)

    def put(self, marks: UInt8Array) -> None:
        """Change the marks; `back` takes it back."""
        self.before = [*self.before[-MOST_KEPT + 1 :], self.marks]
        self.marks = marks

    def back(self) -> bool:
        """Take the last change back; whether there was one."""
        if not self.before:
            return False
        self.marks = self.before.pop()
        return True


def marked_in(folder: Path) -> list[str]:
    """Names of the pictures of which marks are kept in a folder; none where it is not there."""
    if not folder.is_dir():
        return []
    return sorted(
        path.stem
        for path in folder.iterdir()
        if path.suffix.lower() == SUFFIX and path.is_file() and not path.name.startswith(".")
    )


def read_marks(path: Path, size: tuple[int, int], digest: str) -> UInt8Array:
    """The marks in a file, at the size at which their picture is shown.

    Args:
        path: Of the PNG.
        size: Height and width of the marks; a file of other pixels but the same proportions is reduced.
        digest: SHA-256 of the picture's file, which the marks of a page name.

    Raises:
        ValueError: It is no such file, or of another picture.
    """
    try:
        if path.stat().st_size > MOST_BYTES:
            raise ValueError(f"expected at most {MOST_BYTES} bytes")
        with Image.open(path, formats=["PNG"]) as image:
            if image.width * image.height > MOST_PIXELS:
                raise ValueError(f"expected at most {MOST_PIXELS} pixels, got {image.size}")
            of = str(image.info.get(_OF_PICTURE, digest))
            rgba = np.asarray(image.convert("RGBA"))
    except (OSError, ValueError, SyntaxError, *_BOMBS) as error:
        raise ValueError(f"{path}: expected a PNG of marks ({str(error)[:200]})") from error
    if of != digest:
        raise ValueError(
            f"{path}: expected marks of this picture, got those of another of its name. Choose another --out"
        )
    high, wide = rgba.shape[:2]
    if abs(high * size[1] / (wide * size[0]) - 1.0) > 0.02:
        raise ValueError(
            f"{path}: expected the proportions of its picture, {size[1]} x {size[0]}, got {wide} x {high}"
        )
    solid = rgba[..., 3] >= 128
    marks = np.full((high, wide), UNMARKED, np.uint8)
    marks[solid & (rgba[..., :3] >= _WHITE).all(axis=2)] = TARGET
    marks[solid & (rgba[..., :3] <= _BLACK).all(axis=2)] = OTHER
    if (high, wide) == size:
        return marks
    return np.array(Image.fromarray(marks).resize((size[1], size[0]), Image.Resampling.NEAREST))


def write_marks(path: Path, marks: UInt8Array, digest: str) -> None:
    """Keep marks whole or not at all; where nothing is marked, no file stays.

    Raises:
        OSError: They could not be written.
    """
    if not marks.any():
        path.unlink(missing_ok=True)
        return
    grey = np.zeros(3, np.uint8)
    for value, level in _GREY.items():
        grey[value] = level
    told = PngImagePlugin.PngInfo()
    told.add_text(_OF_PICTURE, digest)
    content = io.BytesIO()
    Image.fromarray(grey[marks]).save(content, "png", pnginfo=told)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content.getvalue())


def check_name(name: str) -> None:
    """Refuse what cannot name both a class and a file.

    Raises:
        ValueError: It cannot.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,39}", name):
        raise ValueError(
            f"--name: expected at most 40 letters, digits, dashes and underscores, got {name[:80]!r}"
        )
