"""`dream teach`: a new target, taught with a few strokes on a few pictures."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from dream import extras
from dream.commands.console import check_writable, print_json
from dream.commands.progress import stage
from dream.errors import MissionAborted
from dream.options import First

if TYPE_CHECKING:
    from dream.teaching.model import Extractor
    from dream.teaching.pictures import Picture

MOST_PICTURES = 200
"""That are shown: each keeps its features in memory."""


@dataclass(frozen=True, slots=True)
class Teach:
    """Teach a new target in five minutes: mark it in a few pictures, and get a model that labels it.

    A page shows your pictures. With strokes or boxes you mark what is the target and what is not, in three
    to ten of them; at once you see what would be labelled in all others, and correct it. Save writes a model
    for `dream dive --labels`. Marks are kept as you make them: the same command goes on.

    How good it is it tells by leaving out one marked picture after the other, on marked pixels alone; with
    target in fewer than three pictures it tells nothing.

    Without a browser, paint a PNG for each picture, named as it is: white is target, black is not, all else
    is unmarked. Then say --marks.

    Examples:
        dream teach photos --name scallop
        dream teach runs/latest --name anchor
        dream teach photos --name scallop --marks masks
    """

    folder: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="FOLDER")]]
    """Folder of pictures (.jpg, .png), or of a run or dive."""
    name: First[str] = "target"
    """What the target is called."""
    out: First[Path | None] = None
    """Folder of marks and model. Unless given, teach/ and the name of FOLDER."""
    marks: First[Path | None] = None
    """Folder of marks that are ready, one PNG for each marked picture. Learns from them, without a page."""
    backbone: First[Path | None] = None
    """ONNX file of a network whose features are learned from, or the word texture for none. Unless given,
    the network that comes with DREAM."""
    pictures: First[int] = 60
    """Pictures at most. Of more, so many evenly spaced ones are shown, and all that are marked."""
    host: First[str] = "127.0.0.1"
    """Address at which to listen. 0.0.0.0 lets other machines connect; all need the token of the address."""
    port: First[int | None] = None
    """Port at which to listen. Unless given, 8412, or a free one where that is taken."""
    json: bool = False
    """Print one JSON object and nothing else: the page's address, or with --marks what was learned."""

    def __call__(self) -> int:
        """Exit status 0, once Ctrl-C ends the page, or the model of --marks is written."""
        from dream.teaching.backbone import open_backbone
        from dream.teaching.marks import check_name, marked_in
        from dream.teaching.model import Extractor
        from dream.teaching.pictures import chosen, pictures_in
        from dream.teaching.session import MARKS

        check_name(self.name)
        if not 1 <= self.pictures <= MOST_PICTURES:
            raise ValueError(f"--pictures: expected 1 to {MOST_PICTURES}, got {self.pictures}")
        if self.port is not None and not 0 <= self.port <= 65535:
            raise ValueError(f"--port: expected 0 to 65535, got {self.port}")
        out = self.out or Path("teach") / (self.folder.resolve().name or "pictures")
        every = pictures_in(self.folder)
        if self.marks is not None and not self.marks.is_dir():
            raise ValueError(f"--marks: expected a folder, got {self.marks}")
        marked = marked_in(self.marks or out / MARKS)
        if self.marks is not None:
            if not marked:
                raise ValueError(
                    f"--marks: expected a PNG named as a picture of {self.folder}, got none in {self.marks}"
                )
            kept = chosen(every, 0, marked)
        else:
            extras.check_installed("teach", "a page to teach on", "fastapi", "uvicorn")
            kept = chosen(every, self.pictures, marked)
        check_writable(out)
        with stage("opening the network"):
            extractor = Extractor(open_backbone(self.backbone))
        if self.marks is not None:
            return self._learned(kept, extractor, out, self.marks)
        return self._served(kept, extractor, out, of=len(every))

    def _served(self, pictures: list[Picture], extractor: Extractor, out: Path, of: int) -> int:
        """Show the page until Ctrl-C."""
        from dream.live.doors import Doors, is_loopback, made_token
        from dream.live.server import address, listen
        from dream.teaching.server import serve
        from dream.teaching.session import Session

        session = Session(pictures, extractor, out, self.name)
        doors = Doors(self.host, "" if is_loopback(self.host) else made_token())
        listening = listen(self.host, self.port)
        opened = address(doors, listening)
        with contextlib.suppress(KeyboardInterrupt):
            if self.json:
                print_json({"address": opened, "pictures": len(pictures), "of": of, "out": str(out)})
            else:
                some = f"{len(pictures)} of {of} pictures" if len(pictures) < of else f"{of} pictures"
                print(f"teach {self.name} on {some} at {opened}", flush=True)
                print(f"Ctrl-C ends it; marks are kept in {out}", flush=True)
            serve(session, doors, listening, lambda: False)
        if not self.json:
            saved = session.model.is_file()
            print(
                f"{session.model}: dream dive --labels {session.model}"
                if saved
                else f"No model was saved. The marks are kept in {out}; the same command goes on"
            )
        return 0

    def _learned(self, pictures: list[Picture], extractor: Extractor, out: Path, marks: Path) -> int:
        """Learn from marks that are ready."""
        from dream.perception.sight import file_sha256
        from dream.teaching.fit import Example, HeadLesson
        from dream.teaching.marks import SUFFIX, read_marks
        from dream.teaching.model import save
        from dream.teaching.pictures import shown_size
        from dream.teaching.session import card_of

        examples = []
        try:
            with stage("opening pictures", len(pictures)) as work:
                for picture in pictures:
                    rgb = picture.open()
                    path = marks / f"{picture.name}{SUFFIX}"
                    drawn = read_marks(path, shown_size(rgb.shape), file_sha256(picture.path))
                    if drawn.any():
                        examples.append(Example.of(picture.name, extractor.cells(rgb), drawn))
                    work.done += 1
            began = time.monotonic()
            with stage("learning"):
                taught = HeadLesson(examples, extractor.backbone.channels).measured(extractor)
        except KeyboardInterrupt:
            raise MissionAborted("aborted: interrupted; no model was written") from None
        assert taught is not None
        seconds = time.monotonic() - began
        model = out / f"{self.name}.onnx"
        card = card_of(extractor, self.name, taught, examples)
        save(model, extractor, taught.head, self.name, card)
        if self.json:
            print_json({"model": str(model), "seconds": seconds, **card})
        else:
            _print(card, model, seconds)
        return 0


def _print(card: dict[str, Any], model: Path, seconds: float) -> None:
    """What was learned, picture by picture."""
    for one in card["pictures"]:
        if one["iou"] is not None:
            said = f"IoU {one['iou']:.2f}"
        elif one["wrong"] is not None:
            said = f"no target marked; {one['wrong']:.0%} of its marks told wrongly"
        else:
            said = "not measured"
        print(f"  {one['name']}: {said}")
    if card["iou"] is None:
        print(f"How good it is was not measured: {card['iou_is']}")
    else:
        print(
            f"IoU {card['iou']:.2f}, 95 % interval {card['iou_low']:.2f} to {card['iou_high']:.2f} by t: "
            "each picture told by the others alone, over its marks, which are no full masks"
        )
    print(f"{model}, learned in {seconds:.1f} s: dream dive --labels {model}")
