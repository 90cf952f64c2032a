"""What others published about their own methods in their own simulators; never ranked with ours."""

from __future__ import annotations

from dataclasses import dataclass

DREAM_PAPER = "DREAM, arXiv 2509.13666"
CORAL_PAPER = "CORAL, arXiv 2603.14786"


@dataclass(frozen=True, slots=True)
class PublishedMethod:
    """One line of a table of the DREAM paper: means over its worlds."""

    name: str
    steps: float
    """Until the method stopped; 200 where it did not."""
    coverage: float
    """Per cent of the oysters, or of the wreck's area."""


@dataclass(frozen=True, slots=True)
class PublishedSuccessor:
    """One line of the table of the CORAL paper, on ten scenes of its own."""

    name: str
    coverage: float
    """Per cent."""
    time_s: float
    collisions: int
    vlm_calls: int


REEFS = (
    PublishedMethod("DREAM", 137.3, 98.26),
    PublishedMethod("vanilla GPT-5", 179.7, 90.59),
    PublishedMethod("UIVNav", 200.0, 55.46),
)
"""Table I of the DREAM paper: ten oyster scenes."""
WRECKS = (PublishedMethod("DREAM", 145.0, 100.0), PublishedMethod("vanilla GPT-5", 200.0, 60.23))
"""Table II of the DREAM paper: five wrecks."""
CORAL = (
    PublishedSuccessor("DREAM, as run by CORAL's authors", 80.00, 1513.2, 9, 1261),
    PublishedSuccessor("CORAL without its low level", 91.40, 687.0, 24, 770),
    PublishedSuccessor("CORAL", 94.28, 642.0, 0, 547),
)
