"""Behaviour cloning: the student learns to give the odds that the teacher gives."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dream.files import whole_or_nothing
from dream.learning.network import import_torch
from dream.types import Float32Array, UInt8Array

if TYPE_CHECKING:
    import torch

CHUNK = 512
"""Pictures at a time where nothing is learned."""


@dataclass(frozen=True, slots=True)
class Training:
    """How the student learns.

    What it does: lessens the cross-entropy of its odds to the teacher's, which are first mixed with a
    little of even odds, by AdamW with a rate that rises once and falls once. Half of the pictures of each
    epoch are mirrored, with the turns to the other side.

    Assumes: pictures enough; that the teacher is no function of anything but the picture.
    """

    epochs: int = 8
    batch: int = 128
    rate: float = 2e-3
    """The greatest on the way."""
    decay: float = 0.02
    """Of the weights."""
    smoothing: float = 0.03
    """Share of even odds."""
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("epochs", "batch"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected at least 1, got {getattr(self, name)}")
        if self.seed < 0:
            raise ValueError(f"seed: expected 0 or more, got {self.seed}")
        if not 0.0 < self.rate < math.inf or not 0.0 <= self.decay < math.inf:
            raise ValueError(f"rate: expected above 0 and a decay from 0, got {self.rate} and {self.decay}")
        if not 0.0 <= self.smoothing < 1.0:
            raise ValueError(f"smoothing: expected 0 to less than 1, got {self.smoothing}")


@dataclass(frozen=True, slots=True)
class Epoch:
    """How far training is."""

    number: int
    """1 is the first."""
    loss: float
    """Mean cross-entropy over the epoch, with what is left out and smoothed."""


def device_named(name: str) -> str:
    """`auto` is a GPU where PyTorch finds one, else the processor.

    Raises:
        ValueError: PyTorch finds no such device.
    """
    torch = import_torch()
    if name == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError) as error:
        line = str(error).splitlines()[0]
        raise ValueError(f"--device: expected auto, cpu or cuda, got {name} ({line})") from error
    return name


def fit(
    student: torch.nn.Sequential,
    images: UInt8Array,
    odds: Float32Array,
    training: Training,
    *,
    device: str = "cpu",
    kept: Path | None = None,
) -> Iterator[Epoch]:
    """Teach a student, and yield after each epoch. The same again for the same seed and machine.

    Args:
        student: Changed as it goes; left on the processor, fit to be used.
        images: (n, 2, 72, 96) uint8.
        odds: (n, 7) the teacher's.
        training: How.
        device: Where to compute, as PyTorch names it.
        kept: A file to keep the state in after each epoch. Where it is there already training goes on from
            it, and comes out as if it had never been broken off.
    """
    torch = import_torch()
    if len(images) != len(odds) or len(images) < 2:
        raise ValueError(f"images: expected 2 or more, one for each of {len(odds)} odds, got {len(images)}")
    batch = min(training.batch, len(images))
    batches = len(images) // batch  # What is left over waits for the next epoch's order.
    # The order of the axes in memory that convolutions on a processor are quickest with.
    layout = torch.channels_last
    student.to(device=device, memory_format=layout)
    optimizer = torch.optim.AdamW(student.parameters(), lr=training.rate, weight_decay=training.decay)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, max_lr=training.rate, total_steps=training.epochs * batches
    )
    done = _resume(kept, student, optimizer, schedule, device)
    pictures, answers = torch.from_numpy(images), torch.from_numpy(np.asarray(odds, np.float32))
    with torch.random.fork_rng():
        for epoch in range(done + 1, training.epochs + 1):
            torch.manual_seed(hash_of(training.seed, epoch))
            student.train()
            order = torch.randperm(len(images))
            total = 0.0
            for k in range(batches):
                which = order[k * batch : (k + 1) * batch]
                x, y = pictures[which].to(device).float() / 255.0, answers[which].to(device)
                mirrored = torch.rand(len(which)).to(device) < 0.5
                x = torch.where(mirrored[:, None, None, None], x.flip(3), x).contiguous(memory_format=layout)
                y = torch.where(mirrored[:, None], y.flip(1), y)
                y = (1.0 - training.smoothing) * y + training.smoothing / y.shape[1]
                loss = torch.nn.functional.cross_entropy(student(x), y)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
                total += float(loss.detach())
            if kept is not None:
                _keep(kept, student, optimizer, schedule, epoch)
            yield Epoch(epoch, total / batches)
    student.to(device="cpu", memory_format=torch.contiguous_format).eval()


def hash_of(seed: int, number: int) -> int:
    """A seed for one of many uses of a seed."""
    return int(np.random.SeedSequence([seed, number]).generate_state(1, np.uint64)[0] >> 1)


def answers_of(student: torch.nn.Sequential, images: UInt8Array) -> Float32Array:
    """(n, 7) what a student that has learned says, on the processor, mirrored pictures averaged in.

    A turn to the left for a picture is one to the right for its mirror image, and the mean of both answers
    makes that exact.
    """
    torch = import_torch()
    student.eval()
    parts = []
    with torch.inference_mode():
        for at in range(0, len(images), CHUNK):
            x = torch.from_numpy(images[at : at + CHUNK]).float() / 255.0
            parts.append((0.5 * (student(x) + student(x.flip(3)).flip(1))).numpy())
    answered: Float32Array = np.concatenate(parts)
    return answered


def _keep(path: Path, student: Any, optimizer: Any, schedule: Any, epoch: int) -> None:
    torch = import_torch()
    state = {
        "student": student.state_dict(),
        "optimizer": optimizer.state_dict(),
        "schedule": schedule.state_dict(),
        "epoch": epoch,
    }
    with whole_or_nothing(path) as partial:
        torch.save(state, partial)


def _resume(path: Path | None, student: Any, optimizer: Any, schedule: Any, device: str) -> int:
    """Epochs that are done."""
    if path is None or not path.is_file():
        return 0
    try:
        state = import_torch().load(path, map_location=device, weights_only=True)
        student.load_state_dict(state["student"])
        optimizer.load_state_dict(state["optimizer"])
        schedule.load_state_dict(state["schedule"])
        return int(state["epoch"])
    except Exception as error:  # what a damaged file makes PyTorch raise is not of one kind.
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise ValueError(
            f"{path}: expected the state of this student's training, got a damaged or foreign file ({line}). "
            "Delete it; its epochs are learned again"
        ) from error
