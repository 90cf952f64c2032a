"""`dream mission`: an operator's words, turned once into orders that any planner obeys."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import tyro

from dream.commands.console import open_world, price, print_json
from dream.errors import MissionAborted
from dream.protocol import protocol_named

if TYPE_CHECKING:
    from dream.geometry import Bounds
    from dream.orders import Orders
    from dream.planning.vlm.asking import Asking
    from dream.protocol import SurveyProtocol
    from dream.sim.world import World


@dataclass(frozen=True, slots=True)
class Mission:
    """Let a model turn an operator's words into orders; show them, and write them once they are confirmed."""

    text: tyro.conf.Positional[str]
    """The mission in plain words: what to find or map, where, in which order, in how many steps at most."""
    model: str = ""
    """Which model: `openai:NAME`, `anthropic:NAME`, `google:NAME`, the address of a server that speaks
    OpenAI's interface, such as http://localhost:8000/v1, or `wire`, the stand-in that answers by rule."""
    model_name: str = ""
    """What the server at that address calls the model."""
    world: str = "reef/string"
    """A name from `dream worlds`, or a folder that holds a saved world."""
    seed: int = 1
    """Which world of that name."""
    protocol: str | None = None
    """Survey protocol; the one that the world is made for unless given."""
    out: Path = Path("mission.json")
    """File to write; a picture of the areas comes beside it."""
    yes: bool = False
    """Take what was understood as confirmed, where nobody can be asked."""
    json: bool = False
    """Print the orders as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0; a MissionAborted where the operator says no."""
        from dream.orders import written
        from dream.planning.vlm.asking import Asking
        from dream.planning.vlm.orders import write_mission

        world = open_world(self.world, self.seed)
        protocol = protocol_named(self.protocol or world.protocol)
        asking = Asking(self.model, self.model_name)
        picture = self.out.with_suffix(".png")
        told = sys.stderr if self.json else sys.stdout
        orders = confirmed(self.text, asking, world, protocol, picture, yes=self.yes, told=told)
        write_mission(self.out, self.text, orders)
        if self.json:
            print_json(written(orders))
        else:
            print(f"written: {self.out}. To fly it: dream run --mission {self.out} --world {self.world}")
        return 0


def confirmed(
    text: str,
    asking: Asking,
    world: World,
    protocol: SurveyProtocol,
    picture: Path,
    *,
    yes: bool,
    told: TextIO,
) -> Orders:
    """What a model makes of an operator's words, once the operator agrees.

    Args:
        text: The words.
        asking: Which model is asked, once.
        world: Where it will be flown.
        protocol: By which rules.
        picture: File to draw the areas in.
        yes: The operator has agreed before.
        told: Where to print what was understood.

    Raises:
        ValueError: It cannot be flown, or nobody is there to agree.
        MissionAborted: The operator does not agree.
    """
    from dream.evaluation.runner import labelled_in
    from dream.orders import sentences
    from dream.planning.vlm.orders import ask_orders

    if not yes and not sys.stdin.isatty():
        raise ValueError(
            "--yes: expected it where no terminal is there to confirm the mission at, got none. "
            "With it, what the model understood is flown as it is"
        )
    understood = ask_orders(asking, text, world.bounds, protocol, labelled_in(world))
    orders, exchange = understood.orders, understood.exchange
    draw_orders(orders, world.bounds, protocol, picture)
    print("Understood:", *sentences(orders, protocol.cap), sep="\n  ", file=told)
    if understood.left_out:
        print(f"  Not in the orders, says the model: {_printable(understood.left_out)}", file=told)
    tokens = exchange.tokens_in + exchange.tokens_out
    print(
        f"  Asked {exchange.model}: calls {exchange.requests}, tokens {tokens}, {price(exchange.cost_usd)}.",
        file=told,
    )
    print(f"  The areas are drawn in {picture}.", file=told)
    if not yes:
        print("Fly this? [y/N] ", end="", file=told, flush=True)
        if sys.stdin.readline().strip().lower() not in ("y", "yes"):
            raise MissionAborted("the mission was not confirmed; nothing is written or flown")
    return orders


def given(mission: str) -> Orders | None:
    """The orders in a file, or those that stand there as JSON; None where it is text in plain words."""
    from dream.planning.vlm.orders import read_mission, read_orders

    if mission.lstrip().startswith("{"):
        return read_orders(mission)
    if mission.endswith(".json"):
        return read_mission(Path(mission))
    return None


def draw_orders(orders: Orders, bounds: Bounds, protocol: SurveyProtocol, path: Path) -> None:
    """Draw the areas on the empty survey area, a number in the middle of each.

    The side of what is still to be found has no place yet.
    """
    import numpy as np

    from dream.mapping import OccupancyMap, draw_map
    from dream.mapping.drawing import Mark
    from dream.orders import place

    areas, marks = [], []
    for number, leg in enumerate(orders.legs, start=1):
        try:
            area = place(leg.area, bounds, {}) or bounds
        except LookupError:
            continue
        areas.append(area)
        # Areas that are the same do not hide each other's numbers.
        x = 0.5 * (area.x_min + area.x_max) + 0.05 * bounds.width * (areas.count(area) - 1)
        marks.append(Mark(number, np.array([[x, 0.5 * (area.y_min + area.y_max)]])))
    path.parent.mkdir(parents=True, exist_ok=True)
    draw_map(OccupancyMap(bounds, protocol), marks=marks, areas=areas).save(path)


def _printable(text: str) -> str:
    """Text from a stranger, without what a terminal would obey."""
    return "".join(character if character.isprintable() else " " for character in text)
