"""Is what fails on a vehicle named in time, and does the mission come home?

    python perf/failures.py                              80 missions of the Heavy, hours; goes on where it was
    python perf/failures.py --vehicle bluerov2 --missions 40
    python perf/failures.py --fails part --missions 16   battery, lamp, depth sensor and camera
    python perf/failures.py --fails nothing --missions 10     is something named all the same?

Each mission swims in a world of `dev`, reefs and wrecks, with a current from a direction that is drawn. One
of its thrusters or parts fails, one kind after the other, at a second that is drawn. Seconds until it is
named count from then; of a thruster, from when it first gives another force than it was commanded. Nothing is
tuned on `test`.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from dream.errors import MissionAborted
from dream.evaluation.statistics import share_interval
from dream.evaluation.suites import Case, family_of, suite_named
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.planning import PLANNERS
from dream.robots import Anchored, Motion, Simulated, _kernels
from dream.sim.ordered import protocol_in
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY
from dream.vehicle import Fault, FaultKind, PartFault, ThrusterFault, VehiclePart

VEHICLES = {"heavy": BLUEROV2_HEAVY, "bluerov2": BLUEROV2}
SOON = {"thruster": 3.0, "part": 20.0, "nothing": 3.0}
"""Seconds within which a fault should be named; that of a part is told at the end of a move."""
DRAWN = (5.0, 60.0)
"""Seconds of the mission within which something fails."""
SEED = 900_047
NAMES = {
    VehiclePart.SAG: "battery",
    VehiclePart.LAMP: "lamp",
    VehiclePart.GAUGE: "depth sensor",
    VehiclePart.CAMERA: "camera",
}
"""What the trouble of each begins with, after its article."""


@dataclass(frozen=True, slots=True)
class Swum:
    """One mission."""

    vehicle: str
    protocol: str
    planner: str
    number: int
    world: str
    seed: int
    fails: str
    """`thruster`, `part` or `nothing`."""
    fault: str
    """As it is said to `--fault`; empty where nothing fails."""
    shown_s: float | None
    """When it failed, a thruster when it first gave another force than it was commanded; None where it never
    did."""
    named_s: float | None
    named: str
    rightly: bool
    ended: str
    why: str
    steps: int
    seconds: float
    """On the mission's clock."""
    contacts_before: int
    contacts_after: int
    """Since it showed."""


def case_of(number: int) -> Case:
    """Reefs and wrecks of `dev` in turn, kinds mixed."""
    every = suite_named("dev")
    wrecks = [case for case in every if family_of(case.world).startswith("wreck")]
    some = wrecks if number % 2 else [case for case in every if case not in wrecks]
    return some[7 * (number // 2) % len(some)]


def fault_of(number: int, fails: str, vehicle: str) -> Fault | None:
    """What fails in the mission of that number."""
    at = round(float(np.random.default_rng((SEED, number)).uniform(*DRAWN)), 2)
    if fails == "part":
        return PartFault(list(VehiclePart)[number // 2 % len(VehiclePart)], at)
    if fails == "nothing":
        return None
    thruster = 1 + number // len(FaultKind) % VEHICLES[vehicle].thrusters.count
    return ThrusterFault(thruster, list(FaultKind)[number % len(FaultKind)], at)


def spelt(fault: Fault | None) -> str:
    """As it is said to `--fault`."""
    if fault is None:
        return ""
    what = fault.part if isinstance(fault, PartFault) else f"{fault.kind}:{fault.thruster}"
    return f"{what}@{fault.at_s:g}"


def is_right(fault: Fault | None, robot: Simulated, named: str) -> bool:
    """Is what was named what failed?"""
    if isinstance(fault, PartFault):
        return named.startswith(f"the {NAMES[fault.part]} ")
    found = robot.finding
    return (
        fault is not None
        and found is not None
        and (found.thruster, found.kind) == (fault.thruster, fault.kind)
    )


def swim(number: int, fails: str, vehicle: str, name: str, planner: str, max_steps: int | None) -> Swum:
    """The mission of that number."""
    case, fault = case_of(number), fault_of(number, fails, vehicle)
    world, body = case.open(), VEHICLES[vehicle]
    protocol = protocol_in(world, name)
    robot = Simulated(world, protocol, world.starts[case.start], motion=Motion(vehicle=body, fault=fault))
    steps = explore(
        Anchored(robot, protocol),
        PLANNERS[planner],
        OccupancyMap(world.bounds, protocol),
        max_steps=max_steps,
    )
    clock = robot._voyage.clock
    shown = fault.at_s if isinstance(fault, PartFault) else math.inf
    ended, why, named, told_s, made, before, after = "", "", "", math.nan, 0, 0, 0
    try:
        for step in steps:
            made, ended = step.index, step.ended
            failed = min(shown, float(clock[_kernels.FAILED])) <= clock[_kernels.TIME]
            before += step.arrival.collided and not failed
            after += step.arrival.collided and failed
            if step.observation.trouble and not named:
                named, told_s = step.observation.trouble, step.observation.time
    except MissionAborted as error:
        ended, why = "aborted", str(error)
    shown, found = min(shown, float(clock[_kernels.FAILED])), robot.finding
    if found is not None:
        # It is named in the middle of a move, and told after it.
        named, told_s = str(found), found.time
    return Swum(
        vehicle=vehicle,
        protocol=name,
        planner=planner,
        number=number,
        world=case.world,
        seed=case.seed,
        fails=fails,
        fault=spelt(fault),
        shown_s=shown if math.isfinite(shown) else None,
        named_s=told_s if named else None,
        named=named,
        rightly=is_right(fault, robot, named),
        ended=ended,
        why=why,
        steps=made,
        seconds=float(clock[_kernels.TIME]),
        contacts_before=before,
        contacts_after=after,
    )


def share(of: Sequence[bool]) -> str:
    """How many, and their share with Wilson's interval."""
    told = share_interval(sum(of), len(of))
    return f"{sum(of)}/{len(of)} ({told.low:.2f} to {told.high:.2f})"


def kind_of(one: Swum) -> str:
    """Of a fault, without which thruster and when."""
    return one.fault.partition("@")[0].partition(":")[0]


def told(swum: list[Swum], fails: str) -> str:
    """A table by kind of fault, and what healthy swimming came to."""
    heads = (
        "kind",
        "missions",
        f"named in {SOON[fails]:g} s",
        "wrongly",
        "never",
        "contacts",
        "home",
        "surfaced",
    )
    lines = ["{:>8} {:>8} {:>22} {:>8} {:>6} {:>9} {:>22} {:>8}".format(*heads)]
    kinds = sorted({kind_of(one) for one in swum if one.fault})
    for kind in (*kinds, "all"):
        some = [one for one in swum if one.shown_s is not None and kind in (kind_of(one), "all")]
        delays = [
            one.named_s - one.shown_s if one.named_s is not None and one.shown_s is not None else math.inf
            for one in some
        ]
        soon = [one.rightly and 0.0 <= delay <= SOON[fails] for one, delay in zip(some, delays, strict=True)]
        lines.append(
            f"{kind:>8} {len(some):8} {share(soon):>22} "
            f"{sum(bool(one.named) and not one.rightly for one in some):8} "
            f"{sum(not one.named for one in some):6} "
            f"{sum(one.contacts_after for one in some):9} "
            f"{share([one.ended in ('done', 'returned') for one in some]):>22} "
            f"{sum('the vehicle surfaced' in one.why for one in some):8}"
        )
    healthy = sum(one.seconds if one.shown_s is None else one.shown_s for one in swum) / 3600.0
    early = [
        one for one in swum if one.named_s is not None and (one.shown_s is None or one.named_s < one.shown_s)
    ]
    lines.append(
        f"{len(early)} named in {healthy:.2f} h of healthy swimming, "
        f"with {sum(one.contacts_before for one in swum)} contacts"
    )
    return "\n".join(lines)


def main() -> int:
    """Swim what is missing, and print the table of all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--vehicle", choices=VEHICLES, default="heavy")
    parser.add_argument("--fails", choices=("thruster", "part", "nothing"), default="thruster")
    parser.add_argument("--missions", type=int, default=80)
    parser.add_argument("--protocol", default="dream-v2-nav")
    parser.add_argument("--planner", choices=PLANNERS, default="belief")
    parser.add_argument("--max-steps", type=int, default=None, help="the protocol's cap unless given")
    parser.add_argument("--out", type=Path, default=Path("failures.jsonl"), help="where missions are kept")
    given = parser.parse_args()
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    kept = [Swum(**json.loads(line)) for line in lines]
    like = (given.fails, given.vehicle, given.protocol, given.planner)

    def is_like(one: Swum) -> bool:
        return (one.fails, one.vehicle, one.protocol, one.planner) == like

    there = {one.number for one in kept if is_like(one)}
    with given.out.open("a") as file:
        for number in range(given.missions):
            if number in there:
                continue
            one = swim(number, *like, given.max_steps)
            kept.append(one)
            file.write(f"{json.dumps(asdict(one))}\n")
            file.flush()
            late = (
                "" if one.named_s is None or one.shown_s is None else f"{one.named_s - one.shown_s:.2f} s, "
            )
            print(
                f"{number}: {one.world} {one.seed}, {one.fault or 'healthy'}: {late}"
                f"{one.named or 'nothing named'}, {one.ended} {one.why} after {one.steps} steps, "
                f"{one.contacts_before} and {one.contacts_after} contacts",
                flush=True,
            )
    print(told([one for one in kept if is_like(one)], given.fails))
    return 0


if __name__ == "__main__":
    sys.exit(main())
