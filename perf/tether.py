"""Is a mission's tether ever longer than it is, or wound too far, by what is really there?

    python perf/tether.py                                an hour or two on two cores; goes on where it was
    python perf/tether.py --spatial 3 --planar 1         some ten minutes

Worlds of `dev`, reefs and wrecks, are flown with a tether and without. The tether is then drawn taut along
the way that was swum by a slow twin that shares nothing with `dream.homeward.tether`: a chain of beads 0.2 m
apart, each pulled between its neighbours until none moves, kept out of a raster of the world's own triangles
and seabed. Its greatest length and winding are told beside those that the mission believed in, and what was
seen beside the mission without a tether. Nothing is tuned on `test`.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

import numpy as np
from numba import njit

from dream.evaluation.metrics import Scorer, sight_in
from dream.evaluation.runner import simulate
from dream.evaluation.suites import Case
from dream.geometry import FloatArray
from dream.homeward import Budget
from dream.planning import Belief
from dream.sim.ordered import protocol_in
from dream.sim.render import Renderer
from dream.sim.solids import corners
from dream.sim.world import World
from dream.types import Step, UInt8Array
from homeward import chosen, fly_and_keep, kept_in, options

SIDE = 0.1
"""Metres of a box of the raster."""
APART = 0.2
"""Metres between beads."""
CHORD = 1.0
"""Metres of string whose directions are compared for its bends."""
SWEEPS = 2000


@dataclass(frozen=True, slots=True)
class Flown:
    """One mission."""

    world: str
    seed: int
    protocol: str
    tether: float | None
    """Metres; None of the mission without."""
    ended: str
    why: str
    steps: int
    led: int
    """Steps on which it was led back along the tether and on, to where the planner asked to go."""
    seen: float
    """Share of the individuals."""
    contacts: int
    believed: float | None
    """Metres of tether that were out at most, by what the mission knew."""
    believed_turns: float | None
    longest: float
    """The same by what is really there."""
    turns: float
    left: float
    """Metres of tether that were out at its end, by what is really there."""


class TrueTether:
    """The tether by the beads."""

    def __init__(self, world: World, start: FloatArray) -> None:
        self.solid, self.low = _raster(world)
        self.beads = np.array([start, start])
        self.longest = self.turns = 0.0

    def go_to(self, place: FloatArray) -> None:
        """The vehicle went straight there."""
        way = place - self.beads[-1]
        count = max(math.ceil(float(np.linalg.norm(way)) / APART), 1)
        more = self.beads[-1] + way * (np.arange(1, count + 1)[:, None] / count)
        self.beads = _relaxed(self.solid, self.low, np.vstack([self.beads, more]))
        self.longest = max(self.longest, self.length)
        self.turns = max(self.turns, self._bends())

    @property
    def length(self) -> float:
        """Metres that are out."""
        return float(np.linalg.norm(np.diff(self.beads, axis=0), axis=1).sum())

    def _bends(self) -> float:
        """Turns of all its bends together."""
        along = np.concatenate([[0.0], np.linalg.norm(np.diff(self.beads, axis=0), axis=1).cumsum()])
        count = int(along[-1] / CHORD)
        if count < 2:
            return 0.0
        at = np.linspace(0.0, along[-1], count + 1)
        chords = np.diff(np.stack([np.interp(at, along, axis) for axis in self.beads.T], axis=1), axis=0)
        chords /= np.linalg.norm(chords, axis=1)[:, None]
        cosines = np.clip((chords[1:] * chords[:-1]).sum(axis=1), -1.0, 1.0)
        return float(np.arccos(cosines).sum() / (2.0 * math.pi))


def _raster(world: World) -> tuple[UInt8Array, FloatArray]:
    """(levels, rows, cols) 1 where a surface passes, or the seabed is; and the lower corner."""
    bounds, terrain = world.bounds.widened(5.0), world.terrain
    x, y = np.arange(bounds.x_min, bounds.x_max, SIDE), np.arange(bounds.y_min, bounds.y_max, SIDE)
    ground = np.array([[terrain.height(a, b) for a in x[::5]] for b in y[::5]])
    ground = ground.repeat(5, axis=0).repeat(5, axis=1)[: len(y), : len(x)]
    low = np.array([bounds.x_min, bounds.y_min, float(ground.min())])
    levels = np.arange(low[2], 0.0, SIDE) + 0.5 * SIDE
    solid = (levels[:, None, None] < ground[None]).astype(np.uint8)
    for instances in (world.obstacles, world.targets.chosen(world.hull)):
        for mesh in np.unique(instances.mesh):
            for which in np.flatnonzero(instances.mesh == mesh):
                faces = corners(world.meshes[mesh], instances, np.array([which])).reshape(-1, 3, 3)
                _mark(solid, low, faces)
    return solid, low


@njit(cache=True)
def _mark(solid: UInt8Array, low: FloatArray, faces: FloatArray) -> None:
    for face in faces:
        a, u, v = face[0], face[1] - face[0], face[2] - face[0]
        longest = max(math.sqrt((u * u).sum()), math.sqrt((v * v).sum()))
        count = int(longest / (0.6 * SIDE)) + 1
        for i in range(count + 1):
            for j in range(count + 1 - i):
                at = np.floor((a + u * (i / count) + v * (j / count) - low) / SIDE)
                col, row, level = int(at[0]), int(at[1]), int(at[2])
                inside = 0 <= level < solid.shape[0] and 0 <= row < solid.shape[1]
                if inside and 0 <= col < solid.shape[2]:
                    solid[level, row, col] = 1


@njit(cache=True)
def _clear(solid: UInt8Array, low: FloatArray, a: FloatArray, b: FloatArray) -> bool:
    """Is a short way free, by points every quarter of a box?"""
    way = b - a
    count = int(math.sqrt((way * way).sum()) / (0.25 * SIDE)) + 1
    for k in range(count + 1):
        at = np.floor((a + way * (k / count) - low) / SIDE)
        col, row, level = int(at[0]), int(at[1]), int(at[2])
        inside = 0 <= level < solid.shape[0] and 0 <= row < solid.shape[1] and 0 <= col < solid.shape[2]
        if inside and solid[level, row, col]:
            return False
    return True


@njit(cache=True)
def _relaxed(solid: UInt8Array, low: FloatArray, beads: FloatArray) -> FloatArray:
    for sweep in range(SWEEPS):
        moved = 0.0
        for i in range(1, len(beads) - 1):
            middle = 0.5 * (beads[i - 1] + beads[i + 1])
            pull = middle - beads[i]
            far = math.sqrt((pull * pull).sum())
            if far < 1e-4:
                continue
            pull *= min(1.9, 0.5 * SIDE / far)
            for axes in range(8):
                # All of the pull; else what of it leads along what it lies against.
                part = pull.copy()
                for k in range(3):
                    if axes >> k & 1:
                        part[k] = 0.0
                to = beads[i] + part
                if axes == 7 or math.sqrt((part * part).sum()) < 1e-4:
                    continue
                away, back = to - middle, beads[i] - middle
                if (away * away).sum() > (back * back).sum():
                    continue
                if _clear(solid, low, beads[i - 1], to) and _clear(solid, low, to, beads[i + 1]):
                    beads[i] = to
                    moved = max(moved, math.sqrt((part * part).sum()))
                    break
        if sweep % 20 == 19 or moved < 1e-3:
            kept = np.empty((3 * len(beads) + 2, 3))
            kept[0], count = beads[0], 1
            for i in range(1, len(beads)):
                gap = beads[i] - kept[count - 1]
                if i < len(beads) - 1:
                    over = beads[i + 1] - kept[count - 1]
                    near = math.sqrt((over * over).sum()) < 1.2 * APART
                    if near and _clear(solid, low, kept[count - 1], beads[i + 1]):
                        continue
                if math.sqrt((gap * gap).sum()) > 1.5 * APART:
                    kept[count] = kept[count - 1] + 0.5 * gap
                    count += 1
                kept[count] = beads[i]
                count += 1
            beads = kept[:count].copy()
        if moved < 1e-3:
            break
    return beads


def fly(task: tuple[Case, str, float | None]) -> list[Flown]:
    """A mission in a world, by a protocol, with a tether of so many metres or without; the only one."""
    case, name, metres = task
    world = case.open()
    protocol = protocol_in(world, name)
    sight, renderer = sight_in(world, protocol), Renderer(world)
    scorer = Scorer(world, protocol, visibility=sight, renderer=renderer)
    budget = None if metres is None else Budget(tether_m=metres)
    steps = simulate(
        world, Belief(), protocol, start=case.start, renderer=renderer, solids=sight.solids, budget=budget
    )
    true: TrueTether | None = None
    believed: list[tuple[float, float]] = []
    led = 0
    step: Step
    for step in steps:
        scorer.add(step)
        pose = step.observation.pose
        place = np.array([pose.x, pose.y, step.observation.z])
        if true is None:
            true = TrueTether(world, place)
        true.go_to(place)
        if step.home is not None:
            ways = {one.name: one.way for one in step.home.balances}
            if "tether" in ways:
                believed.append((ways["tether"], ways["winding"]))
            told = step.decision.reasoning.action
            led += not step.home.why and (
                "along the tether" in told or told.startswith("Going back as it came")
            )
    assert true is not None
    scores = scorer.summary()
    flown = Flown(
        world=case.world,
        seed=case.seed,
        protocol=name,
        tether=metres,
        ended=scores["ended"],
        why="" if step.home is None else step.home.why,
        steps=scores["steps"],
        led=led,
        seen=scores["coverage"]["instances"],
        contacts=scores["collisions"],
        believed=max((one[0] for one in believed), default=None),
        believed_turns=max((one[1] for one in believed), default=None),
        longest=true.longest,
        turns=true.turns,
        left=true.length,
    )
    return [flown]


def in_turn(reefs: int, wrecks: int) -> list[Case]:
    """Worlds of `chosen`, wrecks spread among the reefs, so that whatever was flown by a time is like all."""
    cases, shares = chosen(reefs, wrecks), [(k + 0.5) / n for n in (reefs, wrecks) for k in range(n)]
    return [cases[k] for k in sorted(range(len(cases)), key=shares.__getitem__)]


def told(flown: list[Flown]) -> str:
    """A table: the greatest length and winding, and what was seen of what is seen without a tether."""
    heads = ("protocol", "tether", "missions", "home", "longest", "turns", "believed", "led", "seen", "ratio")
    lines = ["{:>10} {:>7} {:>8} {:>5} {:>8} {:>6} {:>14} {:>5} {:>6} {:>6}".format(*heads)]
    free = {(one.world, one.seed, one.protocol): one.seen for one in flown if one.tether is None}
    for protocol, tether in dict.fromkeys((one.protocol, one.tether) for one in flown):
        some = [one for one in flown if (one.protocol, one.tether) == (protocol, tether)]
        pairs = [
            (one.seen, free[key]) for one in some if (key := (one.world, one.seed, one.protocol)) in free
        ]
        ratio = sum(a for a, _ in pairs) / max(sum(b for _, b in pairs), 1e-9)
        believed = max((one.believed or 0.0 for one in some), default=0.0)
        believed_turns = max((one.believed_turns or 0.0 for one in some), default=0.0)
        lines.append(
            f"{protocol:>10} {'none' if tether is None else f'{tether:g} m':>7} {len(some):8} "
            f"{sum(one.ended in ('done', 'returned') for one in some):5} "
            f"{max(one.longest for one in some):6.1f} m {max(one.turns for one in some):6.2f} "
            f"{believed:6.1f} m, {believed_turns:4.2f} {sum(one.led for one in some):5} "
            f"{np.mean([one.seen for one in some]):6.3f} {ratio:6.3f}"
        )
    return "\n".join(lines)


def main() -> int:
    """Fly what is missing, and print the table of all."""
    parser = options(__doc__, "tether.jsonl", 1)
    parser.add_argument(
        "--spatial", type=int, default=15, help="worlds under dream-v2, a third of them wrecks"
    )
    parser.add_argument("--planar", type=int, default=5, help="worlds under dream-v1, likewise")
    parser.add_argument("--metres", type=float, default=40.0)
    given = parser.parse_args()
    kept = kept_in(given.out, Flown)
    there = {(one.world, one.seed, one.protocol, one.tether) for one in kept}
    tasks = [
        (case, name, metres)
        for name, count in (("dream-v1", given.planar), ("dream-v2", given.spatial))
        for case in in_turn(count - count // 3, count // 3)
        for metres in (given.metres, None)
        if (case.world, case.seed, name, metres) not in there
    ]
    for _, flown in fly_and_keep(fly, tasks, given.jobs, given.out):
        kept += flown
        print(flown[0], flush=True)
    print(told(kept))
    return 0


if __name__ == "__main__":
    sys.exit(main())
