"""`dream run`: one mission in a simulated world."""

from __future__ import annotations

import contextlib
import datetime
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from dream.commands.console import (
    check_max_steps,
    check_writable,
    compiling_told,
    kept_interrupts,
    open_world,
)
from dream.commands.ground import Ground
from dream.commands.homing import Homing
from dream.commands.mission import check_terminal, confirmed, draw_orders, given
from dream.commands.outcome import fly_to_end, tell_outcome, write_scene_of
from dream.commands.progress import stage
from dream.commands.see import See, protocol_seen
from dream.commands.swim import Swim
from dream.flies import check_flies
from dream.options import First
from dream.own_code import own_planner
from dream.planning import PLANNERS, AnyPlanner, check_installed, planner_name
from dream.planning.vlm import Asking

if TYPE_CHECKING:
    from dream.orders import Orders
    from dream.protocol import SurveyProtocol
    from dream.sim.world import World
    from dream.types import Step

    ChosenPlanner = AnyPlanner
else:
    ChosenPlanner = tyro.extras.subcommand_type_from_defaults(PLANNERS, sort_subcommands=False)

SCENE_EVERY = 10
"""Steps after which the live page gets a new view in three dimensions."""


@dataclass(frozen=True, slots=True)
class Run:
    """Fly one mission in a simulated world. Its folder keeps the recording, the report and the summary.

    A planner of your own is named by its file: dream run ./mine.py.

    Examples:
        dream run --world reef/string
        dream run sixsteps --world reef/mixed --seed 3
    """

    planner: ChosenPlanner = PLANNERS["belief"]
    """Who decides."""
    world: First[Annotated[str, tyro.conf.arg(metavar="WORLD")]] = "reef/string"
    """A name from `dream worlds`, or the folder of a saved world."""
    seed: First[int] = 1
    """Which world of that name: any number makes another."""
    start: int = 0
    """Which of the world's start poses, counted from 0."""
    out: First[Path] = Path("runs")
    """Folder in which the run's own folder is made."""
    max_steps: First[int | None] = None
    """Steps at most, that is decisions carried out. Unless given, the cap of the protocol: 300 or
    more, by the area; 200 in the plane."""
    protocol: First[str | None] = None
    """Rules of the survey: sensors, reach and cap. Unless given, dream-v2; those of the pool for a tank."""
    see: First[See] = "told"
    """Labels and depth as the simulator tells them, or as a network learned to see them in colours."""
    mission: First[str | None] = None
    """Orders: a file that `dream mission` wrote. A planner that asks a model also takes plain words."""
    yes: bool = False
    """Take the orders as the model understood them, and ask nobody to confirm them."""
    keep_observations: bool = False
    """Keep all that is seen, to the last bit, as a dive does: about 0.2 MB a step. `dream replay` then plays
    it back, and `dream export` makes a data set of it."""
    live: First[bool] = False
    """Show the run in a browser, at an address that is printed."""
    json: bool = False
    """Print the summary as one JSON object and nothing else."""
    ground: Ground = field(default_factory=Ground)
    swim: Swim = field(default_factory=Swim)
    homing: Homing = field(default_factory=Homing)

    def __call__(self) -> int:
        """Exit status 0, or 1 where no answer of its model counted.

        A MissionAborted where the mission did not end by itself.
        """
        if self.live:
            from dream.live import beside

            beside.check_installed()
        check_installed(self.planner)
        words = self.mission is not None and given(self.mission) is None
        if words and not self.yes and isinstance(self.planner, Asking):
            check_terminal(self.planner)
        with contextlib.ExitStack() as shown:
            return self._fly_and_tell(shown)

    def _fly_and_tell(self, shown: contextlib.ExitStack) -> int:
        """The same; what has to stay until the outcome is told is left to `shown`."""
        from dream import recording
        from dream.compiling import working_time
        from dream.evaluation.metrics import Scorer, sight_in
        from dream.evaluation.runner import run_config, simulate, summarize
        from dream.planning.vlm.orders import write_mission
        from dream.robots.replay import keep
        from dream.sim.ordered import protocol_in
        from dream.sim.render import Renderer

        site, budget = self.ground.where(), self.homing.budget()
        if isinstance(self.planner, Asking):
            self.planner.line()  # What is missing to ask a model is told before anything compiles.
        began = working_time()
        with compiling_told():
            with kept_interrupts() as check:
                with stage(f"opening {self.world} {self.seed}"):
                    world = open_world(self.world, self.seed)
                protocol = protocol_in(world, protocol_seen(self.protocol, self.see))
                check_flies(self.planner, protocol)
                check_max_steps(self.max_steps, protocol)
                swimming = self.swim.chosen(protocol)
                name = planner_name(self.planner)
                words, orders = "", None
                if self.mission is not None:
                    draft = None if self.yes else self.out / "mission.draft.png"
                    words, orders = _orders(self.mission, self.planner, world, protocol, draft)
                known = self.ground.known(site, self.planner, world.bounds, protocol, world)
                with stage(f"preparing {world.name} {world.seed}"):
                    visibility, renderer = sight_in(world, protocol), Renderer(world)
                steps = simulate(
                    world,
                    self.planner,
                    protocol,
                    start=self.start,
                    max_steps=self.max_steps,
                    orders=orders,
                    swimming=swimming,
                    renderer=renderer,
                    solids=visibility.solids,
                    prior=known.prior,
                    budget=budget,
                )
                config = run_config(
                    world,
                    name,
                    self.planner,
                    protocol,
                    world_from=self.world,
                    start=self.start,
                    max_steps=self.max_steps,
                    orders=orders,
                    words=words,
                    swimming=swimming,
                    budget=budget,
                )
                with stage(f"working out what counts in {world.name} {world.seed}"):
                    scorer = Scorer(world, protocol, visibility=visibility, renderer=renderer, orders=orders)
                check()
            # Only now: what is interrupted before it can fly leaves no folder.
            now = datetime.datetime.now(datetime.UTC)
            folder = recording.new_run_folder(self.out, world.name, world.seed, name, now)
            recording.write_config(folder, {**config, **known.config(), "began": now})
            if self.live:
                from dream.live.beside import shown_live

                shown.enter_context(shown_live(folder))
            if orders is not None:
                write_mission(folder / "mission.json", words, orders)
                draw_orders(orders, world.bounds, protocol, folder / "mission.png")
            known.keep(folder)
            if self.keep_observations or site is not None:
                steps = keep(steps, folder, protocol)

            def annotated(step: Step) -> Mapping[str, Any]:
                coverage = scorer.add(step)
                volume = step.occupancy.volume
                if self.live and volume is not None and step.index > 0 and step.index % SCENE_EVERY == 0:
                    write_scene_of(folder, world, scorer, volume)
                return {"coverage": coverage.as_dict()}

            recorded = recording.record(steps, folder, annotate=annotated)
            total = self.max_steps or protocol.cap
            if orders is not None and orders.max_steps is not None:
                total = min(total, orders.max_steps)
            with recording.compiling_noted(folder):
                stopped = fly_to_end(recorded, f"{name} · {world.name} {world.seed}", total)
        summary = summarize(world, name, protocol, scorer, working_time() - began, stopped)
        return tell_outcome(folder, world, scorer, self.planner, summary, stopped, json=self.json)


def run_with(path: str) -> type[Run]:
    """The command where the file of a planner stands in the place of a planner's name.

    Raises:
        PlannerFailed: See `own_planner`.
    """
    planner = own_planner(Path(path))
    chosen = tyro.extras.subcommand_type_from_defaults({Path(path).name: planner})
    options = [("planner", chosen, field(default=planner))]
    return make_dataclass("Run", options, bases=(Run,), frozen=True, slots=True)


def _orders(
    mission: str, planner: object, world: World, protocol: SurveyProtocol, draft: Path | None
) -> tuple[str, Orders]:
    """What the operator orders, in a file or in words for the planner's own model: the words, and the orders.

    Args:
        mission: The file or the words.
        planner: Who flies it.
        world: Where.
        protocol: By which rules.
        draft: File to draw the areas in while the operator is asked; None where nobody is asked.
    """
    from dream.evaluation.runner import labelled_in
    from dream.planning.vlm.orders import check_flyable

    if (known := given(mission)) is not None:
        check_flyable(known[1], world.bounds, protocol, labelled_in(world))
        return known
    if not isinstance(planner, Asking):
        raise ValueError(
            "--mission: expected a file .json, since this planner asks no model, got plain words. "
            "Let dream mission turn them into one"
        )
    if draft is not None:
        check_writable(draft.parent)
    wanted = None if draft is None else ("Fly this?", draft)
    return mission, confirmed(mission, planner, world, protocol, wanted, sys.stderr)
