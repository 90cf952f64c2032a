"""The student: a small convolutional network from one picture to the odds of seven turns.

Only what is called here needs PyTorch; importing this module does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dream import extras
from dream.learning.expert import TURNS
from dream.perception.representation import HEIGHT, WIDTH

if TYPE_CHECKING:
    import torch

MOST_PARAMETERS = 700_000
PLANES = 2
"""Of the picture: nearness and share of target."""


def import_torch() -> Any:
    """PyTorch; a ValueError that says how to get it where it is missing."""
    try:
        import torch
    except ImportError as error:
        raise ValueError(extras.missing("train", "torch", "train")) from error
    return torch


@dataclass(frozen=True, slots=True)
class Network:
    """The shape of the student.

    What it does: convolutions that halve the picture, each with a batch norm and a rectifier; then, with
    the place of everything kept, one hidden layer and a number for each turn. The odds of the turns are the
    exponentials of those numbers.

    Reference: UIVNav (arXiv 2309.08806) publishes no network; this one is ours.
    """

    channels: tuple[int, ...] = (16, 32, 64, 96)
    """After each halving."""
    hidden: int = 128
    dropout: float = 0.2
    """Share of the hidden layer's inputs that a step of training leaves out."""

    def __post_init__(self) -> None:
        if not self.channels or min(self.channels) < 1 or self.hidden < 1:
            raise ValueError(
                f"channels: expected one or more layers of at least 1, got {self.channels} and a hidden "
                f"layer of {self.hidden}"
            )
        if self.parameters >= MOST_PARAMETERS:
            raise ValueError(
                f"channels: expected fewer than {MOST_PARAMETERS} parameters, got {self.parameters}. "
                "Take fewer channels, or a smaller hidden layer"
            )
        if not 0.0 <= self.dropout < 1.0:
            raise ValueError(f"dropout: expected a share of 0 to less than 1, got {self.dropout}")

    @property
    def features(self) -> int:
        """Numbers after the last halving."""
        height, width = HEIGHT, WIDTH
        for _ in self.channels:
            height, width = (height + 1) // 2, (width + 1) // 2
        return self.channels[-1] * height * width

    @property
    def parameters(self) -> int:
        """Weights and biases that are learned."""
        pairs = zip((PLANES, *self.channels), self.channels, strict=False)
        convolutions = sum(9 * before * after + 2 * after for before, after in pairs)
        return convolutions + (self.features + 1) * self.hidden + (self.hidden + 1) * len(TURNS)

    def build(self, seed: int) -> torch.nn.Sequential:
        """With weights drawn from a seed: (n, 2, 72, 96) float32 in [0, 1] → (n, 7)."""
        torch = import_torch()
        nn = torch.nn
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            layers: list[Any] = []
            for before, after in zip((PLANES, *self.channels), self.channels, strict=False):
                convolution = nn.Conv2d(before, after, 3, stride=2, padding=1, bias=False)
                layers += [convolution, nn.BatchNorm2d(after), nn.ReLU()]
            layers += [nn.Flatten(), nn.Dropout(self.dropout), nn.Linear(self.features, self.hidden)]
            layers += [nn.ReLU(), nn.Linear(self.hidden, len(TURNS))]
            return nn.Sequential(*layers)
