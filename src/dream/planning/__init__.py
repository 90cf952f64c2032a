"""Observation, Map → Decision."""

import re

from dream.flies import flies
from dream.own_code import own_name
from dream.planning.baselines import (
    Lawnmower,
    MutualInformation,
    NearestFrontier,
    NextBestView,
    RandomWalk,
    Spiral,
    SweepAndGraze,
    UivNav,
)
from dream.planning.belief import Belief
from dream.planning.greedy import Greedy
from dream.planning.human import Human
from dream.planning.sixsteps import SixSteps
from dream.planning.space.orbits import Orbits
from dream.planning.space.rivals.cover_tour import CoverTour
from dream.planning.space.rivals.fuel import Fuel
from dream.planning.space.rivals.space_nbv import SpaceNextBestView
from dream.planning.space.tiers import Tiers
from dream.planning.vlm import Asking, Dream, Ranked, Vanilla

AnyPlanner = (
    Belief
    | Greedy
    | SixSteps
    | Lawnmower
    | Spiral
    | NearestFrontier
    | NextBestView
    | SweepAndGraze
    | MutualInformation
    | RandomWalk
    | UivNav
    | Orbits
    | Tiers
    | CoverTour
    | SpaceNextBestView
    | Fuel
    | Dream
    | Vanilla
    | Ranked
    | Human
)

PLANNERS: dict[str, AnyPlanner] = {
    "belief": Belief(),
    "greedy": Greedy(),
    "sixsteps": SixSteps(),
    "lawnmower": Lawnmower(),
    "spiral": Spiral(),
    "frontier": NearestFrontier(),
    "nbv": NextBestView(),
    "sweep-and-graze": SweepAndGraze(),
    "mutual-information": MutualInformation(),
    "random": RandomWalk(),
    "uivnav": UivNav(),
    "orbits": Orbits(),
    "tiers": Tiers(),
    "cover-tour": CoverTour(),
    "space-nbv": SpaceNextBestView(),
    "fuel": Fuel(),
    "dream": Dream(),
    "vanilla": Vanilla(),
    "ranked": Ranked(),
}
"""Every planner by its name on the command line, with its default parameters. The first is the default."""

HUMAN = "human"
"""What a person who flies is called: none of `PLANNERS`, since no command flies it without one."""

LABELLED = "+"
"""Between a planner's name and a label, where a benchmark holds one that asks several models, or several
persons."""

LABEL = re.compile(r"[A-Za-z0-9._-]{1,40}")
"""What a label may be."""

IN_SPACE: tuple[str, ...] = tuple(name for name, one in PLANNERS.items() if flies(one, in_space=True))
"""Names of those that fly under a protocol that moves in space. The others read the map's planar layers."""

PLANAR: tuple[str, ...] = tuple(name for name, one in PLANNERS.items() if flies(one, in_space=False))
"""Names of those that fly under a planar protocol."""

OFFLINE: tuple[str, ...] = tuple(name for name in PLANAR if not isinstance(PLANNERS[name], Asking | UivNav))
"""Names of those of them that need nothing but this machine: they ask no model, and run no network, which
takes ONNX Runtime."""

OFFLINE_IN_SPACE: tuple[str, ...] = ("belief", "greedy", "sixsteps")
"""Names of those that need as little and, under a protocol that moves in space, find reefs and wrecks."""


def check_installed(planner: object) -> None:
    """Raise a ValueError where what a planner needs is not installed: an extra, for those that need one."""
    if isinstance(planner, Asking | UivNav):
        planner.check_installed()


def planner_name(planner: AnyPlanner) -> str:
    """The name of a planner on the command line; of one's own, that of its file."""
    kind = type(planner)
    if kind is Human:
        return HUMAN
    names = (name for name, default in PLANNERS.items() if type(default) is kind)
    return next(names, None) or own_name(kind)


__all__ = [
    "HUMAN",
    "IN_SPACE",
    "LABEL",
    "LABELLED",
    "OFFLINE",
    "OFFLINE_IN_SPACE",
    "PLANAR",
    "PLANNERS",
    "AnyPlanner",
    "Asking",
    "Belief",
    "CoverTour",
    "Dream",
    "Fuel",
    "Greedy",
    "Human",
    "Lawnmower",
    "MutualInformation",
    "NearestFrontier",
    "NextBestView",
    "Orbits",
    "RandomWalk",
    "Ranked",
    "SixSteps",
    "SpaceNextBestView",
    "Spiral",
    "SweepAndGraze",
    "Tiers",
    "UivNav",
    "Vanilla",
    "check_installed",
    "planner_name",
]
