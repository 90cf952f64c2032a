"""What each command of `dream` does. Its fields are its options; calling it runs it."""

from __future__ import annotations

import contextlib
import datetime
import json as json_format
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import tyro

from dream import __version__
from dream.errors import MissionAborted
from dream.names import look_up
from dream.planning import PLANNERS, AnyPlanner
from dream.protocol import protocol_named

if TYPE_CHECKING:
    from PIL import Image

    from dream.sim.world import World

T = TypeVar("T")


if TYPE_CHECKING:
    ChosenPlanner = AnyPlanner
else:
    ChosenPlanner = tyro.extras.subcommand_type_from_defaults(PLANNERS, sort_subcommands=False)


@dataclass(frozen=True, slots=True)
class Run:
    """Fly one mission in a simulated world; leave its recording, its report and its summary."""

    planner: ChosenPlanner = PLANNERS["sixsteps"]
    """Who decides."""
    world: str = "reef/string"
    """A name from `dream worlds`, or a folder that holds a saved world."""
    seed: int = 1
    """Which world of that name."""
    start: int = 0
    """Which of the world's start poses."""
    out: Path = Path("runs")
    """Folder that the run's own folder is made in."""
    max_steps: int | None = None
    """Decisions at most; the protocol's cap unless given."""
    protocol: str | None = None
    """Survey protocol; the one that the world is made for unless given."""
    json: bool = False
    """Print the summary as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0; a MissionAborted where the mission did not end by itself."""
        from dream import recording
        from dream.evaluation.metrics import Scorer
        from dream.evaluation.runner import simulate, summarize
        from dream.report import write_report

        if self.max_steps is not None and self.max_steps < 1:
            raise ValueError(f"--max-steps: expected at least 1, got {self.max_steps}")
        began = time.perf_counter()
        world = _open_world(self.world, self.seed)
        protocol = protocol_named(self.protocol or world.protocol)
        name = planner_name(self.planner)
        steps = simulate(world, self.planner, protocol, start=self.start, max_steps=self.max_steps)
        folder = recording.new_run_folder(
            self.out, world.name, world.seed, name, datetime.datetime.now(datetime.UTC)
        )
        recording.write_config(folder, self._config(world, protocol.name, name))

        scorer = Scorer(world, protocol)
        stopped: BaseException | None = None
        with contextlib.closing(
            recording.record(steps, folder, annotate=lambda step: {"coverage": scorer.add(step).as_dict()})
        ) as recorded:
            try:
                for _ in _with_progress(
                    recorded, f"{name} · {world.name} {world.seed}", self.max_steps or protocol.cap
                ):
                    pass
            except KeyboardInterrupt as interrupt:
                stopped = interrupt
            except Exception as failure:  # noqa: BLE001 - whatever stopped it, what was flown is kept.
                stopped = failure
        summary = summarize(world, name, protocol, scorer, time.perf_counter() - began)
        recording.write_summary(folder, summary)
        page = write_report(folder)
        if self.json:
            _print_json(summary)
        else:
            _print_outcome(summary, page)
        if stopped is not None:
            why = "interrupted" if isinstance(stopped, KeyboardInterrupt) else f"aborted: {stopped}"
            raise MissionAborted(f"{why}; {summary['steps']} steps are kept in {folder}") from stopped
        return 0

    def _config(self, world: World, protocol: str, planner: str) -> dict[str, Any]:
        from dream.sim.files import world_hash

        return {
            "version": __version__,
            "commit": _commit(),
            "protocol": protocol,
            "world": world.name,
            "seed": world.seed,
            "world_from": self.world,
            "world_hash": world_hash(world),
            "start": self.start,
            "planner": planner,
            "planner_parameters": asdict(self.planner),
            "max_steps": self.max_steps,
        }


@dataclass(frozen=True, slots=True)
class Bench:
    """Fly planners over the worlds of a suite, side by side, and print a table."""

    suite: tyro.conf.Positional[str] = "paper"
    """A suite: `paper` is ten reefs and five wrecks."""
    planners: tuple[str, ...] = ("sixsteps", "lawnmower", "random")
    """Which planners, with their default parameters."""
    protocol: str = "dream-v1"
    """Survey protocol."""
    max_steps: int | None = None
    """Decisions at most; the protocol's cap unless given."""
    workers: int | None = None
    """Missions at a time; as many as there are processors unless given."""
    json: bool = False
    """Print all summaries as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.evaluation.runner import Flight, fly_all
        from dream.evaluation.suites import suite_named

        protocol_named(self.protocol)
        if not self.planners:
            raise ValueError(f"--planners: expected one or more of {', '.join(PLANNERS)}, got none")
        if self.workers is not None and self.workers < 1:
            raise ValueError(f"--workers: expected at least 1, got {self.workers}")
        flights = [
            Flight(
                case.world,
                case.seed,
                name,
                look_up(PLANNERS, name, "planner"),
                self.protocol,
                max_steps=self.max_steps,
            )
            for case in suite_named(self.suite)
            for name in self.planners
        ]
        finished = dict(_with_progress(fly_all(flights, self.workers), self.suite, len(flights)))
        if self.json:
            _print_json({"suite": self.suite, "missions": [finished[flight] for flight in flights]})
        else:
            _print_table(
                [finished[flight] for flight in flights],
                list(self.planners),
                protocol_named(self.protocol).cap,
            )
        return 0


@dataclass(frozen=True, slots=True)
class Worlds:
    """List the worlds that can be named, or save one as a folder to edit."""

    save: str | None = None
    """Save this world instead of listing."""
    seed: int = 1
    """Which world of that name."""
    out: Path = Path("world")
    """Folder to save to."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.sim.files import save_world, world_hash
        from dream.sim.worlds import WORLDS, make_world

        if self.save is not None:
            world = make_world(self.save, self.seed)
            save_world(world, self.out)
            record = {
                "world": world.name,
                "seed": world.seed,
                "hash": world_hash(world),
                "folder": str(self.out),
            }
            if self.json:
                _print_json(record)
            else:
                print(f"saved {world.name} {world.seed}; fly it with: dream run --world {self.out}")
        elif self.json:
            _print_json({"worlds": list(WORLDS)})
        else:
            print("\n".join(WORLDS))
        return 0


@dataclass(frozen=True, slots=True)
class Draw:
    """Draw a world as a picture: its chart from above, and what the camera sees from two of its starts."""

    world: str = "reef/string"
    """A name from `dream worlds`, or a folder that holds a saved world."""
    seed: int = 1
    """Which world of that name."""
    out: Path | None = None
    """Picture to write; `WORLD-SEED.png` unless given."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.sim.chart import chart
        from dream.sim.files import world_hash

        world = _open_world(self.world, self.seed)
        out = self.out or Path(f"{world.name.replace('/', '-')}-{world.seed}.png")
        if out.suffix.lower() not in (".png", ".jpg", ".jpeg", ".webp"):
            raise ValueError(f"--out: expected a name that ends in .png, .jpg or .webp, got {out}")
        _portrait(world, chart(world)).save(out)
        if self.json:
            _print_json(
                {"world": world.name, "seed": world.seed, "hash": world_hash(world), "picture": str(out)}
            )
        else:
            counts = f"{len(world.targets)} individuals, {len(world.obstacles)} obstacles"
            print(f"{world.name} {world.seed}: {counts} → {out}")
        return 0


@dataclass(frozen=True, slots=True)
class Report:
    """Write the HTML page of a recorded run again, also of one that was interrupted."""

    run: tyro.conf.Positional[Path]
    """Folder of the run."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.report import write_report

        page = write_report(self.run)
        if self.json:
            _print_json({"run": str(self.run), "report": str(page)})
        else:
            print(page)
        return 0


def planner_name(planner: AnyPlanner) -> str:
    """The name of a planner on the command line."""
    return next(name for name, default in PLANNERS.items() if type(default) is type(planner))


def _open_world(name: str, seed: int) -> World:
    from dream.sim.files import load_world
    from dream.sim.worlds import make_world

    return load_world(Path(name)) if (Path(name) / "world.json").is_file() else make_world(name, seed)


def _portrait(world: World, above: Image.Image) -> Image.Image:
    """The chart, and beside it what the camera sees from the first two starts, as a model is shown it."""
    from PIL import Image

    from dream.geometry import SE3
    from dream.sim.render import Renderer

    protocol, renderer = protocol_named(world.protocol), Renderer(world)
    camera = protocol.camera.scaled(2.0)
    picture = Image.new("RGB", (above.width + camera.width, max(above.height, 2 * camera.height)), "white")
    picture.paste(above, (0, 0))
    for k, start in enumerate(world.starts[:2]):
        seabed = float(world.terrain.height(start.x, start.y))
        T_world_base = SE3.level(start.x, start.y, seabed + protocol.altitude, start.yaw)
        frame = renderer.render(camera, T_world_base @ protocol.T_base_camera)
        picture.paste(Image.fromarray(frame.rgb), (above.width, k * camera.height))
    return picture


def _commit() -> str | None:
    """The commit that this package was run from, where it is a checkout of this project."""
    import subprocess

    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return None
    found = subprocess.run(
        ["git", "-C", str(root), "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    )
    return found.stdout.strip() or None


def _with_progress(items: Iterator[T], title: str, total: int) -> Iterator[T]:
    """Pass items on, with a progress bar on standard error where that is a terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(title, total=total)
        for done, item in enumerate(items):
            bar.update(task, completed=done)
            yield item


def _print_json(record: Mapping[str, Any]) -> None:
    print(json_format.dumps(record, allow_nan=False))


def _print_outcome(summary: Mapping[str, Any], page: Path) -> None:
    coverage = summary["coverage"]
    ended = {"done": "done", "cap": "steps spent", "aborted": "interrupted"}[summary["ended"]]
    times = ", ".join(
        f"{name[1:]} % at {summary[name]}"
        for name in ("t90", "t95", "t98", "t100")
        if summary[name] is not None
    )
    print(f"{summary['world']} {summary['seed']} · {summary['planner']} · {summary['protocol']}")
    print(f"  {ended} after {summary['steps']} steps" + (", a success" if summary["success"] else ""))
    print("  seen: " + ", ".join(f"{coverage[k]:.1%} of the {k}" for k in ("instances", "clusters", "area")))
    if times:
        print(f"  steps to a share of the instances: {times}")
    print(f"  {summary['collisions']} collisions, {summary['distance_m']:.0f} m, {summary['wall_s']:.1f} s")
    print(f"  report: {page}")


def _print_table(summaries: list[dict[str, Any]], planners: list[str], cap: int) -> None:
    from rich.console import Console
    from rich.table import Table

    from dream.evaluation.metrics import pooled

    table = Table(title=f"mean over the worlds; a time never reached counts as {cap}")
    for heading in (
        "worlds",
        "planner",
        "t90",
        "t98",
        "steps",
        "instances",
        "clusters",
        "area",
        "success",
        "collisions",
    ):
        table.add_column(heading, justify="left" if heading in ("worlds", "planner") else "right")
    families = sorted({s["world"].split("/")[0] for s in summaries})
    for family in families:
        for planner in planners:
            chosen = [s for s in summaries if s["planner"] == planner and s["world"].startswith(family + "/")]
            shares = [
                sum(s["coverage"][k] for s in chosen) / len(chosen) for k in ("instances", "clusters", "area")
            ]
            table.add_row(
                f"{len(chosen)} {family}",
                planner,
                *(f"{pooled(chosen, key, cap):.1f}" for key in ("t90", "t98", "t_stop")),
                *(f"{share:.1%}" for share in shares),
                f"{sum(s['success'] for s in chosen)}/{len(chosen)}",
                str(sum(s["collisions"] for s in chosen)),
            )
    Console(width=None if sys.stdout.isatty() else 120).print(table)
