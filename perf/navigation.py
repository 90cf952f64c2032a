"""How well the vehicle goes where it is sent, how far it drifts, and what the loop costs.

    python perf/navigation.py                     all four tables, some minutes
    python perf/navigation.py --only drift --starts 5
    python perf/navigation.py --figure docs                the pictures instead

Station and moves: the autopilot is told the true motion, or flies the whole `Simulated` vehicle by its
estimate. The paper's PD is carried out as a force here, as sticks do without a velocity loop: a command of
one metre a second is the thrust which the model's drag asks for at the autopilot's top speed. Drift: what the
vehicle believes beside the truth, on a survey of two-metre moves and quarter turns. Cost: CPU time, least of
the rounds, beside the same loop in Python, from the objects of the package, to which the tests hold it.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from numba import njit  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import track  # noqa: E402
from tests.robots.slowly import Slow  # noqa: E402

from dream.control import Pd  # noqa: E402
from dream.control import _kernels as control  # noqa: E402
from dream.control.autopilot import Autopilot, nominal  # noqa: E402
from dream.evaluation.figures import Picture, Theme  # noqa: E402
from dream.geometry import SE2, SE3, wrap_angle  # noqa: E402
from dream.protocol import DREAM_V1_NAV as PROTOCOL  # noqa: E402
from dream.robots import Motion, Simulated, _kernels  # noqa: E402
from dream.robots.simulated import BEAT, STAY  # noqa: E402
from dream.sim.render import Renderer  # noqa: E402
from dream.sim.sensors import AHRS, DVL_A50_PERFORMANCE  # noqa: E402
from dream.sim.solids import Solids  # noqa: E402
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Current, Spread, Vehicle  # noqa: E402
from dream.sim.vehicle._kernels import advance, rotation  # noqa: E402
from dream.sim.world import World  # noqa: E402
from dream.sim.worlds import make_world  # noqa: E402
from dream.types import BodyVelocity, Setpoint  # noqa: E402

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]
Goal = tuple[float, float, float, float]
"""x, y, z and yaw."""

BAR = Console(stderr=True)
DEEP = -3.0
STATION = 60.0
"""Seconds of station keeping."""
FLOW = 0.2
"""m/s of the current against which it keeps its station."""
BEARINGS = tuple(math.radians(45.0 * k) for k in range(8))
VEHICLES = {"Heavy": BLUEROV2_HEAVY, "six thrusters": BLUEROV2}
TRUTH, BELIEF = slice(1, 5), slice(5, 9)
"""Columns of a track: x, y, z and yaw, true and estimated. The first is the time."""


def drags(vehicle: Vehicle) -> tuple[float, float, float]:
    """Factors on the published drag, all over what may be drawn: greatest, middle and least."""
    least, most = vehicle.damping
    return most, round(math.sqrt(least * most), 2), least


def dragging(factor: float) -> Spread:
    """So much of the published drag, and nothing else that is not as published."""
    return Spread(damping=(factor, factor), trim=0.0, net_buoyancy=(1.0, 1.0))


def drawn(vehicle: Vehicle, factor: float) -> Vehicle:
    """The same vehicle with so much of its drag."""
    return dragging(factor).draw(vehicle, np.random.default_rng(0))


# ---- by the truth ----


@njit(cache=False, nogil=True)
def told(body, flow, gains, model, goals, waits, dt, every, x, rows, references):  # type: ignore[no-untyped-def]
    """Fill the rows: a flight by the true motion, with new commands every so many steps of the water.

    Every goal but the last holds for so many steps.
    """
    still, pull, memory = np.zeros(2), np.zeros(3), np.zeros(control.MEMORY)
    R, velocity = np.empty((3, 3)), np.empty(3)
    commands = np.zeros(model.sharing.shape[0])
    for k in range(len(rows)):
        r = rotation(x)
        for i in range(9):
            R[i // 3, i % 3] = r[i]
        if k == 0:
            memory[:] = control.begin(x[:3], math.atan2(R[1, 0], R[0, 0]), gains.drag_share)
        if k % every == 0:
            for i in range(3):
                velocity[i] = R[i, 0] * x[7] + R[i, 1] * x[8] + R[i, 2] * x[9]
            goal = goals[min(k // waits, len(goals) - 1)]
            beat = every * dt
            control.steer(
                memory, goal, 1.0, R, x[:3], velocity, x[10:13], gains, model, beat, commands
            )  # fmt: skip
        advance(body, flow, still, pull, commands, dt, x)
        r = rotation(x)
        rows[k, 0] = (k + 1) * dt
        rows[k, 1:4] = x[:3]
        rows[k, 4] = math.atan2(r[3], r[0])
        rows[k, 5:] = rows[k, 1:5]
        references[k] = memory[:4]


def by_truth(
    goals: npt.ArrayLike,
    seconds: float,
    *,
    vehicle: Vehicle,
    factor: float = 1.0,
    autopilot: Autopilot | None = None,
    bearing: float | None = None,
    every: int = 1,
    waits: int = 1,
) -> tuple[Array, Array]:
    """From rest at the origin: the track (B, 9) and the references (B, 4), every 10 ms.

    Goals are x, y, z and yaw; every one but the last holds for so many of these.
    """
    x = vehicle.at_rest(SE3.level(0.0, 0.0, DEEP, 0.0)).vector
    rows, references = np.empty((round(seconds / BEAT), 9)), np.empty((round(seconds / BEAT), 4))
    body, model = drawn(vehicle, factor).body, nominal(vehicle.slowest, vehicle.thrusters)
    gains = (autopilot or Autopilot()).upright(vehicle.hull, vehicle.thrusters).gains
    ways = np.atleast_2d(np.array(goals, np.float64))
    told(body, water(bearing).flow, gains, model, ways, waits, BEAT, every, x, rows, references)
    return rows, references


def water(bearing: float | None) -> Current:
    """Still, or towards a bearing."""
    if bearing is None:
        return Current()
    return Current((FLOW * math.cos(bearing), FLOW * math.sin(bearing), 0.0))


def by_pd(goal: Goal, seconds: float, *, factor: float = 1.0, bearing: float | None = None) -> Array:
    """As `by_truth`, with the paper's law carried out as a force, at 50 Hz; the autopilot holds the depth."""
    pilot, law, hull = Autopilot(), Pd(), BLUEROV2_HEAVY.hull
    vehicle, model = drawn(BLUEROV2_HEAVY, factor), nominal(hull, BLUEROV2_HEAVY.thrusters)
    state = vehicle.at_rest(SE3.level(0.0, 0.0, DEEP, 0.0))
    memory, commands, rows = control.begin(state.position, 0.0, pilot.drag_share), np.zeros(8), []
    tops = np.array([pilot.speed, pilot.speed, 0.0, 0.0, 0.0, pilot.turn_rate])
    stick = np.array(hull.linear) + np.array(hull.quadratic) * tops
    target, beat = Setpoint(goal[0], goal[1], goal[3], 2.0), 2 * BEAT
    for k in range(round(seconds / beat)):
        pose, rates = state.T_world_base, state.angular_velocity
        R = pose.rotation.astype(np.float64)
        # Of the autopilot only what keeps it at its depth, and level.
        there = np.array([*state.position[:2], goal[2], pose.yaw])
        changes = control.guide(memory, there, pilot.gains, 1.0, beat)
        demand, error, _ = control.wrench(
            memory, changes, R, state.position, state.velocity_world, rates, pilot.gains, model
        )
        control.blame(memory, np.array([0.0, 0.0, error[2], 0.0]), (0.0, 0.0), pilot.gains, model, beat)
        u, v, w = state.velocity.tolist()
        asked = law.track(pose.se2, BodyVelocity(u, v, w, float(rates[2])), target)
        demand[0], demand[1] = stick[0] * asked.surge, stick[1] * asked.sway
        demand[5] = stick[5] * asked.yaw_rate
        control.allocate(demand, model, commands)
        for _ in range(2):
            state = vehicle.step(state, commands, BEAT, water(bearing))
        at = [*state.position.tolist(), state.T_world_base.yaw]
        rows.append([(k + 1) * beat, *at, *at])
    return np.array(rows)


# ---- by the estimate ----


@cache
def place() -> tuple[World, Solids, Renderer]:
    """Flat sand, made once."""
    world = make_world("flat/empty", 0)
    return world, Solids(world), Renderer(world)


def launched(start: SE2, motion: Motion, *, current: Current | None = None, every: int = 1) -> Simulated:
    """The whole vehicle, in that water where some is given, its whole loop slower by so much."""
    world, solids, renderer = place()
    robot = Simulated(world, PROTOCOL, start, motion=motion, renderer=renderer, solids=solids)
    ship, dt = robot._ship, every * BEAT
    robot._ship = ship._replace(
        flow=ship.flow if current is None else current.flow,
        dt=dt,
        depth_every=round(1.0 / (motion.gauge.rate * dt)),
        heading_every=round(1.0 / (motion.compass.rate * dt)),
    )
    return robot


def swum(robot: Simulated, goal: SE2, seconds: float, *, stay: float = STAY) -> Array:
    """(B, 9) the track on the way to a goal; a stay of infinity uses up the seconds."""
    motion, rows = robot._motion, np.empty((math.ceil(seconds / robot._ship.dt), 9))
    robot._state, robot._at_ping, how, beats = _kernels.fly(
        robot._ship,
        robot._voyage,
        robot._state,
        robot._at_ping,
        np.array([goal.x, goal.y, goal.yaw]),
        PROTOCOL.altitude,
        math.nan,
        seconds,
        motion.near,
        motion.aligned,
        motion.slow,
        stay,
        robot._rng,
        rows,
    )
    if how not in (_kernels.ARRIVED, _kernels.LATE) or (how == _kernels.LATE and stay == STAY):
        raise RuntimeError(f"a move to {goal} ended as {how} after {beats} beats; expected it to arrive")
    return rows[:beats]


def starts(count: int) -> Iterator[SE2]:
    """So many poses on the lattice, near the middle."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        x, y = rng.uniform(-5.0, 5.0, 2)
        yield PROTOCOL.snap(SE2(x, y, rng.uniform(-math.pi, math.pi)))


def ahead(pose: SE2, forward: float, left: float, turn: float) -> SE2:
    """A pose so far from another, by its own axes."""
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return SE2(pose.x + c * forward - s * left, pose.y + s * forward + c * left, wrap_angle(pose.yaw + turn))


# ---- station ----


def rms(errors: Array) -> float:
    """Root of the mean square of the lengths of rows."""
    return float(math.sqrt((errors**2).sum(axis=-1).mean()))


def worst_and_mean(values: Sequence[float]) -> str:
    """Of lengths in metres, as centimetres."""
    return f"{100.0 * max(values):.1f} ({100.0 * float(np.mean(values)):.1f})"


def stations(repeats: int) -> None:
    """Print how far off it is while it keeps its station."""
    print(f"\nstation keeping, {STATION:g} s from rest in a current of {FLOW:g} m/s from eight sides:")
    print("RMSE of the true position in cm, worst (mean); targets: 3 by the truth, 6 by the estimate;")
    print("what is believed, on the ground plane\n")
    heads = ("truth, 100 Hz", "truth, 50 Hz", "estimate, 100 Hz", "estimate, 50 Hz", "believed, 100 Hz")
    print("| vehicle | drag | " + " | ".join((*heads, "no disturbance", "PD as a force")) + " |")
    print("|---|" + "--:|" * 8)
    deaf = Autopilot(disturbance=0.0, yaw_disturbance=0.0)
    cases = [(name, factor) for name, vehicle in VEHICLES.items() for factor in drags(vehicle)]
    spot = np.array([0.0, 0.0, DEEP])
    for name, factor in track(cases, description="on station", transient=True, console=BAR):
        vehicle = VEHICLES[name]
        row: list[str] = []

        def by(autopilot: Autopilot | None, every: int) -> list[float]:
            return [
                rms(
                    by_truth(
                        (*spot, 0.0),
                        STATION,
                        vehicle=vehicle,  # noqa: B023
                        factor=factor,  # noqa: B023
                        autopilot=autopilot,
                        bearing=bearing,
                        every=every,
                    )[0][:, 1:4]
                    - spot
                )
                for bearing in BEARINGS
            ]

        row += [worst_and_mean(by(None, 1)), worst_and_mean(by(None, 2))]
        motion = Motion(vehicle=vehicle, spread=dragging(factor))
        held: dict[int, list[float]] = {1: [], 2: []}
        believed = []
        for every, true in held.items():
            for bearing in BEARINGS:
                for start in starts(repeats):
                    robot = launched(start, motion, current=water(bearing), every=every)
                    z = float(robot.truth.translation[2])
                    rows = swum(robot, start, STATION, stay=math.inf)
                    at = np.array([start.x, start.y, z])
                    true.append(rms(rows[:, 1:4] - at))
                    if every == 1:
                        believed.append(rms(rows[:, 5:7] - at[:2]))
        row += [worst_and_mean(held[1]), worst_and_mean(held[2]), worst_and_mean(believed)]
        row.append(worst_and_mean(by(deaf, 1)))
        if name == "Heavy":
            pd = [by_pd((*spot, 0.0), STATION, factor=factor, bearing=bearing) for bearing in BEARINGS]
            row.append(worst_and_mean([rms(rows[:, 1:4] - spot) for rows in pd]))
        else:
            row.append("")
        print(f"| {name} | × {factor:g} | " + " | ".join(row) + " |")


# ---- moves ----


@dataclass(frozen=True)
class Move:
    """A move from rest, and how it is judged."""

    name: str
    forward: float = 0.0
    turn: float = 0.0
    """Radians."""

    @property
    def goal(self) -> Goal:
        """From the origin."""
        return self.forward, 0.0, DEEP, self.turn

    @property
    def tolerance(self) -> float:
        """Metres or radians."""
        return math.radians(2.0) if self.turn else 0.02

    def judged(self, errors: Array) -> tuple[float, float]:
        """How far it goes beyond, and seconds until it stays near, by what is left to go (B, 4)."""
        left = np.array([wrap_angle(e) for e in errors[:, 3]]) if self.turn else errors[:, 0]
        if self.turn:
            # Half a turn goes either way round.
            left = left[int(np.argmax(np.abs(left) < 0.5 * math.pi)) :]
            left = left if left[0] > 0.0 else -left
        size = np.abs(np.vectorize(wrap_angle)(errors[:, 3])) if self.turn else np.hypot(*errors[:, :2].T)
        outside = np.flatnonzero(size > self.tolerance)
        return max(0.0, float(-left.min())), BEAT * (1 + int(outside[-1])) if len(outside) else 0.0

    def said(self, judged: Sequence[tuple[float, float]]) -> str:
        """The worst of several, in cm or degrees, and in seconds."""
        beyond, settled = np.max(judged, axis=0)
        took = f"{settled:.1f} s" if settled < SETTLE - BEAT else "never"
        return f"{math.degrees(beyond):.1f}°, {took}" if self.turn else f"{100.0 * beyond:.1f} cm, {took}"


MOVES = (
    Move("0.1 m", forward=0.1),
    Move("2 m", forward=2.0),
    Move("30°", turn=math.radians(30.0)),
    Move("90°", turn=math.radians(90.0)),
    Move("180°", turn=math.pi - 1e-6),
)
SWIMMERS = {
    "Heavy": Motion(),
    "six thrusters": Motion(vehicle=BLUEROV2),
}
SETTLE = 15.0
"""Seconds that a move is watched for."""


def left_to_go(rows: Array, goal: Array, start_yaw: float) -> Array:
    """(B, 4) what is left, in the axes of the start."""
    c, s = math.cos(start_yaw), math.sin(start_yaw)
    gap = goal - rows
    return np.column_stack([c * gap[:, 0] + s * gap[:, 1], -s * gap[:, 0] + c * gap[:, 1], gap[:, 2:]])


def after_waiting(move: Move, factor: float, bearing: float, pilot: Autopilot) -> Array:
    """(B, 4) true poses of a Heavy on a move, from where it has kept its station in a current for 10 s."""
    waits = round(10.0 / BEAT)
    rows, _ = by_truth(
        [(0.0, 0.0, DEEP, 0.0), move.goal],
        10.0 + SETTLE,
        vehicle=BLUEROV2_HEAVY,
        factor=factor,
        autopilot=pilot,
        bearing=bearing,
        waits=waits,
    )
    return rows[waits:, TRUTH]


def moves(repeats: int) -> None:
    """Print overshoot and time to settle."""
    found: dict[str, list[str]] = {}

    def add(name: str, move: Move, ways: Sequence[Array]) -> None:
        judged = [move.judged(left_to_go(way, np.array(move.goal), 0.0)) for way in ways]
        found.setdefault(name, []).append(move.said(judged))

    fixed = Autopilot(drag_learning=0.0)
    for move in track(MOVES, description="moving", transient=True, console=BAR):

        def ways(vehicle: Vehicle, **options: Any) -> list[Array]:
            return [
                by_truth(move.goal, SETTLE, vehicle=vehicle, factor=factor, **options)[0][:, TRUTH]  # noqa: B023
                for factor in drags(vehicle)
            ]

        add("reference", move, [by_truth(move.goal, SETTLE, vehicle=BLUEROV2_HEAVY)[1]])
        add("Heavy", move, ways(BLUEROV2_HEAVY))
        add("six thrusters", move, ways(BLUEROV2))
        add("Heavy, commands at 50 Hz", move, ways(BLUEROV2_HEAVY, every=2))
        add("Heavy, drag not learnt", move, ways(BLUEROV2_HEAVY, autopilot=fixed))
        pd = [by_pd(move.goal, SETTLE, factor=factor)[:, TRUTH] for factor in drags(BLUEROV2_HEAVY)]
        add("Heavy, the paper's PD as a force", move, [np.repeat(way, 2, axis=0) for way in pd])
        for name, pilot in (("Heavy in the current", Autopilot()), ("so, drag not learnt", fixed)):
            waited = [
                after_waiting(move, factor, b, pilot) for factor in drags(BLUEROV2_HEAVY) for b in BEARINGS
            ]
            add(name, move, waited)
        for name, motion in SWIMMERS.items():
            true, believed = [], []
            for k, start in enumerate(starts(repeats)):
                robot = launched(start, motion, current=water(BEARINGS[k % len(BEARINGS)]))
                # It has come to rest, and knows the height of the ground.
                swum(robot, start, 10.0, stay=math.inf)
                end = ahead(start, move.forward, 0.0, move.turn)
                rows = swum(robot, end, SETTLE, stay=math.inf)
                goal = np.array([end.x, end.y, 0.0, end.yaw])
                true.append(move.judged(left_to_go(rows[:, TRUTH], goal, start.yaw)))
                believed.append(move.judged(left_to_go(rows[:, BELIEF], goal, start.yaw)))
            found.setdefault(f"{name} by the estimate: truth", []).append(move.said(true))
            found.setdefault(f"{name} by the estimate: belief", []).append(move.said(believed))

    print("\nmoves from rest: overshoot, and seconds until within 2 cm or 2° for good, on the ground plane;")
    print(
        "worst of three drags in still water; of them and eight sides of the current, after 10 s in it; or of"
    )
    print(f"{repeats} launches in the current, with vehicle and sensors as they are drawn.")
    print("targets: 1 cm or 2°, and 3 s for a step of 0.1 m and turns up to 90°\n")
    print("| | " + " | ".join(move.name for move in MOVES) + " |")
    print("|---|" + "--:|" * len(MOVES))
    for name, said in found.items():
        print(f"| {name} | " + " | ".join(said) + " |")


# ---- drift ----


@dataclass(frozen=True)
class Survey:
    """A way of moves of two metres and quarter turns, by the axes of its start."""

    name: str
    lanes: int
    moves: int
    """Of each lane."""

    @property
    def length(self) -> float:
        """Metres."""
        return 2.0 * (self.lanes * self.moves + self.lanes - 1)

    def poses(self, start: SE2) -> Iterator[SE2]:
        """Where it is sent, one after another."""
        pose, side = start, 1.0
        for lane in range(self.lanes):
            for _ in range(self.moves):
                yield (pose := ahead(pose, 2.0, 0.0, 0.0))
            if lane < self.lanes - 1:
                yield (pose := ahead(pose, 0.0, 0.0, side * 0.5 * math.pi))
                yield (pose := ahead(pose, 2.0, 0.0, 0.0))
                yield (pose := ahead(pose, 0.0, 0.0, side * 0.5 * math.pi))
                side = -side

    def start(self, middle: SE2) -> SE2:
        """From where it has its middle there."""
        return PROTOCOL.snap(ahead(middle, -self.moves, -(self.lanes - 1), 0.0))


LAWNMOWER = Survey("lawnmower", lanes=9, moves=10)
STRAIGHT = Survey("straight", lanes=1, moves=15)
EXACT_COMPASS = replace(AHRS, offset=0.0, iron=0.0, wander=0.0)
"""Noise is left: the filter takes its weight from it."""


@dataclass(frozen=True)
class Drifted:
    """One survey."""

    rows: Array
    distance: Array
    """(B,) metres of the true way on the ground plane until then."""
    sigma: Array
    """(M, 2) the same metres and the filter's standard deviation of the position, after each move: of its
    less certain horizontal axis."""

    @property
    def error(self) -> Array:
        """(B,) horizontal metres between belief and truth."""
        return np.asarray(np.hypot(*(self.rows[:, 5:7] - self.rows[:, 1:3]).T))


def surveyed(survey: Survey, middle: SE2, motion: Motion) -> Drifted:
    """A survey that has its middle there."""
    start = survey.start(middle)
    robot, parts, sigma = launched(start, motion), [], []
    for pose in survey.poses(start):
        parts.append(swum(robot, pose, 60.0))
        sigma.append((sum(map(len, parts)) - 1, _kernels.position_sigma(robot._state)))
    rows = np.concatenate(parts)
    steps = np.hypot(*np.diff(rows[:, 1:3], axis=0).T)
    distance = np.concatenate([[0.0], np.cumsum(steps)])
    return Drifted(rows, distance, np.array([(distance[k], s) for k, s in sigma]))


def drifts(count: int) -> None:
    """Print how far belief and truth come apart."""
    performance = Motion(dvl=DVL_A50_PERFORMANCE)
    cases: list[tuple[str, Survey, Motion]] = [
        ("DVL A50 (± 1 % of scale)", LAWNMOWER, Motion()),
        ("DVL A50 performance (± 0.1 %)", LAWNMOWER, performance),
        ("DVL A50, compass without errors", LAWNMOWER, Motion(compass=EXACT_COMPASS)),
        (
            "DVL A50 performance, compass without errors",
            LAWNMOWER,
            replace(performance, compass=EXACT_COMPASS),
        ),
        ("DVL A50, six thrusters", LAWNMOWER, SWIMMERS["six thrusters"]),
        ("DVL A50, straight", STRAIGHT, Motion()),
        ("DVL A50 performance, straight", STRAIGHT, performance),
    ]  # fmt: skip
    print(f"\ndrift of the whole vehicle: horizontal error in percent of the way, {count} launches;")
    print("targets on the lawnmower: 1.2 % with the DVL A50, 0.5 % with its performance version\n")
    print("| | way | end, mean | end, worst | RMSE, mean | RMSE, worst | yaw RMSE | end within 2 sigma |")
    print("|---|" + "--:|" * 7)
    for name, survey, motion in track(cases, description="surveying", transient=True, console=BAR):
        ends, rmse, yaws, within = [], [], [], []
        for middle in starts(count):
            flown = surveyed(survey, middle, motion)
            error, way = flown.error, survey.length
            ends.append(100.0 * error[-1] / way)
            rmse.append(100.0 * math.sqrt(np.mean(error**2)) / way)
            yaws += [wrap_angle(a - b) ** 2 for a, b in flown.rows[::50, [4, 8]]]
            within.append(error[-1] <= 2.0 * flown.sigma[-1, 1])
        print(
            f"| {name} | {survey.length:g} m | {np.mean(ends):.2f} | {max(ends):.2f} | {np.mean(rmse):.2f} | "
            f"{max(rmse):.2f} | {math.degrees(math.sqrt(np.mean(yaws))):.2f}° | {np.mean(within):.0%} |"
        )


# ---- speed ----


def least(call: Callable[[], float], rounds: int) -> float:
    """Simulated seconds in one of CPU time, the most of the rounds."""
    found = []
    for _ in range(rounds):
        begun = time.process_time()
        simulated = call()
        found.append(simulated / (time.process_time() - begun))
    return max(found)


def speed(rounds: int) -> None:
    """Print how many times as fast as the clock the loop runs."""
    world, solids, _ = place()
    start = SE2(0.0, 0.0, 0.0)
    robot, turn = launched(start, Motion()), 0.0
    slow = Slow(world, PROTOCOL, start, Motion(), solids)

    def moved() -> float:
        nonlocal turn
        before = robot._voyage.clock[_kernels.TIME]
        for x, y in ((2.0, 0.0), (2.0, 2.0), (0.0, 2.0), (0.0, 0.0)) * 3:
            turn = wrap_angle(turn + 0.5 * math.pi)
            robot.go_to(Setpoint(x, y, turn, PROTOCOL.altitude))
        return float(robot._voyage.clock[_kernels.TIME] - before)

    def beaten() -> float:
        for _ in range(300):
            slow.beat(SE2(2.0, 0.0, 0.5 * math.pi))
        return 300 * BEAT

    moved()
    beaten()
    fast, plain = least(moved, rounds), least(beaten, rounds)
    print("\nspeed of the whole loop at 100 Hz: water, contact, sensors, filter, health, autopilot\n")
    print("| | × real time | µs a beat |")
    print("|---|--:|--:|")
    print(f"| one compiled loop | {fast:,.0f} | {1e6 * BEAT / fast:.1f} |")
    print(f"| the same beats from Python objects | {plain:.0f} | {1e6 * BEAT / plain:.0f} |")
    print(f"| ratio | {fast / plain:.0f} | |")


# ---- pictures ----


def tracking() -> Picture:
    """A step, a turn and a station: what the paper's law does as a force, and what the autopilot does."""
    step: Goal = (0.1, 0.0, DEEP, 0.0)
    turn: Goal = (0.0, 0.0, DEEP, 0.5 * math.pi)
    spot: Goal = (0.0, 0.0, DEEP, 0.0)
    deaf = Autopilot(disturbance=0.0, yaw_disturbance=0.0)

    def off(rows: Array) -> Array:
        return np.asarray(100.0 * np.linalg.norm(rows[:, 1:4] - spot[:3], axis=1))

    stepped, to_step = by_truth(step, 8.0, vehicle=BLUEROV2_HEAVY)
    turned, to_turn = by_truth(turn, 8.0, vehicle=BLUEROV2_HEAVY)
    held, _ = by_truth(spot, 30.0, vehicle=BLUEROV2_HEAVY, bearing=0.0)
    unheld, _ = by_truth(spot, 30.0, vehicle=BLUEROV2_HEAVY, bearing=0.0, autopilot=deaf)
    pd_step, pd_turn = by_pd(step, 8.0), by_pd(turn, 8.0)
    pd_held = by_pd(spot, 30.0, bearing=0.0)

    def draw(theme: Theme) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.6, 3.5), layout="constrained", facecolor=theme.ground)
        left, middle, right = figure.subplots(1, 3)
        ours, pd = {"color": theme.tracks[0]}, {"color": theme.tracks[1]}
        aim: dict[str, Any] = {"color": theme.soft, "linewidth": 1.1, "linestyle": (0, (3, 2))}
        left.plot(pd_step[:, 0], 100.0 * pd_step[:, 1], label="the paper's PD, as a force", **pd)
        left.plot(stepped[:, 0], 100.0 * stepped[:, 1], label="autopilot", **ours)
        left.plot(stepped[:, 0], 100.0 * to_step[:, 0], label="its reference", **aim)
        left.set_title("A step of 10 cm")
        left.set(xlabel="s", ylabel="cm", xlim=(0, 8), ylim=(0, None))
        middle.plot(pd_turn[:, 0], np.degrees(np.unwrap(pd_turn[:, 4])), **pd)
        middle.plot(turned[:, 0], np.degrees(turned[:, 4]), **ours)
        middle.plot(turned[:, 0], np.degrees(to_turn[:, 3]), **aim)
        middle.set_title("A quarter turn")
        middle.set(xlabel="s", ylabel="degrees", xlim=(0, 8), ylim=(0, None))
        right.plot(pd_held[:, 0], off(pd_held), **pd)
        right.plot(
            unheld[:, 0],
            off(unheld),
            color=theme.tracks[2],
            linewidth=1.3,
            label="autopilot that learns no push",
        )
        right.plot(held[:, 0], off(held), **ours)
        right.set_title(f"Off its station, current {FLOW:g} m/s")
        right.set(xlabel="s", ylabel="cm", xlim=(0, 30), ylim=(0, None))
        named = [axes.get_legend_handles_labels() for axes in (left, right)]
        figure.legend(
            [handle for handles, _ in named for handle in handles],
            [name for _, names in named for name in names],
            loc="outside lower center",
            ncols=4,
            handlelength=2.2,
        )
        return figure

    return Picture("navigation-tracking", "Tracking", "", draw)


def drifting(count: int) -> Picture:
    """One survey from above, true and believed, and the errors of many over their way."""
    middles = list(starts(count))
    flown = [
        surveyed(LAWNMOWER, middle, Motion())
        for middle in track(middles, description="surveying", transient=True, console=BAR)
    ]
    # The one in the middle of all, by where it ended.
    shown = sorted(range(count), key=lambda k: float(flown[k].error[-1]))[count // 2]
    one, start = flown[shown], LAWNMOWER.start(middles[shown])

    def local(xy: Array) -> Array:
        c, s = math.cos(start.yaw), math.sin(start.yaw)
        return np.asarray((xy - [start.x, start.y]) @ np.array([[c, -s], [s, c]]))

    def draw(theme: Theme) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(9.6, 4.3), layout="constrained", facecolor=theme.ground)
        left, right = figure.subplots(1, 2)
        true, believed = local(one.rows[::20, 1:3]), local(one.rows[::20, 5:7])
        left.plot(*believed.T, color=theme.tracks[1], linewidth=1.4, label="where it believes to be")
        left.plot(*true.T, color=theme.tracks[0], linewidth=1.4, label="where it is")
        left.plot(*true[0], "o", color=theme.ink, markersize=4.5)
        left.plot(*believed[-1], "o", color=theme.tracks[1], markersize=4.5)
        left.plot(*true[-1], "o", color=theme.tracks[0], markersize=4.5)
        left.set_aspect("equal")
        left.set_title(f"A survey of {LAWNMOWER.length:g} m, from above")
        left.set(xlabel="m", ylabel="m", xticks=range(0, 21, 5), yticks=range(0, 17, 4))
        for k, each in enumerate(flown):
            if k != shown:
                right.plot(
                    each.distance[::200], each.error[::200], color=theme.soft, linewidth=0.7, alpha=0.45,
                    label=f"{count - 1} other launches" if k == (shown == 0) else None,
                )  # fmt: skip
        right.plot(one.distance[::20], one.error[::20], color=theme.tracks[1], label="its error")
        right.plot(
            one.sigma[:, 0],
            2.0 * one.sigma[:, 1],
            color=theme.tracks[2],
            linewidth=1.3,
            linestyle=(0, (3, 2)),
            label="the filter's own 2 sigma",
        )
        right.set_title("Horizontal error over the way")
        right.set(xlabel="m of way", ylabel="m", xlim=(0, None), ylim=(0, None))
        named = [axes.get_legend_handles_labels() for axes in (left, right)]
        figure.legend(
            [handle for handles, _ in named for handle in handles],
            [name for _, names in named for name in names],
            loc="outside lower center",
            ncols=5,
            handlelength=2.2,
        )
        return figure

    return Picture("navigation-drift", "Drift", "", draw)


def main() -> None:
    """Print the tables, or draw."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=["station", "moves", "drift", "speed"], help="one of the tables")
    parser.add_argument("--starts", type=int, default=20, help="launches of each survey")
    parser.add_argument("--repeats", type=int, default=2, help="launches for each bearing of the current")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--figure", type=Path, help="folder to draw into, instead of the tables")
    arguments: Any = parser.parse_args()
    if arguments.figure is not None:
        for picture in (tracking(), drifting(arguments.starts)):
            path = arguments.figure / f"{picture.name}.svg"
            path.write_bytes(picture.svg())
            print(path)
        return
    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, {os.cpu_count()} CPUs")
    tables: dict[str, Callable[[], None]] = {
        "station": lambda: stations(arguments.repeats),
        "moves": lambda: moves(8 * arguments.repeats),
        "drift": lambda: drifts(arguments.starts),
        "speed": lambda: speed(arguments.rounds),
    }
    for name, table in tables.items():
        if arguments.only in (None, name):
            table()


if __name__ == "__main__":
    main()
