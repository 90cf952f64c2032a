"""`dream mission`: an operator's words, turned once into orders that any planner obeys."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TextIO

import tyro

from dream.commands.console import check_writable, open_world, price, print_json
from dream.commands.progress import stage
from dream.errors import MissionAborted
from dream.options import First
from dream.telling import one_line

if TYPE_CHECKING:
    from dream.geometry import Bounds
    from dream.orders import Orders
    from dream.planning.vlm.asking import Asking
    from dream.protocol import SurveyProtocol
    from dream.sim.world import World


@dataclass(frozen=True, slots=True)
class Mission:
    """Let a model turn an operator's words into orders. Shows them, and writes them once you confirm.

    `dream run --mission mission.json` flies the orders, with any planner.

    Examples:
        dream mission "Map the reef in at most 60 steps." --model wire
    """

    text: tyro.conf.Positional[str]
    """The mission in plain words: what to find or map, where, in which order, in how many steps at most."""
    model: First[str] = ""
    """Which model: `openai:NAME`, `anthropic:NAME`, `google:NAME`, the address of a server that speaks
    OpenAI's interface, such as http://localhost:8000/v1, or `wire`, a stand-in that answers by rules."""
    model_name: First[str] = ""
    """What the server at that address calls the model."""
    prompts: str | None = None
    """Folder with an `orders.md` of your own. It takes the place of the package's prompt."""
    world: First[Annotated[str, tyro.conf.arg(metavar="WORLD")]] = "reef/string"
    """A name from `dream worlds`, or the folder of a saved world."""
    seed: First[int] = 1
    """Which world of that name."""
    protocol: str | None = None
    """Rules of the survey: sensors, reach and cap. Unless given, dream-v2; those of the pool for a tank."""
    out: First[Path] = Path("mission.json")
    """File to write. A picture of the areas is written beside it."""
    yes: First[bool] = False
    """Take the orders as the model understood them, and ask nobody to confirm them."""
    json: bool = False
    """Print the orders as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0; a MissionAborted where the operator says no, or no answer counted."""
        from dream.orders import written
        from dream.planning.vlm.asking import Asking
        from dream.planning.vlm.orders import write_mission
        from dream.sim.ordered import protocol_in

        if self.out.is_dir():
            raise ValueError(f"--out: expected a file, got the folder {self.out}")
        if self.out.suffix != ".json":  # `dream run --mission` knows a file by it.
            raise ValueError(f"--out: expected a name that ends in .json, got {self.out}")
        asking = Asking(self.model, self.model_name, prompts=self.prompts)
        picture = self.out.with_suffix(".png")
        if not self.yes:
            check_terminal(asking)
        check_writable(self.out.parent)
        self._check_new(picture)
        asking.line()  # What is missing to ask a model is told before anything compiles.
        with stage(f"opening {self.world} {self.seed}"):
            world = open_world(self.world, self.seed)
        protocol = protocol_in(world, self.protocol)
        told = sys.stderr if self.json else sys.stdout
        wanted = None if self.yes else ("Keep these orders?", picture.with_suffix(".draft.png"))
        orders = confirmed(self.text, asking, world, protocol, wanted, told)
        self._check_new(picture, orders)
        draw_orders(orders, world.bounds, protocol, picture)
        write_mission(self.out, self.text, orders)
        if self.json:
            print_json(written(orders))
        else:
            print(f"written: {self.out}, and {picture}, in which its areas are drawn")
            print(
                f"to fly it: dream run --mission {self.out} --world {self.world} --seed {self.seed} "
                f"--protocol {protocol.name}"
            )
        return 0

    def _check_new(self, picture: Path, orders: Orders | None = None) -> None:
        """Raise a ValueError where a file would be written over that is not this very mission.

        Args:
            picture: Of the areas.
            orders: That were understood; None before.
        """
        from dream.planning.vlm.orders import read_mission

        if not self.out.exists():
            if picture.exists():
                raise ValueError(
                    f"--out: expected a name without a picture beside it, got {self.out}, and there is "
                    f"{picture}. Choose another name, or move that picture away"
                )
            return
        try:
            text, kept = read_mission(self.out)
        except ValueError:
            text, kept = None, None
        if text != self.text or (orders is not None and kept != orders):
            raise ValueError(
                f"--out: expected a file that does not exist, or that holds this mission, got {self.out}, "
                "which holds something else. Choose another name, or move that file away"
            )


def confirmed(
    text: str,
    asking: Asking,
    world: World,
    protocol: SurveyProtocol,
    wanted: tuple[str, Path] | None,
    told: TextIO,
) -> Orders:
    """What a model makes of an operator's words, once the operator agrees.

    Args:
        text: The words.
        asking: Which model is asked, once.
        world: Where it will be flown.
        protocol: By which rules.
        wanted: What to ask the operator, and the file to draw the areas in while that is asked; None where
            the operator agreed before.
        told: Where to print what was understood.

    Raises:
        ValueError: It cannot be flown, or nobody is there to agree.
        MissionAborted: The operator does not agree, or no answer of the model counted.
    """
    from dream.evaluation.runner import labelled_in
    from dream.orders import sentences
    from dream.planning.vlm.orders import ask_orders

    if wanted is not None:
        check_terminal(asking)
    with stage(f"asking {asking.label}"):
        understood = ask_orders(asking, text, world.bounds, protocol, labelled_in(world))
    orders, exchange = understood.orders, understood.exchange
    print("Understood:", *sentences(orders, protocol.cap), sep="\n  ", file=told)
    if understood.left_out:
        print(f"  Not in the orders, says the model: {one_line(understood.left_out)}", file=told)
    tokens = exchange.tokens_in + exchange.tokens_out
    print(
        f"  Asked {exchange.model}: calls {exchange.requests}, tokens {tokens}, {price(exchange.cost_usd)}.",
        file=told,
    )
    if wanted is not None:
        question, draft = wanted
        draw_orders(orders, world.bounds, protocol, draft)
        try:
            print(f"  The areas are drawn in {draft}, until you answer.", file=told)
            print(f"{question} [y/N] ", end="", file=told, flush=True)
            if sys.stdin.readline().strip().lower() not in ("y", "yes"):
                raise MissionAborted("the orders were not confirmed; nothing is written or flown")
        finally:
            draft.unlink(missing_ok=True)
    return orders


def check_terminal(asking: Asking) -> None:
    """Raise a ValueError where nobody can be asked to confirm what a model understands."""
    if not sys.stdin.isatty():
        asking.line()  # What is wrong with the model would stay wrong with --yes, so it is told first.
        raise ValueError(
            "Nobody can confirm without a terminal. "
            "Add --yes to take the orders as the model understood them."
        )


def given(mission: str) -> tuple[str, Orders] | None:
    """The operator's words and the orders, from a file or from JSON; None where it is plain words."""
    from dream.planning.vlm.orders import read_mission, read_orders

    if mission.lstrip().startswith("{"):
        return "", read_orders(mission)
    if mission.endswith(".json"):
        return read_mission(Path(mission))
    return None


def draw_orders(orders: Orders, bounds: Bounds, protocol: SurveyProtocol, path: Path) -> None:
    """Draw the areas, each with the number of its leg, above the orders in plain words.

    The side of what is still to be found has no place yet.
    """
    from dream.mapping.drawing import draw_areas
    from dream.orders import place, sentences

    areas: list[Bounds | None] = []
    lines = list(sentences(orders, protocol.cap))
    for index, leg in enumerate(orders.legs):
        try:
            areas.append(place(leg.area, bounds, {}) or bounds)
        except LookupError:
            areas.append(None)
            lines[index] += " Where that is, is not known yet."
    draw_areas(bounds, protocol, areas, lines).save(path)
