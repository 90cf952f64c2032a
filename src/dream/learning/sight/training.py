"""How the network learns to see, and how well it does on pictures that it never learned from."""

from __future__ import annotations

import math
import multiprocessing
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dream.files import whole_or_nothing
from dream.learning.network import import_torch
from dream.learning.sight.network import COARSE
from dream.learning.sight.pictures import opened
from dream.learning.sight.waters import FINER, SightLesson, lesson
from dream.learning.training import hash_of
from dream.perception.depth import KNOWN_TO
from dream.perception.sight import DEPTH, FARTHEST, LABELS, NEAREST
from dream.types import Label

if TYPE_CHECKING:
    from torch import Tensor
    from torch.nn import Module

KEPT_EVERY = 250
"""Batches between two states that are kept: some minutes on one core."""
TOLD_EVERY = 25
"""Batches between two reports."""
AHEAD = 2
"""Batches that are made before they are asked for."""
COUNTS = 1.0, 1.0, 3.0, 5.0
"""Of a pixel of each label in the loss."""
NEAR = 8.0
"""Metres within which depths are marked."""
CLOSE = 6.0
"""Metres within which targets are."""


@dataclass(frozen=True, slots=True)
class SightTraining:
    """How it learns.

    What it does: lessens the cross-entropy of the labels, in which rare ones count more, and the negative log
    likelihood of the depth's logarithm under a Laplace distribution, whose width it tells itself (Kendall and
    Gal, NeurIPS 2017; weighed as by Seitzer et al., ICLR 2022), by AdamW with a rate that rises shortly and
    falls as a cosine. Each batch is drawn from all pictures, in waters drawn anew; first at half the size and
    in clear water, last as pictures come.
    """

    batches: int = 2900
    coarse: float = 0.6
    """Share of the batches that come first, at half the size: a quarter of the work a picture. Waters get
    murkier all along it."""
    batch: int = 16
    """Pictures; three times as many at half the size."""
    rate: float = 3e-3
    """The greatest on the way."""
    warmup: int = 300
    """Batches until it is reached."""
    decay: float = 0.02
    """Of the weights."""
    depth: float = 0.3
    """What the depth counts beside the labels."""
    coarsely: float = 0.4
    """What labels at a quarter of the picture count."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("batches", "batch", "warmup"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise ValueError(f"seed: expected 0 or more, got {self.seed}")
        for name in ("rate", "depth", "coarsely"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected more than 0, got {getattr(self, name)}")

    def size_at(self, batch: int) -> tuple[int, int, float]:
        """Of a batch from 0: pictures, by how much they are shrunk, and how hard they are."""
        first = self.coarse * self.batches
        return (3 * self.batch, 2, batch / first) if batch < first else (self.batch, 1, 1.0)

    def rate_at(self, batch: int) -> float:
        """Of learning, at a batch from 0."""
        rises = min(1.0, (batch + 1) / self.warmup)
        return self.rate * rises * 0.5 * (1.0 + math.cos(math.pi * batch / self.batches)) + 1e-5


@dataclass(frozen=True, slots=True)
class Batch:
    """How far training is."""

    number: int
    """Batches that are done."""
    labels: float
    """Mean cross-entropy since the last report."""
    depth: float
    """Mean error of the depth's logarithm since then."""


@dataclass(frozen=True, slots=True)
class Lessons:
    """Batches of a training by their number."""

    albums: tuple[Path, ...]
    """Files of pictures."""
    training: SightTraining
    device: str

    def __call__(self, number: int) -> SightLesson:
        """The batch of a number, from 0; the same whenever it is asked for."""
        pages = [opened(path) for path in self.albums]
        ends = np.cumsum([len(page) for page in pages])
        rng = np.random.default_rng([self.training.seed, number])
        count, shrunk, hard = self.training.size_at(number)
        chosen = rng.integers(0, int(ends[-1]), count)
        page = np.searchsorted(ends, chosen, side="right")
        at = chosen - np.concatenate([[0], ends[:-1]])[page]
        pictures = np.stack([pages[p][k] for p, k in zip(page.tolist(), at.tolist(), strict=True)])
        seed = hash_of(self.training.seed, number)
        return lesson(pictures, seed, self.device, shrunk=shrunk, hard=hard)

    def in_turn(self, first: int) -> Generator[SightLesson, None, None]:
        """From a number on. Without a GPU they are made in a process of their own, ahead of what is asked."""
        numbers = range(first, self.training.batches)
        if self.device != "cpu":
            yield from map(self, numbers)
            return
        torch = import_torch()
        with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as other:
            ahead: deque[Any] = deque()
            try:
                for number in numbers:
                    ahead.append(other.submit(_as_arrays, self, number))
                    if len(ahead) > AHEAD:
                        yield SightLesson(*map(torch.from_numpy, ahead.popleft().result()))
                while ahead:
                    yield SightLesson(*map(torch.from_numpy, ahead.popleft().result()))
            finally:
                other.shutdown(cancel_futures=True)


def _as_arrays(lessons: Lessons, number: int) -> list[npt.NDArray[Any]]:
    """A batch as it goes from one process to the other."""
    import_torch().set_num_threads(1)
    made = lessons(number)
    return [getattr(made, field.name).numpy() for field in fields(made)]


def planes(given: SightLesson) -> Tensor:
    """(n, 3, H, W): `dream.perception.sight.planes` of a batch."""
    view, floor = _view(given)
    torch = import_torch()
    known = torch.isfinite(given.altitude).view(-1, 1, 1)
    width = (0.5 * given.rgb.shape[3] / given.camera[:, 0] - 0.8).view(-1, 1, 1).expand_as(floor)
    stacked = torch.stack([1.0 / (1.0 + 0.5 * floor) - 0.4, view, width], 1)
    return torch.where(known.unsqueeze(1), stacked, torch.zeros_like(stacked))


def _view(given: SightLesson, every: int = 1) -> tuple[Tensor, Tensor]:
    """(n, h, w) share of each metre along the ray that leads down, and metres to the flat floor.

    Of every so many pixels, from the middle of the first of them.
    """
    torch = import_torch()
    device = given.rgb.device
    fx, fy, cx, cy = (given.camera[:, k].view(-1, 1, 1) for k in range(4))
    cols, rows = (
        torch.arange(every // 2, side, every, device=device) + 0.5
        for side in (given.rgb.shape[3], given.rgb.shape[2])
    )
    right, below = (cols.view(1, 1, -1) - cx) / fx, (rows.view(1, -1, 1) - cy) / fy
    x, y, z = (given.down[:, k].view(-1, 1, 1) for k in range(3))
    down = x * right + y * below + z
    straight = torch.sqrt(1.0 + right**2 + below**2)
    floor = given.altitude.view(-1, 1, 1) / down.clamp(min=1e-3)
    floor = torch.where(down > 1e-3, floor, torch.full_like(floor, FARTHEST)).clamp(NEAREST, FARTHEST)
    return down / straight, floor


def losses(network: Any, given: SightLesson, training: SightTraining) -> tuple[Tensor, float, float]:
    """What is to be lessened, and its parts: cross-entropy, mean error of the depth's logarithm."""
    torch = import_torch()
    picture = (given.rgb.float() / 255.0).contiguous(memory_format=torch.channels_last)
    said = network(picture, planes(given).contiguous(memory_format=torch.channels_last))
    labels = _missed(said[LABELS], given.labels.long())
    coarse = _missed(said[COARSE], given.labels[:, FINER // 2 :: FINER, FINER // 2 :: FINER].long())
    ratio, error = _logarithms(said[DEPTH], given)
    width = said[DEPTH][:, 1].clamp(-5.0, 3.0)
    # Times the width itself: else depths that are nearly right would outweigh all labels (β-NLL with β = 1).
    likelihood = (error.abs() * torch.exp(-width) + width) * torch.exp(width).detach()
    learned = torch.isfinite(ratio)
    count = learned.sum().clamp(min=1)
    depth = torch.where(learned, likelihood, torch.zeros_like(likelihood)).sum() / count
    off = torch.where(learned, error.detach().abs(), torch.zeros_like(error)).sum() / count
    return labels + training.coarsely * coarse + training.depth * depth, float(labels.detach()), float(off)


def _missed(scores: Tensor, truth: Tensor) -> Tensor:
    """Cross-entropy in which a rare label counts more.

    With the logarithms of its weights added to the scores it is least where these are the logarithms of true
    probabilities, as without weights (logit adjustment: Menon et al., ICLR 2021).
    """
    counts = scores.new_tensor(COUNTS)
    adjusted = scores.float() + counts.log().view(1, -1, 1, 1)
    missed: Tensor = import_torch().nn.functional.cross_entropy(adjusted, truth, weight=counts)
    return missed


def _logarithms(depth: Tensor, given: SightLesson) -> tuple[Tensor, Tensor]:
    """(n, h, w): that of true depth over the floor's, NaN where there is none; and how far off it is."""
    torch = import_torch()
    _, floor = _view(given, FINER)
    ratio = torch.log(given.depth / floor)
    return ratio, torch.where(torch.isfinite(ratio), depth[:, 0] - ratio, torch.zeros_like(ratio))


def fit(
    network: Module,
    albums: Sequence[Path],
    training: SightTraining,
    *,
    device: str = "cpu",
    kept: Path,
) -> Generator[Batch, None, None]:
    """Teach a network, and yield as it goes. The same again for the same seed and machine.

    Args:
        network: Changed as it goes; left on the processor, fit to be used.
        albums: Files of pictures.
        training: How.
        device: Where to compute, as PyTorch names it.
        kept: A file to keep the state in. Where it is there already training goes on from it, and comes out
            as if it had never been broken off.
    """
    torch = import_torch()
    network.to(device=device, memory_format=torch.channels_last).train()
    optimizer = torch.optim.AdamW(network.parameters(), lr=training.rate, weight_decay=training.decay)
    done = _resume(kept, network, optimizer, device)
    lessons = Lessons(tuple(albums), training, device)
    parts: list[tuple[float, float]] = []
    for number, given in enumerate(lessons.in_turn(done), start=done + 1):
        for group in optimizer.param_groups:
            group["lr"] = training.rate_at(number - 1)
        loss, *told = losses(network, given, training)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 5.0)
        optimizer.step()
        parts.append((told[0], told[1]))
        if number % KEPT_EVERY == 0 or number == training.batches:
            with whole_or_nothing(kept) as partial:
                torch.save(
                    {"network": network.state_dict(), "optimizer": optimizer.state_dict(), "done": number},
                    partial,
                )
        if number % TOLD_EVERY == 0 or number == training.batches:
            labels, depth = np.mean(parts, axis=0)
            parts = []
            yield Batch(number, float(labels), float(depth))
    network.to(device="cpu", memory_format=torch.contiguous_format).eval()


def _resume(path: Path, network: Any, optimizer: Any, device: str) -> int:
    """Batches that are done."""
    if not path.is_file():
        return 0
    try:
        state = import_torch().load(path, map_location=device, weights_only=True)
        network.load_state_dict(state["network"])
        optimizer.load_state_dict(state["optimizer"])
        return int(state["done"])
    except Exception as error:  # what a damaged file makes PyTorch raise is not of one kind.
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(
            f"{path}: expected the state of this network's training, got a damaged or foreign file ({line}). "
            "Delete it to begin again"
        ) from error


def marks(network: Any, album: Path, training: SightTraining, device: str = "cpu") -> Mapping[str, Any]:
    """How well it sees pictures that it did not learn from, in waters of the same laws.

    Intersection over union of each label and their mean, that of targets within `CLOSE`; mean relative error
    and share within a factor of 1.25 of depths within `NEAR`; mean confidence in labels and in depths, beside
    the share of each that is right.
    """
    torch = import_torch()
    network.to(device).eval()
    pictures = opened(album)
    counts = np.zeros((len(Label), 2))
    close, sure, near = np.zeros(2), np.zeros(3), np.zeros(3)
    off: list[float] = []
    right: list[float] = []
    for at in range(0, len(pictures), training.batch):
        given = lesson(
            np.asarray(pictures[at : at + training.batch]), hash_of(training.seed + 1, at), device, plain=True
        )
        with torch.inference_mode():
            said = network(given.rgb.float() / 255.0, planes(given))
        shares = said[LABELS].softmax(1)
        labels, truth = shares.argmax(1), given.labels.long()
        for label in Label:
            one, other = labels == label, truth == label
            counts[label] += float((one & other).sum()), float((one | other).sum())
        sure += float(shares.amax(1).sum()), float((labels == truth).sum()), labels.numel()
        coarse, told = (x[:, FINER // 2 :: FINER, FINER // 2 :: FINER] for x in (labels, truth))
        within = given.depth < CLOSE
        one, other = (coarse == Label.TARGET) & within, (told == Label.TARGET) & within
        close += float((one & other).sum()), float((one | other).sum())
        ratio, error = _logarithms(said[DEPTH], given)
        seen = torch.isfinite(ratio) & (given.depth < NEAR)
        times = torch.exp(error[seen])
        off += (times - 1.0).abs().tolist()
        right += (torch.maximum(times, 1.0 / times) < 1.25).float().tolist()
        width = torch.exp(said[DEPTH][:, 1].clamp(-8.0, 8.0))[seen]
        near += (
            float((1.0 - torch.exp(-math.log(KNOWN_TO) / width)).sum()),
            float((error[seen].abs() < math.log(KNOWN_TO)).sum()),
            float(seen.sum()),
        )
    union = counts[:, 0] / np.maximum(counts[:, 1], 1.0)
    return {
        "pictures": len(pictures),
        "iou": {label.name.lower(): round(float(union[label]), 4) for label in Label},
        "mean_iou": round(float(union.mean()), 4),
        "target_iou_within_6_m": round(float(close[0] / max(close[1], 1.0)), 4),
        "depth_relative_error_within_8_m": round(float(np.mean(off)), 4),
        "depth_within_a_quarter": round(float(np.mean(right)), 4),
        "labels": {"confidence": round(sure[0] / sure[2], 4), "right": round(sure[1] / sure[2], 4)},
        "depths": {
            "confidence": round(near[0] / max(near[2], 1.0), 4),
            "right": round(near[1] / max(near[2], 1.0), 4),
        },
    }
