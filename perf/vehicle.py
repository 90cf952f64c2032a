"""What the swimming vehicle does and costs: terminal speeds, and microseconds a step beside plain NumPy.

    python perf/vehicle.py          or: python perf/vehicle.py --world reef/string --rate 200

Costs are of one compiled loop on one core, each row with all that the rows above it do; in the last one the
vehicle is pressed to the ground and drifts against what stands there. Each takes the least of its rounds,
since other programs only ever add time. The peer is the same step written with the book's 6 × 6 matrices in
NumPy, to which the tests hold the compiled one.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from numba import njit  # noqa: E402
from tests.sim.vehicle import fossen  # noqa: E402

from dream.geometry import SE3  # noqa: E402
from dream.protocol import DREAM_V1  # noqa: E402
from dream.sim.sensors import AHRS, BAR30, DVL_A50, ICM_20602  # noqa: E402
from dream.sim.sensors._kernels import heading, inertial, ping, pressure  # noqa: E402
from dream.sim.solids import Solids  # noqa: E402
from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY, Current, Spread, Tether, Vehicle  # noqa: E402
from dream.sim.vehicle._kernels import advance, hold, stir  # noqa: E402
from dream.sim.worlds import make_world  # noqa: E402

Array = npt.NDArray[np.float64]
MADE = (
    "vehicle",
    "+ tether and gusts",
    "+ inertial unit",
    "+ contact",
    "+ pressure, compass 10 Hz",
    "+ Doppler log 15 Hz",
    "all of it, in contact",
)
"""Rows of the table of costs."""


@njit(cache=False, nogil=True)
def fly(upto, body, flow, unit, log, gauge, compass, index, size, x, commands, dt, steps, rng):  # type: ignore[no-untyped-def]
    """Steps with as much of the rest as `upto` says; each second turns, every ten seconds begin anew."""
    gust, pull, contact = np.zeros(2), np.zeros(3), np.zeros(3)
    bias, sample, zero, error = np.zeros(6), np.empty(6), np.zeros(2), np.zeros(4)
    velocity, covariance, ranges = np.empty(3), np.empty((3, 3)), np.empty(4)
    before, first = x.copy(), x.copy()
    slow, fast = max(round(0.1 / dt), 1), max(round(1.0 / 15.0 / dt), 1)
    second = round(1.0 / dt)
    sign = np.empty(len(commands))
    for i in range(steps):
        if upto < 6 and i % (10 * second) == 0:
            x[:] = first
        before[:] = x
        sign[:] = commands if (i // second) % 2 == 0 else -commands
        if upto >= 1:
            stir(flow, dt, rng, gust)
        advance(body, flow, gust, pull, sign, dt, x)
        if upto >= 3:
            hold(body, index, size[0], size[1], before, x, contact)
        if upto >= 2:
            inertial(unit, before, x, dt, bias, rng, sample)
        if upto >= 4 and i % slow == 0:
            pressure(gauge, x, 0.1, zero, rng)
            heading(compass, x, 0.1, error, rng)
        if upto >= 5 and i % fast == 0:
            ping(log, index, x, 0.0, rng, velocity, covariance, ranges)


def least(call: Callable[[], object], rounds: int) -> float:
    """CPU seconds, the least of the rounds."""
    taken = []
    for _ in range(rounds):
        start = time.process_time()
        call()
        taken.append(time.process_time() - start)
    return min(taken)


def costs(world: str, seed: int, rate: float, steps: int, rounds: int) -> None:
    """Print a row for each part of the loop, and one for the peer."""
    place = make_world(world, seed)
    solids = Solids(place)
    start = place.starts[0]
    z = float(place.terrain.height(start.x, start.y)) + DREAM_V1.altitude
    vehicle = BLUEROV2_HEAVY
    x0 = vehicle.at_rest(SE3.level(start.x, start.y, z, start.yaw)).vector
    commands = np.array([0.2, 0.2, -0.2, -0.2, 0.0, 0.0, 0.0, 0.0])
    water = Current((0.05, 0.0, 0.0), gust=0.05)
    dt = 1.0 / rate
    size = np.array([DREAM_V1.body_radius, DREAM_V1.body_height])
    constants = (ICM_20602.constants, DVL_A50.constants, BAR30.constants, AHRS.constants, solids.index, size)

    def flight(upto: int, count: int) -> None:
        light = -20.0 if upto == 6 else 0.0
        hull = replace(BLUEROV2_HEAVY.hull, net_buoyancy=light)
        body = Vehicle(hull, vehicle.thrusters, Tether() if upto >= 1 else None).body
        fly(
            upto, body, water.flow, *constants, x0.copy(), commands, dt, count, np.random.default_rng(seed)
        )  # fmt: skip

    def plain(count: int) -> None:
        x = x0
        for _ in range(count):
            x = fossen.step(vehicle, x, commands, dt, water)

    print(f"\ncost in {world}, seed {seed}, {rate:g} steps a second, {DREAM_V1.altitude:g} m above ground")
    print(f"{'':28} {'us/step':>9} {'x real time':>12} {'peer / ours':>12}")
    few = max(steps // 500, 20)
    slow = least(lambda: plain(few), rounds) / few
    flight(0, 1)
    for upto, name in enumerate(MADE):
        taken = least(lambda: flight(upto, steps), rounds) / steps  # noqa: B023
        print(f"{name:28} {taken * 1e6:>9.2f} {dt / taken:>12,.0f} {slow / taken:>12,.0f}")
    print(f"{'NumPy, vehicle alone':28} {slow * 1e6:>9.1f} {dt / slow:>12,.1f} {1:>12}")


def terminal(vehicle: Vehicle, axis: int, force: float) -> float:
    """Speed along an axis after 5 s from rest, held to it, with a force or moment that does not lag."""
    hull = replace(vehicle.hull, net_buoyancy=0.0, centre_of_buoyancy=(0.0, 0.0, 0.0))
    vehicle = replace(vehicle, hull=hull, thrusters=replace(vehicle.thrusters, lag=1e9))
    wrench, only = np.zeros(6), np.zeros(6)
    wrench[axis], only[axis] = force, 1.0
    thrust = np.linalg.pinv(vehicle.thrusters.allocation) @ wrench
    start = replace(vehicle.at_rest(SE3.level(0.0, 0.0, -20.0, 0.0)), thrust=thrust)
    speed = np.zeros(6)
    for _ in range(2500):
        state = replace(start, velocity=speed[:3], angular_velocity=speed[3:])
        speed = only * vehicle.step(state, np.zeros(len(thrust)), 0.002).vector[7:13]
    return float(speed[axis])


def speeds() -> None:
    """Print terminal speeds beside their closed form."""
    rows: list[tuple[str, str, Vehicle, int, float]] = []
    for vehicle in (BLUEROV2, BLUEROV2_HEAVY):
        name = vehicle.hull.name
        rows += [(name, "ahead, 129 N", vehicle, 0, 129.0), (name, "sideways, 60 N", vehicle, 1, 60.0)]
        rows += [(name, "up, 80 N", vehicle, 2, 80.0), (name, "turning, 10 N m", vehicle, 5, 10.0)]
    least_drag = Spread(damping=(0.15, 0.15)).draw(BLUEROV2_HEAVY, np.random.default_rng(0))
    rows.append(("Heavy, 0.15 of its drag", "ahead, 129 N", least_drag, 0, 129.0))
    print(f"\nterminal speeds\n{'':24} {'':16} {'found':>8} {'closed form':>12}")
    for name, what, vehicle, axis, force in rows:
        d, q = vehicle.hull.linear[axis], vehicle.hull.quadratic[axis]
        closed = (-d + math.sqrt(d * d + 4.0 * q * force)) / (2.0 * q)
        unit = "m/s" if axis < 3 else "rad/s"
        print(f"{name:24} {what:16} {terminal(vehicle, axis, force):>8.3f} {closed:>12.3f} {unit}")


def main() -> None:
    """Print one table for speeds, one for costs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--world", default="wreck/1")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rate", type=float, default=100.0, help="steps a second")
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--rounds", type=int, default=3)
    arguments: Any = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, {os.cpu_count()} CPUs")
    speeds()
    costs(arguments.world, arguments.seed, arguments.rate, arguments.steps, arguments.rounds)


if __name__ == "__main__":
    main()
