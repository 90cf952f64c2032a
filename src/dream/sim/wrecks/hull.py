"""The form of a ship: outlines lofted from keel to deck, decks that fit them, bulwarks above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dream.sim.sampling import cosine, length, power
from dream.sim.wrecks.paint import Paint
from dream.sim.wrecks.shapes import (
    PATCH,
    SUBDIVISION,
    FloatArray,
    Part,
    grid,
    lofted,
    patches_along,
    resample,
)


@dataclass(frozen=True, slots=True)
class HullForm:
    """A hull: stem towards +x, keel along z = 0, symmetric about y = 0. Metres.

    Heights up the side are shares h of the local depth: 0 the keel, 1 the deck edge, more the bulwark.
    """

    length: float
    beam: float
    depth: float
    """Keel to deck edge amidships."""
    sheer_fore: float
    """How much higher the deck edge is at the stem than amidships."""
    sheer_aft: float
    bulwark: float
    """Height above the deck edge."""
    entrance: float
    """Length over which the bow widens to the full beam."""
    run: float
    """Length over which the stern narrows from it."""
    rake: float
    """How far the stem leans forward."""
    overhang: float
    """How far the stern reaches aft of the keel's end."""
    bilge: float = 0.3
    """Share of the depth over which the bottom turns into the side."""

    def deck_edge(self, x: FloatArray) -> FloatArray:
        """Height of the deck edge along the length."""
        fore, aft = np.clip(2 * x / self.length, 0, None), np.clip(-2 * x / self.length, 0, None)
        return np.asarray(self.depth + self.sheer_fore * fore * fore + self.sheer_aft * aft * aft)

    def ends(self, h: float) -> tuple[float, float]:
        """x of the stem and of the stern at a height."""
        below = max(0.0, 1 - h)
        return (
            self.length / 2 - self.rake * below + 0.25 * self.rake * max(0.0, h - 1),
            -self.length / 2 + self.overhang * float(power(below, 0.7)),
        )

    def half_breadth(self, x: FloatArray, h: float) -> FloatArray:
        """Distance from the middle plane to the side; 0 beyond the ends."""
        stem, stern = self.ends(h)
        fore = np.clip((stem - x) / self.entrance, 0, 1)
        aft = np.clip((x - stern) / self.run, 0, 1)
        # A little finer below than above. More flare would hide the ground that it hangs over.
        bow = 1 - power(1 - fore, 1.9 + 0.3 * min(h, 1.3))
        quarter = power(np.sqrt(1 - np.square(1 - aft)), 0.7 + 0.25 * max(0.0, 1 - h))
        turn = np.sqrt(1 - np.square(max(0.0, 1 - h / self.bilge)))
        return np.asarray(self.beam / 2 * bow * quarter * turn)

    def side(self, h: float) -> FloatArray:
        """(N, 3) the port side from stem to stern at a height, dense."""
        stem, stern = self.ends(h)
        # Cosine spacing: the ends curve most.
        x = stern + (stem - stern) * (0.5 + 0.5 * cosine(np.linspace(0, np.pi, 241)))
        y = self.half_breadth(x, h)
        y[[0, -1]] = 0.0
        return np.stack([x, y, h * self.deck_edge(x)], axis=1)

    def columns(self) -> int:
        """Quads along one side: as many as the deck edge asks for."""
        side = self.side(1.0)
        return SUBDIVISION * patches_along(float(length(np.diff(side, axis=0)).sum()))

    def shell(self, low: float, high: float, region: str, paint: Paint, *, two_sided: bool = False) -> Part:
        """Both sides between two heights, one sheet from the stem about the stern and back to the stem.

        Shells that share a height share its nodes.
        """
        columns = self.columns()
        lines = []
        for h in np.linspace(low, high, 33):
            port = resample(self.side(float(h)), columns)
            starboard = port[::-1] * (1, -1, 1)
            lines.append(np.concatenate([port, starboard[1:]]))
        points = np.stack(lines, axis=1)
        midship = points[columns // 2]
        rows = SUBDIVISION * patches_along(float(length(np.diff(midship, axis=0)).sum()))
        return lofted(points, 2 * columns, rows, region, paint, two_sided=two_sided)

    def hull(self, region: str, paint: Paint, *, two_sided: bool = False) -> Part:
        """Both sides from the keel to the deck edge."""
        return self.shell(0.0, 1.0, region, paint, two_sided=two_sided)

    def bulwarks(self, region: str, paint: Paint) -> Part:
        """The sides from the deck edge up."""
        return self.shell(1.0, 1.0 + self.bulwark / self.depth, region, paint, two_sided=True)

    def deck(
        self,
        region: str,
        paint: Paint,
        *,
        h: float = 1.0,
        camber: float = 0.08,
        between: tuple[float, float] | None = None,
        two_sided: bool = False,
    ) -> Part:
        """A deck at a height, over the whole length or between two x, in a square grid cut by the outline."""
        stem, stern = self.ends(h)
        first, last = between if between is not None else (stern, stem)
        step = PATCH / SUBDIVISION
        x = np.linspace(first, last, SUBDIVISION * patches_along(last - first) + 1)
        half = SUBDIVISION * int(np.ceil(self.beam / 2 / PATCH))
        y = step * np.arange(-half, half + 1)
        breadth = self.half_breadth(x, h)
        nodes = np.empty((len(x), len(y), 3))
        nodes[..., 0] = x[:, None]
        nodes[..., 1] = np.clip(y[None, :], -breadth[:, None], breadth[:, None])
        for end, inner in ((0, 1), (-1, -2)):
            if breadth[end] > 0.05:
                continue
            # Where the outline closes, the last row of nodes lies on it instead of in one point.
            nodes[end, :, 1] = nodes[inner, :, 1]
            outline = np.linspace(x[end], x[inner], 65)
            nodes[end, :, 0] = np.interp(np.abs(nodes[end, :, 1]), self.half_breadth(outline, h), outline)
        crown = np.square(self.half_breadth(nodes[..., 0], h)) - np.square(nodes[..., 1])
        nodes[..., 2] = h * self.deck_edge(nodes[..., 0]) + camber * crown / np.square(self.beam / 2)
        return grid(nodes, region, paint, two_sided=two_sided)

    def bulkhead(self, x: float, region: str, paint: Paint, *, low: float = 0.0, high: float = 1.0) -> Part:
        """A wall across the hull between two heights, seen from both sides."""
        heights = np.linspace(low, high, 65)
        edge = float(self.deck_edge(np.array([x]))[0])
        outline = np.array(
            [[float(self.half_breadth(np.array([x]), float(h))[0]), h * edge] for h in heights]
        )
        rows = SUBDIVISION * patches_along(float(outline[-1, 1] - outline[0, 1]))
        z = np.linspace(outline[0, 1], outline[-1, 1], rows + 1)
        breadth = np.interp(z, outline[:, 1], outline[:, 0])
        half = SUBDIVISION * int(np.ceil(self.beam / 2 / PATCH))
        y = PATCH / SUBDIVISION * np.arange(-half, half + 1)
        nodes = np.empty((len(y), len(z), 3))
        nodes[..., 0] = x
        nodes[..., 1] = np.clip(y[:, None], -breadth[None, :], breadth[None, :])
        nodes[..., 2] = z[None, :]
        return grid(nodes, region, paint, two_sided=True)


@dataclass(frozen=True, slots=True)
class Bays:
    """Names for the lengths of a ship: `bow port`, `midship 1 starboard` and so on, for `Part.divided`."""

    edges: tuple[float, ...]
    """x between neighbouring bays, ascending."""
    prefix: str = ""
    sides: bool = True
    """Port and starboard are apart."""

    def __call__(self, points: FloatArray) -> npt.NDArray[np.str_]:
        """The names (N,) of points (N, 3)."""
        bay = np.searchsorted(np.asarray(self.edges), points[:, 0])
        side = np.where(points[:, 1] >= 0, "port", "starboard") if self.sides else np.full(len(points), "")
        return np.array([f"{self.prefix} {i} {name}".rstrip() for i, name in zip(bay, side, strict=True)])
