"""`dream oracle`: what a mission could have achieved by one who knows the world."""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import tyro

from dream.commands.console import (
    check_no_world,
    check_picture,
    open_world,
    print_json,
    save_picture,
)
from dream.commands.progress import stage, with_progress
from dream.errors import MissionAborted
from dream.options import First
from dream.protocol import SurveyProtocol, protocol_named
from dream.telling import rich_console

if TYPE_CHECKING:
    from dream.evaluation.oracle.bounds import OracleBounds
    from dream.evaluation.oracle.space_bounds import SpaceBounds
    from dream.evaluation.results import Results
    from dream.evaluation.suites import Case
    from dream.sim.world import World

    Bounds = OracleBounds | SpaceBounds

Key = tuple[str, str, int, int]
"""What `OracleBounds.key` gives."""
DEFAULT_WORLD = "reef/string"


@dataclass(frozen=True, slots=True)
class Oracle:
    """Find the fewest steps in which a world can be seen, by one who knows it: a lower bound and a tour.

    No mission without contact sees 100 % (or 98.26 %) of the individuals in fewer steps than the lower
    bound. An exact search proves it: no shorter walk sees even a few chosen individuals. The best tour is a
    walk that does see them, flown in the simulator. Where both numbers are equal, the tour is optimal. All
    numbers of steps include the look-around. The search begins at bounds that come with the package.

    Under a protocol that moves in space, such as dream-v2, it is the steps to 98.26 % of what counts
    as inspected, the lower bound is a coarse one, and finding what each pose shows takes a minute or two at
    first.

    With a suite, the bounds of all its worlds are kept in a file (`--out`). After an interruption the same
    command goes on with the other worlds.

    Examples:
        dream oracle --world reef/string --budget 20 --picture tour.png
        dream oracle paper --check
    """

    suite: tyro.conf.Positional[str | None] = None
    """All worlds of a suite instead of one: `paper`, `dev` or `test`, or a file .txt with worlds of your own,
    one a line."""
    world: First[Annotated[str | None, tyro.conf.arg(metavar="WORLD")]] = None
    """A name from `dream worlds`, or the folder of a saved world. Unless given, reef/string."""
    seed: First[int] = 1
    """Which world of that name."""
    start: int = 0
    """Which of the world's start poses, counted from 0."""
    protocol: str | None = None
    """Rules of the survey: sensors, reach and cap. Unless given, those that the world is made
    for, which of most worlds is dream-v1, the plane."""
    budget: First[float] = 60.0
    """Seconds of processor time for a world, without compiling. 0 only tells what is known."""
    picture: First[Path | None] = None
    """Picture to draw: the best tour on the world's chart. Its name ends in .png, .jpg or .webp."""
    out: First[Path | None] = None
    """File in which the bounds of a suite are kept, one world a line. Unless given, `SUITE.jsonl`."""
    jobs: First[int] = 1
    """Worlds of a suite at a time."""
    traces: Path | None = None
    """A folder of `dream bench`, finished or not. The search for tours begins at its missions."""
    again: bool = False
    """Search again where a world of the suite has bounds already that are not equal."""
    check: First[bool] = False
    """Search nothing: fly the kept tours of the suite again, and prove the kept bounds again."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0; 1 where a search or a check failed."""
        if not 0.0 <= self.budget <= 1e6:
            raise ValueError(f"--budget: expected 0 to 1000000 seconds, got {self.budget:g}")
        if self.jobs < 1:
            raise ValueError(f"--jobs: expected at least 1, got {self.jobs}")
        if self.suite is None:
            return self._one()
        check_no_world("oracle", self.suite)
        if self.world is not None:
            raise ValueError(f"--world: expected a world or a suite, got {self.world} and {self.suite}")
        if self.picture is not None:
            raise ValueError("--picture: expected one world; a suite has many. Say --world instead")
        return self._check_all() if self.check else self._all()

    def _one(self) -> int:
        from dream.evaluation.oracle.bounds import drive, known_bounds, tighten, walks_of
        from dream.sim.files import world_hash
        from dream.sim.ordered import protocol_in
        from dream.sim.visibility import Visibility

        for name in ("out", "check", "again"):
            if getattr(self, name):
                raise ValueError(f"--{name}: expected a suite, got none. Say: dream oracle paper --{name}")
        if self.picture is not None:
            check_picture(self.picture, "--picture")
        name = self.world or DEFAULT_WORLD
        with stage(f"opening {name} {self.seed}"):
            world = open_world(name, self.seed)
        protocol = protocol_in(world, self.protocol or world.protocol)
        if protocol.space is not None:
            return self._one_in_space(world, protocol)
        known = known_bounds(protocol.name, world.name, world.seed, self.start, world_hash(world))
        results = _results(self.traces)
        key = (protocol.name, world.name, world.seed, self.start)
        visibility = Visibility(world, protocol)
        found, interrupted = _last(
            tighten(
                world,
                protocol,
                start=self.start,
                budget_s=self.budget,
                known=known,
                hints=None if results is None else walks_of(results, key),
                visibility=visibility,
            ),
            self.budget,
            _ends,
        )
        try:
            drive(found, world, visibility=visibility)
        except ValueError as error:
            raise MissionAborted(f"{world.name} {world.seed}: {error}") from error
        if self.picture is not None:
            _draw(found, world, protocol, self.picture)
        if self.json:
            print_json(found.summary())
        else:
            _print_one(found, self.picture)
        if interrupted:
            raise KeyboardInterrupt
        return 0

    def _one_in_space(self, world: World, protocol: SurveyProtocol) -> int:
        from dream.commands.space_oracle import draw, ends, print_one
        from dream.evaluation.oracle.space_bounds import drive, tighten
        from dream.sim.inspection import Inspection

        self._check_no_traces(protocol)
        inspection = Inspection(world, protocol)
        states = tighten(world, protocol, start=self.start, budget_s=self.budget, inspection=inspection)
        found, interrupted = _last(states, self.budget, ends)
        try:
            drive(found, world, inspection=inspection)
        except ValueError as error:
            raise MissionAborted(f"{world.name} {world.seed}: {error}") from error
        if self.picture is not None:
            draw(found, world, protocol, self.picture)
        if self.json:
            print_json(found.summary())
        else:
            print_one(found, self.picture)
        if interrupted:
            raise KeyboardInterrupt
        return 0

    def _check_no_traces(self, protocol: SurveyProtocol) -> None:
        if self.traces is not None and protocol.space is not None:
            raise ValueError(f"--traces: expected a planar protocol, got {protocol.name}")

    def _all(self) -> int:
        from dream.evaluation.locks import alone_at
        from dream.evaluation.oracle.bounds import write_bounds
        from dream.evaluation.suites import suite_named

        cases = suite_named(self.suite or "")
        out = self.out or Path(f"{Path(self.suite or '').stem}.jsonl")
        if out.is_dir():
            raise ValueError(f"--out: expected a file, got the folder {out}")
        protocol = protocol_named(self.protocol or "dream-v1")
        self._check_no_traces(protocol)
        failed: dict[Key, str] = {}
        with alone_at(out, out.with_name(f".{out.name}.lock")):
            kept = _kept_in(out, protocol) if out.is_file() else {}
            keys = {self._key(case): case for case in cases}
            for case, bounds in with_progress(
                self._search(cases, kept), f"searching {self.suite}", len(cases), "worlds"
            ):
                key = self._key(case)
                if isinstance(bounds, str):
                    failed[key] = bounds
                elif bounds != kept.get(key):
                    kept[key] = bounds
                    ordered = [kept[key] for key in keys if key in kept]
                    write_bounds(out, ordered + [kept[key] for key in kept if key not in keys])
        found = [kept[key] for key in keys if key not in failed]
        if self.json:
            print_json(
                {"suite": self.suite, "out": str(out), "worlds": [bounds.summary() for bounds in found]}
            )
        else:
            _print_table(found)
            print(out)
        if failed:
            each = "; ".join(
                f"{keys[key].world} {keys[key].seed}: {failed[key]}" for key in keys if key in failed
            )
            raise MissionAborted(f"{len(failed)} of {len(keys)} worlds failed: {each}")
        return 0

    def _key(self, case: Case) -> Key:
        return self.protocol or "dream-v1", case.world, case.seed, case.start

    def _search(
        self, cases: Sequence[Case], kept: Mapping[Key, Bounds]
    ) -> Iterator[tuple[Case, Bounds | str]]:
        """Each case with its bounds, or with what was wrong, in the order in which they end."""
        if not cases:
            return
        protocol = protocol_named(self.protocol or "dream-v1")
        results = _results(self.traces)
        # Spawned, not forked: forking a process that holds numba's threads is not safe.
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(min(self.jobs, len(cases)), mp_context=context) as pool:
            running = {
                pool.submit(
                    _search_case,
                    case,
                    protocol.name,
                    self.budget,
                    kept.get(self._key(case)),
                    results,
                    again=self.again,
                ): case
                for case in cases
            }
            try:
                for future in as_completed(running):
                    found: Bounds | str
                    try:
                        found = future.result()
                    except ValueError as error:
                        found = str(error)
                    yield running[future], found
            except BrokenProcessPool as error:
                raise MissionAborted(
                    "a search was killed, perhaps for want of memory; what others found is kept. "
                    "Try fewer --jobs"
                ) from error
            finally:
                pool.shutdown(wait=True, cancel_futures=True)

    def _check_all(self) -> int:
        from dream.evaluation.oracle.bounds import every_known
        from dream.evaluation.suites import suite_named

        cases = suite_named(self.suite or "")
        protocol = protocol_named(self.protocol or "dream-v1")
        # Whether the world is today's is for the check to say, so the hash does not choose here.
        kept: Mapping[Key, Bounds] = every_known() if self.out is None else _kept_in(self.out, protocol)
        known = [case for case in cases if self._key(case) in kept]
        unknown = len(cases) - len(known)
        if not known:
            raise ValueError(
                f"--check: expected bounds of a world of {self.suite}, got none "
                f"{'with the package' if self.out is None else f'in {self.out}'}. "
                "The same command without --check, and with --out FILE, searches for them"
            )
        outcomes: list[dict[str, Any]] = []
        for case in with_progress(known, f"checking {self.suite}", len(known), "worlds"):
            wrong = ""
            try:
                _check(kept[self._key(case)], case.open())
            except ValueError as error:
                wrong = str(error)
            outcomes.append({"world": case.world, "seed": case.seed, "start": case.start, "wrong": wrong})
        failed = sum(bool(outcome["wrong"]) for outcome in outcomes)
        if self.json:
            print_json({"suite": self.suite, "failed": failed, "unknown": unknown, "worlds": outcomes})
        else:
            for outcome in outcomes:
                print(f"{outcome['world']} {outcome['seed']}: {outcome['wrong'] or 'holds'}")
            if unknown:
                print(f"not checked: {unknown} of {len(cases)} worlds, of which no bounds are known")
        return 1 if failed else 0


def _kept_in(path: Path, protocol: SurveyProtocol) -> dict[Key, Bounds]:
    """The bounds in a file, by their missions."""
    from dream.evaluation.oracle.bounds import read_bounds, read_lines
    from dream.evaluation.oracle.space_bounds import SpaceBounds

    planar = protocol.space is None
    return {bounds.key: bounds for bounds in (read_bounds(path) if planar else read_lines(path, SpaceBounds))}


def _check(bounds: Bounds, world: World) -> None:
    """Raise a ValueError unless the bounds hold."""
    from dream.evaluation.oracle import space_bounds
    from dream.evaluation.oracle.bounds import OracleBounds, check

    if isinstance(bounds, OracleBounds):
        check(bounds, world)
    else:
        space_bounds.check(bounds, world)


def _search_case(
    case: Case,
    protocol: str,
    budget_s: float,
    kept: Bounds | None,
    results: Results | None,
    *,
    again: bool,
) -> Bounds:
    """The bounds of a case, its tours flown: those kept, where they are of this very world and will do."""
    from dream.evaluation.oracle.bounds import OracleBounds
    from dream.sim.files import world_hash
    from dream.sim.ordered import protocol_in

    world = case.open()
    rules = protocol_in(world, protocol)
    if kept is not None and kept.world_hash != world_hash(world):
        kept = None
    if rules.space is None:
        planar = kept if isinstance(kept, OracleBounds) else None
        return _search_planar(case, world, rules, budget_s, planar, results, again=again)
    return _search_space(
        case, world, rules, budget_s, None if isinstance(kept, OracleBounds) else kept, again=again
    )


def _search_space(
    case: Case, world: World, rules: SurveyProtocol, budget_s: float, kept: SpaceBounds | None, *, again: bool
) -> SpaceBounds:
    from dream.evaluation.oracle.space_bounds import drive, tighten
    from dream.sim.inspection import Inspection

    inspection = Inspection(world, rules)
    found = kept
    if kept is None or (again and kept.status == "gap"):
        *_, found = tighten(
            world,
            rules,
            start=case.start,
            budget_s=budget_s,
            known=kept,
            # A search that goes on must not try the same again.
            seed=0 if kept is None else round(10.0 * kept.cpu_s),
            inspection=inspection,
        )
    assert found is not None
    drive(found, world, inspection=inspection)
    return found


def _search_planar(
    case: Case,
    world: World,
    rules: SurveyProtocol,
    budget_s: float,
    kept: OracleBounds | None,
    results: Results | None,
    *,
    again: bool,
) -> OracleBounds:
    from dream.evaluation.oracle.bounds import bound, drive, known_bounds, walks_of
    from dream.sim.files import world_hash
    from dream.sim.visibility import Visibility

    visibility = Visibility(world, rules)
    key = (rules.name, case.world, case.seed, case.start)
    gap = kept is None or "gap" in (kept.full.status, kept.t98.status)
    if kept is None or (again and gap):
        kept = kept or known_bounds(*key, world_hash(world))
        found = bound(
            world,
            rules,
            start=case.start,
            budget_s=budget_s,
            known=kept,
            hints=None if results is None else walks_of(results, key),
            # A search that goes on must not try the same again.
            seed=0 if kept is None else round(10.0 * kept.cpu_s),
            visibility=visibility,
        )
    else:
        found = kept
    drive(found, world, visibility=visibility)
    return found


def _results(folder: Path | None) -> Results | None:
    from dream.evaluation.results import read_kept

    return None if folder is None else read_kept(folder)


B = TypeVar("B", bound="Bounds")


def _last(states: Iterator[B], budget_s: float, ends: Callable[[B], str]) -> tuple[B, bool]:
    """The last of some bounds, and whether the user ended them; they are told of meanwhile."""
    with stage("finding what each pose shows"):
        found = next(states)
    title = f"searching {found.world} {found.seed}"
    with stage(title, math.ceil(budget_s), "s of processor time", at_most=True) as work:
        spent = found.cpu_s
        try:
            for found in states:
                work.done, work.said = round(found.cpu_s - spent), ends(found)
        except KeyboardInterrupt:
            return found, True
    return found, False


def _ends(bounds: OracleBounds) -> str:
    return (
        f"100 % in {bounds.full.lower_bound} to {bounds.full.best_tour or '?'} steps, "
        f"98.26 % in {bounds.t98.lower_bound} to {bounds.t98.best_tour or '?'}"
    )


def _print_one(bounds: OracleBounds, picture: Path | None) -> None:
    print(f"{bounds.world} {bounds.seed} · start {bounds.start} · {bounds.protocol}")
    for name, limit in (("100 %   ", bounds.full), ("98.26 % ", bounds.t98)):
        if limit.status == "optimal":
            print(f"  {name} {limit.best_tour} steps, and no fewer: optimal")
        else:
            best = "no tour known" if limit.best_tour is None else f"best tour {limit.best_tour} steps"
            print(f"  {name} {best}, no fewer than {limit.lower_bound}")
    print(
        f"  {bounds.countable} individuals count; {bounds.cpu_s:.1f} s of processor time, those of earlier "
        "searches among them"
    )
    if picture is not None:
        print(f"  picture: {picture}")


def _print_table(found: Sequence[Bounds]) -> None:
    import sys

    from rich.table import Table

    from dream.evaluation.oracle.bounds import OracleBounds

    planar = all(isinstance(bounds, OracleBounds) for bounds in found)
    shares = ("100 %", "98.26 %") if planar else ("98.26 %",)
    table = Table(title="steps, the look-around counted")
    headings = [heading for share in shares for heading in (f"{share}: at least", "best tour")]
    for heading in ("world", "seed", *headings, "s"):
        table.add_column(heading, justify="left" if heading == "world" else "right")
    for bounds in found:
        limits = (bounds.full, bounds.t98) if isinstance(bounds, OracleBounds) else (bounds,)
        ends = [
            str(number) if number is not None else "–"
            for limit in limits
            for number in (limit.lower_bound, limit.best_tour)
        ]
        table.add_row(bounds.world, str(bounds.seed), *ends, f"{bounds.cpu_s:.0f}")
    rich_console(width=None if sys.stdout.isatty() else 120).print(table)


def _draw(bounds: OracleBounds, world: World, protocol: SurveyProtocol, path: Path) -> None:
    """Save the chart with the best tour over it: a line, and at every step where it looks."""
    import numpy as np
    from PIL import ImageDraw

    from dream.evaluation.oracle.bounds import tour_poses
    from dream.sim.chart import START, chart, chart_sheet

    page = chart(world)
    draw = ImageDraw.Draw(page)
    x, y, yaw = tour_poses(bounds, world, protocol).T
    across, down = chart_sheet(world).at(x, y)
    track = list(zip(across.tolist(), down.tolist(), strict=True))
    draw.line(track, fill=(255, 255, 255), width=6, joint="curve")
    draw.line(track, fill=START, width=3, joint="curve")
    looks = zip(track, (across + 14 * np.cos(yaw)).tolist(), (down - 14 * np.sin(yaw)).tolist(), strict=True)
    for (u, v), to_u, to_v in looks:
        draw.line([(u, v), (to_u, to_v)], fill=START, width=2)
        draw.ellipse([u - 4, v - 4, u + 4, v + 4], fill=(255, 255, 255), outline=START, width=2)
    save_picture(page, path, "--picture")
