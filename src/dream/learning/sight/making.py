"""All of it in order: the pictures, what is learned from them, the marks, the network and its card."""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
from collections.abc import Generator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from dream import __version__
from dream.evaluation.engines import Engine
from dream.evaluation.locks import alone_at
from dream.evaluation.machine import libraries
from dream.files import write_whole
from dream.learning.claims import claim
from dream.learning.curriculum import Progress
from dream.learning.export import check_installed
from dream.learning.network import import_torch
from dream.learning.sight.export import as_onnx
from dream.learning.sight.network import Shape
from dream.learning.sight.pictures import SEEDS, Album, drawn
from dream.learning.sight.training import SightTraining, fit, marks
from dream.learning.training import device_named
from dream.perception.sight import DEPTH, FEATURES, GRID, HEIGHT, LABELS, PICTURE, VIEW, WIDTH

MODEL, CARD = "sight.onnx", "sight.json"
CODE = ("pictures.py", "waters.py", "network.py", "training.py")
"""Of this package: what a network comes from."""


@dataclass(frozen=True, slots=True)
class Making:
    """What is learned from, and how."""

    albums: int = 16
    """Files of pictures to learn from; one more is for the marks."""
    seed: int = 0
    worlds: int = 40
    """In an album."""
    views: int = 10
    """Of each world."""
    shape: Shape = field(default_factory=Shape)
    training: SightTraining = field(default_factory=SightTraining)

    def __post_init__(self) -> None:
        for name in ("albums", "worlds", "views"):
            if not 1 <= getattr(self, name) <= 10_000:
                raise ValueError(f"{name}: expected 1 to 10000, got {getattr(self, name)}")
        if self.seed < 0:
            raise ValueError(f"seed: expected 0 or more, got {self.seed}")

    def books(self) -> list[Album]:
        """All albums; nothing is learned from the last."""
        return [Album(k, self.worlds, self.views, self.seed) for k in range(self.albums + 1)]


def make(making: Making, folder: Path, engine: Engine, device: str) -> Generator[Progress, None, None]:
    """Do all of it, and leave the network and its card in a folder.

    Whatever interrupts it, the same call goes on where it was, and ends with the same network.

    Args:
        making: What to do.
        folder: Of the pictures and the network.
        engine: Where pictures are drawn.
        device: Where the network learns; see `learning.training.device_named`.

    Raises:
        ValueError: The folder is of another making, or something that is needed is not installed.
        OSError: The folder cannot be written.
    """
    import_torch()
    check_installed()
    device = device_named(device)
    with alone_at(folder, folder / ".lock"):
        _claim(folder, making)
        books = making.books()
        pictures = folder / "pictures"
        with contextlib.closing(drawn(books, pictures, engine)) as files:
            for done, _ in enumerate(files, start=1):
                yield Progress("albums of pictures", done, len(books))
        *learned, held_out = [book.file(pictures) for book in books]
        network = making.shape.build(making.seed)
        state = folder / "state.pt"
        for batch in fit(network, learned, making.training, device=device, kept=state):
            told = f"labels {batch.labels:.3f}, depth {batch.depth:.3f}"
            yield Progress("batches", batch.number, making.training.batches, told)
        model = as_onnx(making.shape, network)
        marked = marks(network, held_out, making.training)
        card = _card(making, model, marked, sum(p.numel() for p in network.parameters()))
        write_whole(folder / MODEL, model)
        write_whole(folder / CARD, (json.dumps(card, indent=2) + "\n").encode())
        yield Progress("network and card", 1, 1, f"mean IoU {marked['mean_iou']:.2f}")


def _claim(folder: Path, making: Making) -> None:
    """The folder is of this making, or becomes it: pictures of another would make another network."""
    digest = hashlib.sha256()
    for name in CODE:
        digest.update((Path(__file__).parent / name).read_bytes())
    made_by = {"version": __version__, "code": digest.hexdigest(), **libraries(), "torch": version("torch")}
    plan = json.loads(json.dumps({**made_by, **asdict(making)}))
    claim(folder, plan)


def _options(making: Making) -> list[str]:
    """What `dream train sight` is to be told, where that is not as it would do anyway."""
    usual = Making()
    told = {"albums": making.albums, "batches": making.training.batches, "seed": making.seed}
    as_ever = {"albums": usual.albums, "batches": usual.training.batches, "seed": usual.seed}
    return [f"--{name} {value}" for name, value in told.items() if value != as_ever[name]]


def _card(making: Making, model: bytes, marked: Mapping[str, Any], parameters: int) -> dict[str, Any]:
    """What a user of the network has to know."""
    count = making.albums * making.worlds
    return {
        "name": "sight",
        "what": "Labels (water, seabed, target, obstacle) and metric depth of each pixel, with a confidence "
        "in both, from colours, intrinsics, altitude and attitude.",
        "sha256": hashlib.sha256(model).hexdigest(),
        "bytes": len(model),
        "parameters": parameters,
        "input": {
            PICTURE: {"shape": [1, 3, HEIGHT, WIDTH], "means": "sRGB in [0, 1]"},
            VIEW: {"shape": [1, 3, HEIGHT, WIDTH], "means": "dream.perception.sight.planes; 0 where unknown"},
        },
        "output": {
            LABELS: {"shape": [1, 4, HEIGHT, WIDTH], "means": "scores before a softmax"},
            DEPTH: {"shape": [1, 2, *GRID], "means": "log of depth over the flat floor's, log of its error"},
            FEATURES: {"shape": [1, making.shape.features, *GRID], "means": "for dream teach"},
        },
        "data": {
            "pictures": f"{count * making.views} views of {count} simulated worlds, reefs and wrecks",
            "seeds": f"from {SEEDS}; no suite has any of them",
            "real": "none: no picture of a real sea was learned from",
            "waters": "drawn anew for each batch; dream.learning.sight.waters",
        },
        "marks": dict(marked),
        "knows_not": "Fish, plants, divers and whatever else a simulated sea has none of.",
        "making": json.loads(json.dumps(asdict(making))),
        "made_with": {
            "dream": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("torch", "onnx", "numpy")},
        },
        "command": " ".join(["dream train sight", *_options(making)]),
        "licence": "Apache-2.0",
    }
