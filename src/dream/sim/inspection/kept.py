"""What takes minutes to work out about a world is kept in the user's cache."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream import arrays
from dream.files import whole_or_nothing
from dream.protocol import SurveyProtocol
from dream.sim.files import world_hash
from dream.sim.world import World

BoolArray = npt.NDArray[np.bool_]
Array = npt.NDArray[Any]

RULE = 1
"""Counts the rules by which it was worked out: raised with every change, so that nothing old is taken."""


def folder() -> Path:
    """`$DREAM_CACHE`, or `dream-auv` in `$XDG_CACHE_HOME`, or in `~/.cache`."""
    beside = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache") / "dream-auv"
    return Path(os.environ.get("DREAM_CACHE") or beside).expanduser()


def countable(world: World, protocol: SurveyProtocol, work_out: Callable[[], BoolArray]) -> BoolArray:
    """(N,) `Inspection.countable`, from the cache or worked out and put there.

    A file that cannot be read or is another's is worked out anew; a folder that cannot be written to keeps
    nothing.
    """
    path = _path("countable", world, protocol, ".npy")
    with contextlib.suppress(OSError, ValueError):
        return arrays.read(path, "which individuals count", (len(world.targets),), np.bool_)
    result = work_out()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_or_nothing(path) as partial, partial.open("wb") as file:
            np.save(file, result)
    return result


def tables(
    name: str, world: World, protocol: SurveyProtocol, work_out: Callable[[], Mapping[str, Array]]
) -> Mapping[str, Array]:
    """Several arrays by name, likewise, packed; `name` says what they are."""
    path = _path(name, world, protocol, ".npz")
    with contextlib.suppress(OSError, ValueError), arrays.opened(path, f"the {name} of a world") as kept:
        return dict(kept)
    result = work_out()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_or_nothing(path) as partial, partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **result)
    return result


def _path(name: str, world: World, protocol: SurveyProtocol, suffix: str) -> Path:
    """Of a file in the cache, by the world and by what of the protocol matters."""
    # Names, noise and errors have no part in the geometry.
    rules = replace(protocol, name="", noise=None, lasting=None, swims=False)
    key = hashlib.sha256(f"{RULE} {world_hash(world)} {rules!r}".encode()).hexdigest()
    return folder() / f"{name}-{key[:32]}{suffix}"
