"""Does the camera show what the vehicle sees now? Silent and frozen ones are told, dark ones named."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from dream.geometry import SE2, wrap_angle
from dream.robots.bluerov2.likeness import ENOUGH, Glance, Likeness, difference, glance, likeness
from dream.robots.bluerov2.navigation import Fix
from dream.robots.bluerov2.rov import Picture
from dream.types import Float32Array

STARES = 0.5
"""Seconds that pictures may lag behind a move, and then some."""
MOVED = 0.04
"""Metres or radians of a move that no picture survives to the last bit."""
AWAY = 0.15
"""Metres of a move after which most of a picture has changed: a step of 0.2 m may end a little early."""
HIGH = 0.1
"""The same as a share of the height above the floor, where that is more."""
TURNED = math.radians(25.0)
"""Radians of a turn, likewise: of one of 30°."""
STRIDE = 0.05
"""Metres between the places that pictures are kept of."""
SWING = math.radians(7.5)
"""Radians, likewise."""
KEPT = 40
"""Pictures that are kept to compare with."""
BETWEEN = 0.08
"""Seconds between two pictures that are looked at."""
PAIRS = 20
"""Pairs of pictures, one after the other, that noise is measured by."""
LEAP, TWIST = 0.1, math.radians(10.0)
"""Metres and radians from one beat to the next that no vehicle moves: the estimate was corrected."""
BLIND = 1.0
"""Seconds without a velocity over ground after which the estimate may go where the vehicle does not."""

SILENT = "camera: no pictures come"
FROZEN = "camera: the same picture while it moves"
DIM = "camera: too little to see to tell whether it is frozen"


class PictureStream(Protocol):
    """What is asked of a camera at every beat."""

    @property
    def connected(self) -> bool:
        """Did a picture come of late?"""

    @property
    def unchanged(self) -> float:
        """Seconds for which all pictures up to the newest are the same to the last bit."""

    def newest(self, max_age: float) -> Picture:
        """The newest one; asked for only where there is one."""


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the camera may have been when it saw a picture, of which nobody knows how late it comes."""

    x: float
    y: float
    yaw: float
    within: float
    """Metres around that."""
    swing: float
    """Radians to either side."""


class Sight:
    """Says at every beat whether the camera shows what the vehicle sees now.

    What it does: a camera of which nothing comes is told at once. One whose pictures are the same to the last
    bit is frozen as soon as the vehicle has moved and they have stayed the same for `STARES` seconds more.
    One whose pictures flicker is frozen if after a move of `AWAY` or `TURNED` the newest still shows what
    those of the way there showed (`likeness`); noise is what neighbouring pictures differ by. Steps add up:
    a picture is kept every `STRIDE` or `SWING`. Before such a move nobody can tell. Where there is too little
    texture nobody can tell either, and that is said.

    Assumes: it is asked several times a second, by one thread; pictures are not later than `STARES`, beyond
    the latency that the camera knows of.

    Fails when: what moves with the camera, such as a gripper, is a quarter of the view and half of what can
    be seen in it.
    """

    def __init__(self, camera: PictureStream) -> None:
        """Of a camera."""
        self._camera = camera
        self._unchanged, self._moved = 0.0, math.inf
        """Seconds of the same pictures: at the last beat, and when the vehicle had moved."""
        self._from: SE2 | None = None
        """Where it was when they began to be the same."""
        self._way: deque[tuple[float, SE2]] = deque(maxlen=1000)
        """When it was where, since `STARES` before the newest picture."""
        self._kept: deque[tuple[_Place, Glance]] = deque(maxlen=KEPT)
        self._newest: tuple[float, Glance] | None = None
        self._flicker: deque[Float32Array] = deque(maxlen=PAIRS)
        self._found = self._said = ""

    def __call__(self, fix: Fix) -> str:
        """What is wrong, in words that stay the same while it lasts; empty where nothing is."""
        pose = fix.T_world_base.se2
        stares = self._stares(pose)
        if not self._camera.connected:
            self._said = SILENT
            return self._said
        self._go(fix, pose)
        self._look(fix)
        self._said = self._found
        if stares and self._newest is not None:
            self._said = FROZEN if self._newest[1].textured >= ENOUGH else DIM
        return self._said

    @property
    def frozen(self) -> bool:
        """Did the camera show the same while the vehicle moved, at the last beat?"""
        return self._said == FROZEN

    def _stares(self, pose: SE2) -> bool:
        """Has it moved while all pictures are the same to the last bit?"""
        unchanged = self._camera.unchanged
        if self._from is None or unchanged < self._unchanged or unchanged == 0.0:
            self._from, self._moved = pose, math.inf
        self._unchanged = unchanged
        if max(pose.distance(self._from), abs(wrap_angle(pose.yaw - self._from.yaw))) > MOVED:
            self._moved = min(self._moved, unchanged)
        return unchanged - self._moved > STARES

    def _go(self, fix: Fix, pose: SE2) -> None:
        """Note where it is; what was kept is of no use where nobody knows how far that is from here."""
        before = self._way[-1][1] if self._way else pose
        leapt = before.distance(pose) > LEAP or abs(wrap_angle(pose.yaw - before.yaw)) > TWIST
        if leapt or fix.dvl_age > BLIND:
            self._way.clear()
            self._kept.clear()
        self._way.append((fix.time, pose))

    def _look(self, fix: Fix) -> None:
        """Take in the newest picture, where there is a new one."""
        picture = self._camera.newest(math.inf)
        if self._newest is not None and abs(picture.time - self._newest[0]) < BETWEEN:
            return
        seen = glance(picture.rgb)
        if self._newest is not None and (flicker := difference(self._newest[1], seen)).any():
            # What is the same to the last bit says nothing of noise: some cameras send pictures twice.
            self._flicker.append(flicker)
        self._newest = picture.time, seen
        while self._way[0][0] < picture.time - STARES and len(self._way) > 1:
            self._way.popleft()
        place = _place([pose for _, pose in self._way])
        away = max(AWAY, HIGH * fix.altitude)
        far = next((n for n in reversed(range(len(self._kept))) if _far(self._kept[n][0], place, away)), None)
        if far is not None:
            self._found = self._judged(seen, [kept for _, kept in self._kept][far:])
        if not self._kept or _stridden(self._kept[-1][0], place):
            self._kept.append((place, seen))

    def _judged(self, seen: Glance, way: list[Glance]) -> str:
        """By the pictures of a way, the first of which is from far enough."""
        noise = np.zeros(len(seen.texture), np.float32)
        if self._flicker:
            # The quieter ones: while it moves, neighbouring pictures differ by more than noise.
            noise = np.quantile(np.array(self._flicker), 0.25, axis=0)
        found = likeness(way[0], seen, noise)
        # Tiles look alike a tile farther on, but not halfway.
        if found is Likeness.CHANGED or any(
            likeness(kept, seen, noise) is Likeness.CHANGED for kept in way[1:]
        ):
            return ""
        return FROZEN if found is Likeness.SAME else DIM


def _place(poses: list[SE2]) -> _Place:
    """Around all of some poses, one of which is the newest."""
    x, y = (0.5 * (min(values) + max(values)) for values in zip(*((p.x, p.y) for p in poses), strict=True))
    last = poses[-1].yaw
    turns = [wrap_angle(pose.yaw - last) for pose in poses]
    within = max(math.hypot(pose.x - x, pose.y - y) for pose in poses)
    return _Place(x, y, last + 0.5 * (min(turns) + max(turns)), within, 0.5 * (max(turns) - min(turns)))


def _far(one: _Place, other: _Place, away: float) -> bool:
    """Is most of the view another, wherever of those places it was seen from?"""
    way = math.hypot(one.x - other.x, one.y - other.y) - one.within - other.within
    turn = abs(wrap_angle(one.yaw - other.yaw)) - one.swing - other.swing
    return way >= away or turn >= TURNED


def _stridden(one: _Place, other: _Place) -> bool:
    """Is it worth to keep a picture of both?"""
    way = math.hypot(one.x - other.x, one.y - other.y)
    return way >= STRIDE or abs(wrap_angle(one.yaw - other.yaw)) >= SWING
