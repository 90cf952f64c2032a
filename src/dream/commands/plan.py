"""`dream plan`: what an area will take, before a mission."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from dream.commands.bench import fly_missions
from dream.commands.console import check_writable, print_json
from dream.commands.homing import Homing
from dream.commands.progress import stage
from dream.commands.run import ChosenPlanner
from dream.commands.swim import Swim
from dream.errors import MissionAborted
from dream.flies import check_flies
from dream.names import look_up
from dream.options import First
from dream.planning import PLANNERS, check_installed, planner_name
from dream.planning.vlm import Asking
from dream.protocol import protocol_for

if TYPE_CHECKING:
    from dream.evaluation.engines import Engine
    from dream.evaluation.results import Flown
    from dream.evaluation.runner import Plan as Missions
    from dream.homeward import Budget
    from dream.sim.sizes import Size

MOST = 1000
"""Missions that one command flies."""


@dataclass(frozen=True, slots=True)
class MissionPlan:
    """Tell what an area will take, from simulated missions in worlds of that size: time, way, battery and
    coverage, each with its spread. Leaves a page with pictures, and plan.json.

    Every mission goes home in the end. With --budget-s, --battery-wh or --tether-m the same worlds are flown
    once more by vehicles that have no more, and what they saw by then is told. After an interruption the
    same command goes on; with more --missions it keeps those that are flown.

    Examples:
        dream plan --area 40x30
        dream plan --area 60x40 --visibility 5 --missions 20 --budget-s 1800
        dream plan sixsteps --area 40x40 --worlds wreck/2 wreck/4
    """

    area: First[Annotated[str, tyro.conf.arg(metavar="EASTxNORTH")]]
    """Metres from west to east and from south to north, even numbers from 26 to 100."""
    planner: ChosenPlanner = PLANNERS["belief"]
    """Who decides."""
    visibility: First[float | None] = None
    """Metres at which a Secchi disc vanishes in the water, 1 to 30. Unless given, each world has its own."""
    worlds: First[Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORLD ...")]] = ()
    """What may lie there, all alike likely: wide worlds such as reef/mound, or wreck/1 to wreck/5. Unless
    given, any of the wide worlds."""
    missions: First[int] = 8
    """How many are flown; 9 tell 10 % and 90 % of missions, fewer less."""
    seed: int = 1
    """Seed of the first world; the others follow it."""
    protocol: First[str | None] = None
    """Rules of the survey. Unless given, dream-v2; dream-v2-nav swims, and tells truer times."""
    max_steps: int | None = None
    """Steps at most in a mission. Unless given, the cap of the protocol: 300 or more, by the area."""
    jobs: First[int | None] = None
    """Missions at a time. Unless given, one for each processor."""
    out: First[Path | None] = None
    """Folder of the plan. Unless given, one in `plan`, called by area, planner and protocol."""
    json: bool = False
    """Print plan.json and nothing else."""
    swim: Swim = field(default_factory=Swim)
    homing: Homing = field(default_factory=Homing)

    def __call__(self) -> int:
        """Exit status 0; a MissionAborted where a mission failed."""
        from dream.evaluation.foresight import Foreseen, Foresight
        from dream.evaluation.plan_report import told, write_plan

        size, kinds, engine = self._size(), self._kinds(), self._engine()
        missions = self._plan(size, kinds)
        budget = self.homing.budget()
        if budget is not None:
            # Before the missions without limits, which take long.
            budget.check(size.bounds, missions.protocol)
        folder = self.out or Path("plan") / self._folder(size, missions)
        check_writable(folder)
        ends = replace(missions, budget=_without_limits(budget))
        free = Foresight(_flown(ends, folder / "free", engine))
        limited = None
        if budget is not None and budget != ends.budget:
            within = replace(missions, budget=budget)
            limited = Foresight(_flown(within, folder / _named(budget), engine), budget)
        foreseen = Foreseen(size, kinds, planner_name(self.planner), missions.protocol, free, limited)
        with stage("writing the plan"):
            page = write_plan(folder, foreseen)
        if self.json:
            print_json(foreseen.as_dict())
        else:
            print("\n".join([*told(foreseen), f"  plan: {page}"]))
        return 0

    def _size(self) -> Size:
        from dream.sim.sizes import Size

        found = re.fullmatch(r"(\d{1,3})x(\d{1,3})", self.area)
        if found is None:
            raise ValueError(
                f"--area: expected metres from west to east and from south to north as 40x30, got {self.area}"
            )
        try:
            return Size(int(found[1]), int(found[2]), self.visibility)
        except ValueError as error:
            raise ValueError(f"--{error}") from None

    def _kinds(self) -> tuple[str, ...]:
        from dream.sim.habitats import HABITATS
        from dream.sim.worlds import SIZABLE

        for name in self.worlds:
            look_up(SIZABLE, name, "world that can be made in any size")
        return self.worlds or tuple(HABITATS)

    def _engine(self) -> Engine:
        from dream.evaluation.engines import Processes, processors

        return Processes(processors() if self.jobs is None else self.jobs)

    def _plan(self, size: Size, kinds: tuple[str, ...]) -> Missions:
        """The missions, with no budget yet; a ValueError where they cannot be flown."""
        from dream.evaluation.foresight import cases_in
        from dream.evaluation.runner import Plan

        if not 2 <= self.missions <= MOST:
            raise ValueError(f"--missions: expected 2 to {MOST}, which have a spread, got {self.missions}")
        if self.seed < 0:
            raise ValueError(f"--seed: expected 0 or more, got {self.seed}")
        check_installed(self.planner)
        if isinstance(self.planner, Asking):
            self.planner.line()
        cases = cases_in(size, kinds, self.missions, self.seed)
        protocol = protocol_for(cases[0].open().protocol, self.protocol)
        check_flies(self.planner, protocol)
        planners = {planner_name(self.planner): self.planner}
        swimming = self.swim.chosen(protocol)
        return Plan(str(size), cases, planners, protocol, max_steps=self.max_steps, swimming=swimming)

    def _folder(self, size: Size, missions: Missions) -> str:
        return f"{size}-{planner_name(self.planner)}-{missions.protocol.name}"


def _flown(missions: Missions, folder: Path, engine: Engine) -> tuple[Flown, ...]:
    """All of them, in their order; a MissionAborted where one failed."""
    flown, failures = fly_missions(missions, folder, engine)
    if failures:
        case, _, reason = failures[0]
        raise MissionAborted(
            f"{len(failures)} of {len(missions)} missions failed, first in {case.world} {case.seed}: "
            f"{reason}. The others are kept in {folder}; the same command flies the rest"
        )
    (planner,) = missions.planners
    return tuple(flown[case, planner] for case in missions.cases)


def _without_limits(budget: Budget | None) -> Budget:
    """The same home, and as much of everything as it takes."""
    from dream.homeward import Budget

    return Budget(home=None if budget is None else budget.home)


def _named(budget: Budget) -> str:
    """A folder for what is flown with a budget."""
    from dream.homeward.budget import LIMITS

    limits = {unit: getattr(budget, name) for name, (_, unit) in LIMITS.items()}
    return "-".join(["within", *(f"{most:g}{unit}" for unit, most in limits.items() if math.isfinite(most))])
