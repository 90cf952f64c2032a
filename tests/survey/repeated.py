"""A reef of known individuals, and surveys of it by chance: what a comparison meets, in milliseconds.

Each survey has a drift of its own, does not see all of the box, finds an individual by its looks and by how
well it shows, takes a few for individuals that are none, and draws outlines a little otherwise each time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from dream.geometry import Bounds
from dream.survey import Individuals, Layers, Patch, Picture, Survey, Track
from dream.survey.site import Site
from dream.types import Target

Float64Array = npt.NDArray[np.float64]

BOX = Bounds(0.0, 0.0, 40.0, 40.0)
CELL = 0.25
FINE = 0.05
SITE = Site("Test reef", 54.9, 8.3)
AREAS = ((9.0, 9.0, 4.0, 2.2), (28.0, 10.0, 3.0, 3.0), (10.0, 28.0, 2.5, 4.0), (29.0, 29.0, 5.0, 2.0))
"""Ellipses: middle and half-axes."""


@dataclass(frozen=True, slots=True)
class Reef:
    """Where individuals are, and how large."""

    position: Float64Array
    size: Float64Array
    patch: npt.NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Surveying:
    """How well a survey sees. All standard deviations in metres unless said."""

    drift: tuple[float, float, float] = (0.2, 0.15, math.radians(0.6))
    """East, north and turn about the middle."""
    place: float = 0.03
    looks: float = 12.0
    """Mean number of looks."""
    rate: float = 0.5
    """Chance to be found in one look, of the average one."""
    differing: float = 8.0
    """Sum of the two parameters of the beta distribution of that chance: few differ much when it is great."""
    false: float = 0.03
    """Share of those told that are none."""
    bias: float = 0.0
    """Relative standard deviation of the share found, of a whole patch at once."""
    edge: float = 0.1
    """Of outlines."""
    unseen: float = 0.04
    """Share of the box that it does not see, elsewhere each time."""


def reef(rng: np.random.Generator, density: float = 8.0) -> Reef:
    """Four patches; no two individuals nearer than a hand."""
    places, patches = [], []
    for number, (x, y, a, b) in enumerate(AREAS):
        pitch = 1.0 / math.sqrt(density)
        reach = max(a, b) + pitch
        grid = np.mgrid[-reach:reach:pitch, -reach:reach:pitch].reshape(2, -1).T
        grid = grid + rng.uniform(-0.35 * pitch, 0.35 * pitch, grid.shape)
        # Turned, so that no two reefs stand on the same lattice.
        angle = float(rng.uniform(0.0, math.pi))
        c, s = math.cos(angle), math.sin(angle)
        grid = grid @ np.array([[c, s], [-s, c]])
        grid = grid[(grid[:, 0] / a) ** 2 + (grid[:, 1] / b) ** 2 < 1.0]
        places.append(grid + np.array([x, y]))
        patches.append(np.full(len(grid), number, np.int32))
    position = np.concatenate(places)
    return Reef(position, rng.uniform(0.15, 0.35, len(position)), np.concatenate(patches))


def without(reef: Reef, patch: int, share: float, rng: np.random.Generator) -> Reef:
    """The reef after a share of the individuals of a patch died, here and there in it."""
    there = np.flatnonzero(reef.patch == patch)
    dead = rng.choice(there, round(share * len(there)), replace=False)
    kept = np.setdiff1d(np.arange(len(reef.patch)), dead)
    return Reef(reef.position[kept], reef.size[kept], reef.patch[kept])


def survey(
    reef: Reef, rng: np.random.Generator, seeing: Surveying | None = None, name: str = "one"
) -> Survey:
    """What one mission makes of it."""
    how = seeing or Surveying()
    drift = np.array(how.drift) * rng.normal(0.0, 1.0, 3)
    n = len(reef.position)
    looks = 1 + rng.poisson(how.looks - 1.0, n).astype(np.int32)
    shows = rng.beta(how.rate * how.differing, (1.0 - how.rate) * how.differing, n)
    share = np.clip(1.0 + how.bias * rng.normal(0.0, 1.0, len(AREAS)), 0.0, 1.5)[reef.patch]
    hits = rng.binomial(looks, shows).astype(np.int32)
    found = np.flatnonzero((hits > 0) & (rng.random(n) < share))
    # Where more are told than there are, some are told twice.
    twice = found[rng.random(len(found)) < share[found] - 1.0]
    false = rng.choice(found, rng.poisson(how.false * len(found)))
    told = np.concatenate([found, twice, false])
    off = np.zeros((len(told), 2))
    off[len(found) :] = rng.normal(0.0, 0.3, (len(told) - len(found), 2))
    place = _drifted(reef.position[told] + off + rng.normal(0.0, how.place, off.shape), drift)
    hit = hits[told].copy()
    hit[len(found) + len(twice) :] = 1
    individuals = Individuals(
        position=np.column_stack([place, np.full(len(told), -6.0)]),
        sigma=np.full(len(told), max(how.place, 0.02)),
        size=reef.size[told] * (1.0 + 0.05 * rng.normal(0.0, 1.0, len(told))),
        size_sigma=np.full(len(told), 0.01),
        hits=hit,
        looks=looks[told],
        confidence=np.clip(1.0 - how.false * 2.0 / hit, 0.0, 1.0),
        patch=reef.patch[told],
        clear=np.arange(len(told)) % 4 != 3,
    )
    state = _state(rng, how, drift)
    return Survey(
        name=name,
        began=datetime(2026, 6, 1, tzinfo=UTC),
        site=SITE,
        target=Target.OYSTERS,
        protocol="dream-v1",
        area=BOX,
        measures=(),
        individuals=individuals,
        patches=tuple(Patch((ring,), ()) for ring in _rings(drift)),
        layers=Layers(
            bounds=BOX,
            cell=CELL,
            state=state,
            target_probability=np.where(state == 0, np.nan, np.where(state == 2, 0.9, 0.1)).astype(
                np.float32
            ),
            relief=np.where(state == 0, np.nan, np.where(state == 2, 0.2, 0.0)).astype(np.float32),
            times_seen=np.where(state == 0, 0, 12).astype(np.uint16),
        ),
        track=Track(np.zeros(2), np.zeros((2, 3)), np.zeros(2), np.full(2, 0.1)),
        decisions=(),
        made_by={},
        picture=_picture(reef, rng, drift, state > 0),
    )


def _picture(
    reef: Reef, rng: np.random.Generator, drift: Float64Array, seen: npt.NDArray[np.bool_]
) -> Picture:
    """Discs where individuals are, found or not; one cell in fifty is told wrong."""
    count = round(BOX.width / FINE)
    covered = np.zeros((count, count), np.bool_)
    for (x, y), size in zip(_drifted(reef.position, drift), reef.size, strict=True):
        half = math.ceil(0.5 * size / FINE) + 1
        col, row = math.floor(x / FINE), math.floor(y / FINE)
        near = np.s_[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
        rows, cols = np.ogrid[near]
        covered[near] |= np.hypot(FINE * (cols + 0.5) - x, FINE * (rows + 0.5) - y) < 0.5 * size
    share = np.where(covered ^ (rng.random(covered.shape) < 0.02), 200, 0).astype(np.uint8)
    share[~np.kron(seen, np.ones((round(CELL / FINE),) * 2, np.bool_))] = 255
    return Picture(BOX, FINE, share)


def _drifted(points: Float64Array, drift: Float64Array) -> Float64Array:
    """Turned about the middle of the box, then shifted: what a survey takes the world for."""
    c, s = math.cos(drift[2]), math.sin(drift[2])
    x, y = (points - 20.0).T
    return np.column_stack([20.0 + drift[0] + c * x - s * y, 20.0 + drift[1] + s * x + c * y])


def _rings(drift: Float64Array) -> list[Float64Array]:
    angle = np.linspace(0.0, 2.0 * math.pi, 49)
    rings = []
    for x, y, a, b in AREAS:
        ring = _drifted(np.column_stack([x + a * np.cos(angle), y + b * np.sin(angle)]), drift)
        ring[-1] = ring[0]
        rings.append(ring)
    return rings


def _state(rng: np.random.Generator, how: Surveying, drift: Float64Array) -> npt.NDArray[np.uint8]:
    count = round(BOX.width / CELL)
    rows, cols = np.indices((count, count)) + 0.5
    c, s = math.cos(drift[2]), math.sin(drift[2])
    x, y = CELL * cols - 20.0 - drift[0], CELL * rows - 20.0 - drift[1]
    x, y = 20.0 + c * x + s * y, 20.0 - s * x + c * y
    wobble = ndimage.gaussian_filter(rng.normal(0.0, 1.0, (count, count)), 2.0)
    wobble *= how.edge / wobble.std()
    state = np.ones((count, count), np.uint8)
    for mid_x, mid_y, a, b in AREAS:
        r = np.sqrt(((x - mid_x) / a) ** 2 + ((y - mid_y) / b) ** 2)
        state[(r - 1.0) * min(a, b) + wobble < 0.0] = 2
    unseen = ndimage.gaussian_filter(rng.normal(0.0, 1.0, (count, count)), 12.0)
    state[unseen > np.quantile(unseen, 1.0 - how.unseen)] = 0
    return state
