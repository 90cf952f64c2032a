"""A folder → the pictures in it, each opened within bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from dream.names import look_up
from dream.types import UInt8Array

SUFFIXES = (".jpg", ".jpeg", ".png")
FRAMES = "frames"
"""Folder of a run in which its pictures lie, as `NNNN_rgb.png` beside depth and labels."""
MOST_FILES = 20_000
"""Pictures of a folder."""
MOST_PIXELS = 80_000_000
"""Of a picture. Cameras of today have 12 to 60 million."""
SHOWN_SIDE = 1024
"""Pixels of the longer side of a picture as it is shown, and of its marks."""

_BOMBS = (Image.DecompressionBombError, Image.DecompressionBombWarning)


@dataclass(frozen=True, slots=True)
class Picture:
    """A file that holds one."""

    path: Path

    @property
    def name(self) -> str:
        """By which its marks are kept: that of the file, without its suffix."""
        return self.path.stem

    def open(self) -> UInt8Array:
        """(H, W, 3) its colours, turned as its camera was held.

        Raises:
            ValueError: It cannot be read, is too large, or has no colours of 8 bits.
        """
        try:
            with Image.open(self.path, formats=["JPEG", "PNG"]) as image:
                if image.width * image.height > MOST_PIXELS:
                    raise ValueError(f"expected at most {MOST_PIXELS} pixels, got {image.size}")
                if min(image.size) < 16:
                    raise ValueError(f"expected at least 16 pixels a side, got {image.size}")
                if image.mode[0] in "IF":
                    raise ValueError(f"expected colours of 8 bits, got mode {image.mode}")
                return np.asarray(ImageOps.exif_transpose(image).convert("RGB"))
        except (OSError, ValueError, SyntaxError, *_BOMBS) as error:
            raise ValueError(f"{self.path}: expected a picture ({str(error)[:200]})") from error


def pictures_in(folder: Path) -> list[Picture]:
    """The pictures of a folder, by name; of a run's folder those that its camera took.

    Raises:
        ValueError: There is no such folder, none in it, too many, or two of one name.
    """
    if not folder.is_dir():
        raise ValueError(f"FOLDER: expected a folder of pictures or of a run, got {folder}")
    run = folder / FRAMES
    if run.is_dir():
        found = [path for path in run.iterdir() if path.name.endswith("_rgb.png")]
    else:
        found = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    found = sorted(path for path in found if path.is_file() and not path.name.startswith("."))
    if not found:
        raise ValueError(f"FOLDER: expected pictures {', '.join(SUFFIXES)} in {folder}, got none")
    if len(found) > MOST_FILES:
        raise ValueError(f"FOLDER: expected at most {MOST_FILES} pictures, got {len(found)} in {folder}")
    by_name: dict[str, Path] = {}
    for path in found:
        other = by_name.setdefault(path.stem, path)
        if other is not path:
            raise ValueError(
                f"FOLDER: expected a name of its own for each picture, got {other.name} and {path.name}. "
                "Rename one"
            )
    return [Picture(path) for path in found]


def chosen(pictures: Sequence[Picture], most: int, marked: Sequence[str]) -> list[Picture]:
    """So many of the pictures, evenly spaced, and all that are marked.

    Raises:
        ValueError: Marks are of a picture that is not there.
    """
    by_name = {picture.name: picture for picture in pictures}
    for name in marked:
        look_up(by_name, name, "picture for the marks")
    spaced = np.unique(np.linspace(0, len(pictures) - 1, min(most, len(pictures))).round().astype(int))
    wanted = {pictures[n].name for n in spaced} | set(marked)
    return [picture for picture in pictures if picture.name in wanted]


def shown_size(shape: tuple[int, ...]) -> tuple[int, int]:
    """Height and width at which a picture of (H, W) is shown and marked."""
    factor = min(1.0, SHOWN_SIDE / max(shape[:2]))
    return max(1, round(shape[0] * factor)), max(1, round(shape[1] * factor))


def shown(rgb: UInt8Array) -> UInt8Array:
    """The picture at that size, (h, w, 3)."""
    height, width = shown_size(rgb.shape)
    if rgb.shape[:2] == (height, width):
        return rgb
    return np.asarray(Image.fromarray(rgb).resize((width, height), Image.Resampling.BOX))
