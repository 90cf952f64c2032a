"""Networks that steer, small enough to know what they do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from onnx import helper

from dream.perception.representation import HEIGHT, WIDTH
from dream.planning.baselines.uivnav import TURNS_DEG
from tests.perception.models import save

COUNT = len(TURNS_DEG)


def linear(path: Path, weights: npt.ArrayLike, bias: npt.ArrayLike = 0.0) -> Path:
    """Logits that are sums over the picture, weighted by (2, 72, 96, n)."""
    table = np.asarray(weights, np.float32)
    count = table.shape[-1]
    return save(
        path,
        [
            helper.make_node("Flatten", ["images"], ["flat"]),
            helper.make_node("Gemm", ["flat", "weights", "bias"], ["logits"]),
        ],
        {"weights": table.reshape(-1, count), "bias": np.broadcast_to(np.asarray(bias), count)},
        ["n", *table.shape[:-1]],
        {"logits": ["n", count]},
    )


def toward_the_target(path: Path) -> Path:
    """Turns to where most of the target is: one of seven strips, of which the rightmost is a right turn."""
    weights = np.zeros((2, HEIGHT, WIDTH, COUNT))
    for column in range(WIDTH):
        weights[1, :, column, COUNT - 1 - column * COUNT // WIDTH] = 1.0
    return linear(path, weights)


def always(path: Path, logits: npt.ArrayLike) -> Path:
    """The same scores whatever is seen."""
    return linear(path, np.zeros((2, HEIGHT, WIDTH, len(np.asarray(logits)))), logits)


def symmetrical(path: Path, seed: int = 0) -> Path:
    """Anything, but for a mirrored picture the mirrored scores."""
    weights = np.random.default_rng(seed).normal(size=(2, HEIGHT, WIDTH, COUNT))
    return linear(path, weights + weights[:, :, ::-1, ::-1])
