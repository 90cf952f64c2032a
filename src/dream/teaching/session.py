"""Pictures, their marks on disk, and a thread that learns from them whenever they change.

The thread of a server reads `Session.view` and the pictures, and calls `Session.draw`, `back` and `save`; the
worker opens pictures, learns, and measures. Marks are on disk before the server answers.
"""

from __future__ import annotations

import io
import logging
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy.ndimage import binary_erosion
from scipy.special import expit

from dream.perception.sight import file_sha256
from dream.teaching import fit
from dream.teaching.fit import Example, HeadLesson, TaughtHead, lacking
from dream.teaching.marks import (
    OTHER,
    SUFFIX,
    TARGET,
    UNMARKED,
    MarkSheet,
    MarkStroke,
    read_marks,
    write_marks,
)
from dream.teaching.model import Extractor, Head, save
from dream.teaching.pictures import Picture, shown, shown_size
from dream.types import Float32Array, UInt8Array

MARKS = "marks"
"""Folder of the marks within that of a lesson."""
THUMB_WIDTH = 256
SAVE_S = 60.0
"""Seconds that saving waits for what is being learned."""

COLORS = {TARGET: (255, 64, 170), OTHER: (255, 221, 51)}
"""sRGB of target and other, in marks and labels: seldom seen under water, and told apart by every eye."""

logger = logging.getLogger(__name__)


@dataclass(slots=True)
class _OpenSheet(MarkSheet):
    """A picture that is open: what is shown of it, and what is known of it."""

    digest: str = ""
    shown: bytes = b""
    """JPEG."""
    thumb: bytes = b""
    cells: Float32Array = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))
    shape: tuple[int, ...] = ()
    """Of the picture itself."""
    example: Example | None = None
    """Of the marks as they are; None where they changed since."""
    logits: Float32Array | None = None
    """(1, h, w) by the head that is shown."""
    unsure: float | None = None
    """How unsure its labels are: mean of 1 − |2p − 1|; None without."""
    turns: int = 0
    """Changes of its marks."""
    has: tuple[bool, bool] = (False, False)
    """Whether target is marked, and other."""

    def counted(self) -> None:
        """Note what its marks are now."""
        self.has = bool((self.marks == TARGET).any()), bool((self.marks == OTHER).any())

    def told(self, head: Head | None) -> None:
        """Label it by a head, or by none."""
        self.logits = None if head is None else head.logits(self.cells)
        self.unsure = None
        if self.logits is not None:
            self.unsure = float((1.0 - np.abs(2.0 * expit(self.logits) - 1.0)).mean())


@dataclass(frozen=True, slots=True)
class SessionView:
    """What a page shows."""

    number: int
    """Grows with each change."""
    told: dict[str, Any]


class Session:
    """Somebody teaches one target on a set of pictures."""

    def __init__(self, pictures: Sequence[Picture], extractor: Extractor, folder: Path, name: str) -> None:
        """Begin, or go on where marks are kept.

        Args:
            pictures: All that are shown.
            extractor: Of their features.
            folder: Where marks and model are kept; made with the first of them.
            name: Of the target.
        """
        self.pictures = tuple(pictures)
        self.name, self.folder = name, folder
        self._extractor = extractor
        self._sheets: list[_OpenSheet | None] = [None] * len(pictures)
        self._lost: dict[int, str] = {}
        self._changed = threading.Condition()
        self._marked = 0
        """Grows with each change of marks."""
        self._learned = self._measured = -1
        """The count of changes that head and quality are of."""
        self._taught: TaughtHead | None = None
        self._head: Head | None = None
        self._heads = 0
        """Grows with each head that is shown."""
        self._doing = ""
        self._lacks = ""
        self._seconds = 0.0
        self._saved: str | None = None
        self._first = 0
        """The picture that somebody waits for, which is opened before others."""
        self._over = False
        self._view = SessionView(0, {})
        self._publish()

    @property
    def model(self) -> Path:
        """Where the model is saved."""
        return self.folder / f"{self.name}.onnx"

    @property
    def view(self) -> SessionView:
        """What there is to show now."""
        return self._view

    # ---- the server's side

    def picture(self, number: int, what: str) -> tuple[bytes, str] | None:
        """Content and media type of something of a picture; None where there is no such thing yet."""
        if not 0 <= number < len(self._sheets):
            return None
        sheet = self._sheets[number]
        if sheet is None:
            with self._changed:
                self._first = number
            return None
        if what in ("shown", "thumb"):
            return (sheet.shown if what == "shown" else sheet.thumb), "image/jpeg"
        if what == "marks":
            return _overlay(sheet.marks, 150, 255), "image/png"
        small = what == "small"
        if (what == "labels" or small) and (logits := sheet.logits) is not None:
            height, width = sheet.marks.shape
            if small:
                height, width = max(1, round(height * THUMB_WIDTH / width)), THUMB_WIDTH
            told = self._extractor.target(logits, self._extractor.frame(sheet.shape), (height, width))
            return _overlay(np.where(told, TARGET, UNMARKED).astype(np.uint8), 110, 255), "image/png"
        return None

    def draw(self, stroke: MarkStroke) -> None:
        """Put a stroke on a picture, and keep its marks.

        Raises:
            LookupError: The picture is not open.
            OSError: The marks could not be kept; they are as before then.
        """
        sheet = self._opened(stroke.picture)
        with self._changed:
            marks = stroke.drawn(sheet.marks)
            self._keep(stroke.picture, sheet, marks)
            sheet.put(marks)
            self._note(sheet)

    def clear(self, number: int) -> None:
        """Take all marks of a picture away; `back` brings them back.

        Raises:
            LookupError: The picture is not open.
            OSError: See `draw`.
        """
        sheet = self._opened(number)
        with self._changed:
            marks = np.zeros_like(sheet.marks)
            self._keep(number, sheet, marks)
            sheet.put(marks)
            self._note(sheet)

    def back(self, number: int) -> bool:
        """Take the last change of a picture's marks back; whether there was one.

        Raises:
            LookupError: The picture is not open.
            OSError: See `draw`.
        """
        sheet = self._opened(number)
        with self._changed:
            if not sheet.before:
                return False
            self._keep(number, sheet, sheet.before[-1])
            sheet.back()
            self._note(sheet)
        return True

    def save(self) -> None:
        """Write the model that the marks give, once it is learned and measured.

        Raises:
            ValueError: There are too few marks, or it takes too long.
            OSError: It could not be written.
        """
        until = time.monotonic() + SAVE_S
        with self._changed:
            while self._measured != self._marked or self._marked_closed():
                if self._over or not self._changed.wait(until - time.monotonic()):
                    raise ValueError("It is still learning. Try again in a moment.")
            if self._lacks:
                raise ValueError(f"Nothing to save yet: {self._lacks}.")
            taught = self._taught
            examples = [sheet.example for sheet in self._sheets if sheet and sheet.example]
        assert taught is not None
        card = card_of(self._extractor, self.name, taught, examples)
        save(self.model, self._extractor, taught.head, self.name, card)
        with self._changed:
            self._saved = str(self.model)
            self._publish()

    # ---- the worker's side

    def work(self) -> None:
        """Open, learn and measure until `end`."""
        try:
            while not self._over:
                number = self._next_closed()
                if number is not None and (self._is_wanted(number) or self._marked_closed()):
                    self._open(number)
                elif self._learned != self._marked:
                    self._learn()
                elif self._measured != self._marked:
                    self._measure()
                elif number is not None:
                    self._open(number)
                else:
                    with self._changed:
                        if not self._over and self._learned == self._marked:
                            self._changed.wait()
        except Exception as error:
            logger.exception("teach: the worker ended")
            with self._changed:
                self._doing = f"ended: {error}"
                self._over = True
                self._publish()
                self._changed.notify_all()
            raise

    def end(self) -> None:
        """Let the worker end."""
        with self._changed:
            self._over = True
            self._changed.notify_all()

    def _opened(self, number: int) -> _OpenSheet:
        sheet = self._sheets[number] if 0 <= number < len(self._sheets) else None
        if sheet is None:
            raise LookupError("That picture is not open yet.")
        return sheet

    def _keep(self, number: int, sheet: _OpenSheet, marks: UInt8Array) -> None:
        write_marks(self._place(number), marks, sheet.digest)

    def _place(self, number: int) -> Path:
        return self.folder / MARKS / f"{self.pictures[number].name}{SUFFIX}"

    def _note(self, sheet: _OpenSheet) -> None:
        """Marks changed; call it with the lock."""
        sheet.example = None
        sheet.turns += 1
        sheet.counted()
        self._marked += 1
        self._saved = None
        self._publish()
        self._changed.notify_all()

    def _closed(self) -> list[int]:
        return [n for n, sheet in enumerate(self._sheets) if sheet is None and n not in self._lost]

    def _marked_closed(self) -> list[int]:
        return [n for n in self._closed() if self._place(n).is_file()]

    def _is_wanted(self, number: int) -> bool:
        return number == self._first

    def _next_closed(self) -> int | None:
        """What is opened next: what is waited for, what is marked, then the others in order."""
        closed = self._closed()
        if self._first in closed:
            return self._first
        return next(iter(self._marked_closed() or closed), None)

    def _open(self, number: int) -> None:
        picture, place = self.pictures[number], self._place(number)
        done = len(self._sheets) - len(self._closed())
        self._say(f"opening picture {done + 1} of {len(self._sheets)}")
        try:
            rgb = picture.open()
            cells = self._extractor.cells(rgb)
            size, digest = shown_size(rgb.shape), file_sha256(picture.path)
            marks = read_marks(place, size, digest) if place.is_file() else np.zeros(size, np.uint8)
        except ValueError as error:
            logger.warning("%s", error)
            with self._changed:
                self._lost[number] = str(error)
                self._publish()
            return
        small = shown(rgb)
        thumb = Image.fromarray(small)
        thumb.thumbnail((THUMB_WIDTH, THUMB_WIDTH * 2), Image.Resampling.BOX)
        sheet = _OpenSheet(
            marks,
            digest=digest,
            shown=_jpeg(Image.fromarray(small), 88),
            thumb=_jpeg(thumb, 80),
            cells=cells,
            shape=rgb.shape,
        )
        with self._changed:
            sheet.counted()
            sheet.told(self._head)
            self._sheets[number] = sheet
            if marks.any():
                self._marked += 1
            self._publish()

    def _examples(self) -> tuple[int, list[Example]]:
        """The count of changes, and the marked pictures as they are then."""
        with self._changed:
            at = self._marked
            found = [(n, sheet) for n, sheet in enumerate(self._sheets) if sheet and sheet.marks.any()]
            marks = [sheet.marks for _, sheet in found]
        examples = []
        for (n, sheet), drawn in zip(found, marks, strict=True):
            example = sheet.example
            if example is None or example.marks is not drawn:
                example = Example.of(self.pictures[n].name, sheet.cells, drawn)
                sheet.example = example
            examples.append(example)
        return at, examples

    def _learn(self) -> None:
        """A head by the penalty and scale that were found last, so that it is there at once."""
        at, examples = self._examples()
        lacks = lacking(examples)
        if not lacks:
            self._say("learning")
            last = self._taught
            head = self._lesson(examples).learned(
                last.choice if last else fit.USUAL,
                last.scale if last else fit.SCEPTICAL,
                last.offset if last else 0.0,
            )
            self._show(head)
        else:
            self._show(None)
        with self._changed:
            self._lacks, self._learned = lacks, at
            if lacks:
                self._measured, self._taught = at, None
            self._say("")
            self._changed.notify_all()

    def _lesson(self, examples: Sequence[Example]) -> HeadLesson:
        return HeadLesson(examples, self._extractor.backbone.channels)

    def _measure(self) -> None:
        at, examples = self._examples()
        if lacking(examples):
            with self._changed:
                self._measured = at
            return
        self._say("measuring")
        began = time.monotonic()
        taught = self._lesson(examples).measured(
            self._extractor,
            lambda: self._over or self._marked != at or self._first in self._closed(),
        )
        if taught is None:
            return
        self._show(taught.head)
        with self._changed:
            self._taught, self._measured = taught, at
            self._seconds = time.monotonic() - began
            self._say("")
            self._changed.notify_all()

    def _show(self, head: Head | None) -> None:
        self._head = head
        self._heads += 1
        for sheet in self._sheets:
            if sheet is not None:
                sheet.told(head)

    def _say(self, doing: str) -> None:
        with self._changed:
            self._doing = doing
            self._publish()

    def _publish(self) -> None:
        """Make the view anew; call it with the lock, or before anybody else has the session."""
        taught = self._taught if self._measured == self._marked else None
        quality = None
        held = {}
        if taught is not None:
            quality = {key: getattr(taught.quality, key) for key in ("iou", "low", "high", "why")}
            held = {one.name: one for one in taught.quality.held}
        pictures = []
        for n, picture in enumerate(self.pictures):
            sheet = self._sheets[n]
            one = held.get(picture.name)
            pictures.append(
                {
                    "name": picture.name,
                    "open": sheet is not None,
                    "lost": self._lost.get(n, ""),
                    "size": list(sheet.marks.shape[::-1]) if sheet else None,
                    "target": sheet is not None and sheet.has[0],
                    "other": sheet is not None and sheet.has[1],
                    "back": bool(sheet and sheet.before),
                    "turns": sheet.turns if sheet else 0,
                    "iou": one.iou if one else None,
                    "wrong": one.wrong if one else None,
                    "unsure": sheet.unsure if sheet else None,
                    "labelled": bool(sheet and sheet.logits is not None),
                }
            )
        told = {
            "target": self.name,
            "pictures": pictures,
            "heads": self._heads,
            "doing": self._doing,
            "lacks": self._lacks or ("mark some target" if not any(p["target"] for p in pictures) else ""),
            "quality": quality,
            "seconds": self._seconds,
            "saved": self._saved,
            "model": str(self.model),
        }
        self._view = SessionView(self._view.number + 1, told)


def card_of(
    extractor: Extractor, name: str, taught: TaughtHead, examples: Sequence[Example]
) -> dict[str, Any]:
    """What there is to say of how a model was taught, as JSON has it."""
    quality = taught.quality
    held = {one.name: one for one in quality.held}
    return {
        "target": name,
        "backbone": extractor.backbone.name,
        "backbone_sha256": extractor.backbone.sha256,
        "penalty": taught.choice.penalty,
        "sees": "colour and texture" if taught.choice.plain else "the backbone, colour and texture",
        "scale": taught.scale,
        "offset": taught.offset,
        "iou": quality.iou,
        "iou_low": quality.low,
        "iou_high": quality.high,
        "iou_is": quality.why
        or "mean over marked pictures with target, each told by all others; over marked pixels alone; "
        "95 % interval by Student's t over pictures",
        "pictures": [
            {
                "name": one.name,
                "target_pixels": int((one.marks == TARGET).sum()),
                "other_pixels": int((one.marks == OTHER).sum()),
                "iou": held[one.name].iou if one.name in held else None,
                "wrong": held[one.name].wrong if one.name in held else None,
            }
            for one in examples
        ],
    }


def _jpeg(image: Image.Image, quality: int) -> bytes:
    content = io.BytesIO()
    image.save(content, "jpeg", quality=quality)
    return content.getvalue()


def _overlay(values: UInt8Array, inside: int, edge: int) -> bytes:
    """PNG of `TARGET` and `OTHER` in their colours over nothing, with firmer edges."""
    paint = values.copy()
    for value in (TARGET, OTHER):
        where: npt.NDArray[np.bool_] = values == value
        paint[where & ~binary_erosion(where, iterations=1, border_value=1)] = value + 2
    image = Image.fromarray(paint).convert("P")
    image.putpalette([0, 0, 0, *COLORS[TARGET], *COLORS[OTHER], *COLORS[TARGET], *COLORS[OTHER]])
    content = io.BytesIO()
    image.save(content, "png", transparency=bytes([0, inside, inside, edge, edge]), compress_level=1)
    return content.getvalue()
