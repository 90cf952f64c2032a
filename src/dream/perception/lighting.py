"""Pictures → whether there is light in them."""

from __future__ import annotations

import statistics
from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from dream.types import Label, Observation, UInt8Array

BRIGHT = 90.0
"""Percentile of a picture's brightness that counts: what is nearest has the most light."""
BLACK = 12.0
"""Of 255: below that the brightest shows nothing but the camera's own noise, whatever the light."""
KNOWN = 4
"""Pictures after which it is known what is usual: as many as a mission first looks around by."""
DIM = 0.25
"""Share of the usual brightness below which a picture is dark."""
REMEMBERED = 20
"""Pictures that the usual brightness is the median of."""
RUNNING = 3
"""Dark pictures on end after which it is told: one may look into open water."""


def brightness(rgb: UInt8Array) -> float:
    """Of a picture (H, W, 3), 0 to 255."""
    return float(np.percentile(rgb.mean(axis=2), BRIGHT))


@dataclass(slots=True, eq=False)
class Lighting:
    """Tells when pictures become dark: a lamp that is out, a camera that sees nothing.

    What it does: a picture is dark where it is black, or has less than `DIM` of the median brightness of
    those before it that were not. Of a dark one nothing is believed. `RUNNING` of them on end are trouble.
    Fails when: light goes slowly, over more pictures than it remembers; a vehicle that brings its own light
    looks into open water for so long, or its pilot dims it. In dim water a lamp that is out leaves black.
    """

    trouble: str = ""
    """What is wrong; empty where nothing is. It stays, since what comes back may go again."""
    _usual: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    _dark: int = 0
    """Dark pictures on end."""
    _time: float = -1.0
    """Of the picture that was looked at last."""

    def seen(self, seen: Observation) -> Observation:
        """The observation with what may be believed of it; one of the same time as the last counts once."""
        bright = brightness(seen.rgb)
        known = len(self._usual) >= KNOWN
        usual = statistics.median(self._usual) if known else bright
        black = bright < BLACK
        dark = black or bright < DIM * usual
        if seen.time != self._time:
            self._time = seen.time
            self._dark = self._dark + 1 if dark else 0
            if not dark:
                self._usual.append(bright)
            if self._dark >= RUNNING and not self.trouble:
                share = f"{bright / usual:.0%} of the usual light" if known else "from the first pictures on"
                self.trouble = f"the camera is dark: {share}" if black else f"the lamp is out: {share}"
        return untold(seen) if dark else seen


def untold(seen: Observation) -> Observation:
    """The observation with its colours only: nothing is told of what they show."""
    return replace(
        seen,
        depth=np.full_like(seen.depth, np.nan),
        labels=np.full_like(seen.labels, Label.WATER),
        confidence=np.zeros(seen.depth.shape, np.float32),
        error=None if seen.error is None else np.full_like(seen.error, np.nan),
    )
