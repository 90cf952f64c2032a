"""What the estimators cost, how near they get, and how well they know how near.

    python perf/estimation.py                     all three tables
    python perf/estimation.py --seeds 3 --only accuracy

Cost: calls from compiled code, CPU time, least of the rounds, beside the same equations in plain NumPy in the
same run. Accuracy: survey-like flights of two minutes with the noise that the filters are told of, over
drop-outs of the DVL, gyro bias, trouble with the heading, and swings of the yaw. Consistency: share of
instants at which the mean over seeds of the normalised error squared lies in its 95 % band; 95 % is best.

All begin at the same wrong pose. `Cipg*` is `Cipg` with roll and pitch from an attitude reference that errs
by 0.3 degrees; `Cipg` has to find them itself.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import platform
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402
import numpy.typing as npt  # noqa: E402
from numba import njit  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import track  # noqa: E402
from scipy.spatial.transform import Rotation  # noqa: E402
from scipy.stats import chi2  # noqa: E402
from tests.estimation import textbook  # noqa: E402
from tests.estimation.flights import DVL, PRESSURE, Flight, Log, Sensors, sense, survey  # noqa: E402

from dream.estimation import Cipg, DeadReckoning, Ekf, InEkf, Mounting, Start  # noqa: E402
from dream.estimation._kernels import cipg, dead_reckoning, ekf, inekf  # noqa: E402
from dream.estimation._kernels.groups import apply, rotation_from  # noqa: E402
from dream.geometry import SE3  # noqa: E402
from dream.measurements import Depth, Dvl, Heading  # noqa: E402

Array = npt.NDArray[Any]

BAR = Console(stderr=True)
MOUNTING = Mounting(DVL, PRESSURE)
START = Start(tilt=math.radians(2.0), yaw=math.radians(2.0), velocity=0.05)
DURATION = 120.0
"""Seconds of a flight."""
EVERY = 100
"""Samples between two looks at the error."""


class Said(NamedTuple):
    """What the sensors said on a flight, ready for the loops."""

    rates: Array
    forces: Array
    dt: float
    between: int
    """Inertial samples from report to report."""
    flows: Array
    locks: Array
    covariance: Array
    heights: Array
    sigma_z: float
    yaws: Array
    sigma_yaw: float
    references: Array
    """(reports, 3, 3) what an attitude reference would say."""


@njit(cache=False)
def pose_of_inekf(s):  # type: ignore[no-untyped-def]
    """Rotation, velocity, position, gyro bias, accelerometer bias, covariance."""
    return s.rotation, s.velocity, s.position, s.gyro_bias, s.accelerometer_bias, s.covariance


@njit(cache=False)
def pose_of_ekf(s):  # type: ignore[no-untyped-def]
    """The same."""
    rotation = rotation_from(s.wxyz)
    return rotation, s.velocity, s.position, s.gyro_bias, s.accelerometer_bias, s.covariance


@njit(cache=False)
def pose_of_cipg(s):  # type: ignore[no-untyped-def]
    """The same; there are no biases and no covariance."""
    return s.rotation, s.velocity, s.position, np.zeros(3), np.zeros(3), np.zeros((15, 15))


@njit(cache=False)
def pose_of_dead_reckoning(s):  # type: ignore[no-untyped-def]
    """The same."""
    velocity = apply(s.rotation, s.own_velocity)
    return s.rotation, velocity, s.position, np.zeros(3), np.zeros(3), np.zeros((15, 15))


@njit(cache=False)
def as_it_is(s, reference):  # type: ignore[no-untyped-def]
    """An estimator that asks no attitude reference."""
    return s


@njit(cache=False)
def with_reference(s, reference):  # type: ignore[no-untyped-def]
    """The observer, with roll and pitch of an attitude reference."""
    return cipg.State(
        s.time, s.rotation, s.velocity, s.position, s.gyro, reference, s.turn, s.push, s.span, s.window,
        s.estimate,
    )  # fmt: skip


def compiled_flight(kernels: Any, pose_of: Any, prepared: Any) -> Callable[..., Any]:
    """A loop over a whole flight in which nothing but compiled code is called."""
    predict, correct_dvl = kernels.predict, kernels.correct_dvl
    correct_depth, correct_heading = kernels.correct_depth, kernels.correct_heading

    @njit(cache=False)
    def fly(q, s, m):  # type: ignore[no-untyped-def]
        looks = len(m.rates) // EVERY
        rotations, vectors = np.empty((looks, 3, 3)), np.empty((looks, 4, 3))
        covariances = np.empty((looks, 15, 15))
        for k in range(len(m.rates)):
            s = predict(q, s, m.rates[k], m.forces[k], m.dt)
            if (k + 1) % m.between == 0:
                i = (k + 1) // m.between - 1
                if m.locks[i]:
                    s, _, _ = correct_dvl(q, s, m.flows[i], m.covariance)
                s, _, _ = correct_depth(q, s, m.heights[i], m.sigma_z)
                s = prepared(s, m.references[i])
                s, _, _ = correct_heading(q, s, m.yaws[i], m.sigma_yaw)
            if (k + 1) % EVERY == 0:
                j = (k + 1) // EVERY - 1
                rotations[j], vectors[j, 0], vectors[j, 1], vectors[j, 2], vectors[j, 3], covariances[j] = (
                    pose_of(s)
                )
        return rotations, vectors, covariances

    return fly


@dataclass(frozen=True)
class Contender:
    """An estimator and its compiled loop."""

    name: str
    estimator: Any
    kernels: Any
    fly: Callable[..., Any]

    def begin(self, time: float, pose: SE3, velocity: Array) -> Any:
        """The compiled state at the start."""
        state = self.estimator.begin(time, pose, velocity)
        return self.kernels.State(*(getattr(state, name) for name in self.kernels.State._fields))


def contenders(start: Start) -> list[Contender]:
    """All of them, each with the same mounting and start."""
    inekf_, ekf_ = InEkf(mounting=MOUNTING, start=start), Ekf(mounting=MOUNTING, start=start)
    observer = Cipg(mounting=MOUNTING)
    return [
        Contender("InEkf", inekf_, inekf, compiled_flight(inekf, pose_of_inekf, as_it_is)),
        Contender("Ekf", ekf_, ekf, compiled_flight(ekf, pose_of_ekf, as_it_is)),
        Contender("Cipg", observer, cipg, compiled_flight(cipg, pose_of_cipg, as_it_is)),
        Contender("Cipg*", observer, cipg, compiled_flight(cipg, pose_of_cipg, with_reference)),
        Contender(
            "DeadReckoning",
            DeadReckoning(mounting=MOUNTING),
            dead_reckoning,
            compiled_flight(dead_reckoning, pose_of_dead_reckoning, as_it_is),
        ),
    ]


@dataclass(frozen=True)
class Result:
    """Errors of one flight, look by look."""

    across: Array
    """(looks,) metres on the ground plane."""
    yaw: Array
    """(looks,) radians."""
    speed: Array
    """(looks,) m/s."""
    squared: Array
    """(looks,) normalised; NaN without a covariance."""


def wrong_start(flight: Flight, start: Start, rng: np.random.Generator) -> tuple[SE3, Array]:
    """A pose and a velocity that err as the start says."""
    eta = rng.standard_normal(9) * np.repeat([start.tilt, start.velocity, start.position], 3)
    eta[2] *= start.yaw / start.tilt
    X = textbook.extended(flight.rotations[0], flight.velocities[0], flight.positions[0])
    X = X @ textbook.group(-eta)
    return SE3(X[:3, :3], X[:3, 4]), X[:3, 3]


def flown(
    contender: Contender, flight: Flight, log: Log, sensors: Sensors, seed: int, start: Start
) -> Result:
    """One flight of one estimator."""
    rng = np.random.default_rng([seed, 1])
    pose, velocity = wrong_start(flight, start, rng)
    between = sensors.dvl_every
    said = [log.after[k] for k in sorted(log.after)]
    dvls = [m for messages in said for m in messages if isinstance(m, Dvl)]
    heights = np.array([m.z for messages in said for m in messages if isinstance(m, Depth)])
    headings = [m for messages in said for m in messages if isinstance(m, Heading)]
    tilts = Rotation.from_rotvec(math.radians(0.3) * rng.standard_normal((len(said), 3))).as_matrix()
    references = flight.rotations[between::between] @ tilts
    reports = Said(
        rates=np.array([imu.angular_velocity for imu in log.imu]),
        forces=np.array([imu.specific_force for imu in log.imu]),
        dt=flight.dt,
        between=between,
        flows=np.array([dvl.velocity for dvl in dvls]),
        locks=np.array([dvl.valid for dvl in dvls]),
        covariance=dvls[0].covariance,
        heights=heights,
        sigma_z=sensors.depth_sigma,
        yaws=np.array([heading.yaw for heading in headings]),
        sigma_yaw=headings[0].sigma,
        references=np.ascontiguousarray(references),
    )
    begun = contender.begin(0.0, pose, velocity)
    rotations, vectors, covariances = contender.fly(contender.estimator.compiled, begun, reports)
    steps = np.arange(EVERY, flight.steps + 1, EVERY)
    truth = flight.rotations[steps]
    yaw = np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]) - np.arctan2(truth[:, 1, 0], truth[:, 0, 0])
    squared = np.full(len(steps), np.nan)
    if contender.kernels in (inekf, ekf):
        for j, k in enumerate(steps.tolist()):
            biases = log.gyro_biases[k], log.accelerometer_biases[k]
            error = error_of(contender.kernels, rotations[j], vectors[j], covariances[j], flight, k, biases)
            squared[j] = error @ np.linalg.solve(covariances[j], error)
    return Result(
        np.linalg.norm((vectors[:, 1] - flight.positions[steps])[:, :2], axis=1),
        (yaw + math.pi) % (2.0 * math.pi) - math.pi,
        np.linalg.norm(vectors[:, 0] - flight.velocities[steps], axis=1),
        squared,
    )


def error_of(
    kernels: Any,
    rotation: Array,
    vectors: Array,
    P: Array,
    flight: Flight,
    k: int,
    biases: tuple[Array, Array],
) -> Array:
    """The error (15,) in the coordinates of the covariance."""
    attitude = kernels.quaternion_from(rotation) if kernels is ekf else rotation.copy()
    moving, place, of_gyro, of_force = (v.copy() for v in vectors)
    none = np.zeros(3)
    state = kernels.State(0.0, attitude, moving, place, of_gyro, of_force, P, none, 0.0, 0.0, np.zeros(2))
    truth = (flight.rotations[k], flight.velocities[k], flight.positions[k], *biases)
    error: Array = kernels.error(state, *(np.ascontiguousarray(part) for part in truth))
    return error


def in_band(squared: Iterable[Array]) -> float:
    """Share of instants at which the mean over flights is in its 95 % band."""
    sums = np.array(list(squared))
    low, high = chi2.interval(0.95, 15 * len(sums))
    total = sums.sum(axis=0)
    return float(np.mean((total > low) & (total < high)))


LOST = (0.0, 1.0, 5.0, 10.0)
BIAS = {"no bias": 0.0, "bias 0.5°/s": math.radians(0.5)}
HEADING = {
    "heading 1°": Sensors(),
    "heading 5°": Sensors(heading_sigma=math.radians(5.0)),
    "iron 20° for 20 s": Sensors(heading_off=(40.0, 60.0, math.radians(20.0))),
}
MOTION = {"survey": False, "swinging": True}


def accuracy(seeds: int) -> None:
    """Print the grid, and how each of its factors tells."""
    flights = {name: survey(DURATION, aggressive=swings) for name, swings in MOTION.items()}
    entrants = contenders(START)
    grid = list(itertools.product(LOST, BIAS, HEADING, MOTION))
    drift: dict[tuple[Any, ...], dict[str, float]] = {}
    yaws: dict[tuple[Any, ...], dict[str, float]] = {}
    bands: dict[tuple[Any, ...], dict[str, float]] = {}
    for cell in track(grid, description="flying", transient=True, console=BAR):
        lost, bias, heading, motion = cell
        flight = flights[motion]
        unit = BIAS[bias] / math.sqrt(3.0)
        sensors = replace(HEADING[heading], gyro_bias=(unit, -unit, unit), dvl_lost=(60.0, 60.0 + lost))
        logs = [sense(flight, sensors, np.random.default_rng([seed, 0])) for seed in range(seeds)]
        results = {
            entrant.name: [flown(entrant, flight, log, sensors, seed, START) for seed, log in enumerate(logs)]
            for entrant in entrants
        }
        way = flight.distance
        drift[cell] = {
            name: 100.0 * float(np.mean([r.across[-1] for r in found])) / way
            for name, found in results.items()
        }
        yaws[cell] = {
            name: math.degrees(math.sqrt(np.mean([np.mean(r.yaw**2) for r in found])))
            for name, found in results.items()
        }
        bands[cell] = {name: in_band(r.squared for r in results[name]) for name in ("InEkf", "Ekf")}

    names = [entrant.name for entrant in entrants]
    print(f"\n{len(grid)} cases, {seeds} flights each of {DURATION:g} s; drift: horizontal error at the end,")
    print(
        "percent of the way, mean of the flights; in brackets RMSE of the yaw in degrees; then consistency\n"
    )
    print("| DVL lost | gyro | heading | motion | " + " | ".join(names) + " | InEkf | Ekf |")
    print("|" + "---|" * (4 + len(names) + 2))
    for cell in grid:
        lost, *rest = cell
        figures = [f"{drift[cell][name]:.2f} ({yaws[cell][name]:.1f})" for name in names]
        shares = [f"{bands[cell][name]:.0%}" for name in ("InEkf", "Ekf")]
        print(f"| {lost:g} s | " + " | ".join([*rest, *figures, *shares]) + " |")
    print("\nmedian drift in percent over all cases with, and how often it was the least\n")
    print("| cases with | " + " | ".join(names) + " |")
    print("|" + "---|" * (1 + len(names)))
    levels: dict[str, list[tuple[Any, ...]]] = {"all": grid}
    levels |= {f"DVL lost {lost:g} s": [cell for cell in grid if cell[0] == lost] for lost in LOST}
    levels |= {name: [cell for cell in grid if name in cell] for name in (*BIAS, *HEADING, *MOTION)}
    for label, chosen in levels.items():
        best = [min(drift[cell].items(), key=lambda found: found[1])[0] for cell in chosen]
        row = [f"{np.median([drift[c][n] for c in chosen]):.2f} ({best.count(n)})" for n in names]
        print(f"| {label} | " + " | ".join(row) + " |")


def consistency(seeds: int) -> None:
    """Print how sure the filters are, over many flights."""
    flight = survey(DURATION)
    print(f"\nconsistency: {seeds} flights of {DURATION:g} s; share of instants in the 95 % band, median")
    print("of the normalised error squared over 15 (1 is right), seconds until the yaw errs by less than 2°")
    print("for good; all axes of the attitude err by the start's sigma, so that 30° are 50° in all\n")
    print("| start | filter | in the band | error squared | settled, median | settled, worst |")
    print("|---|---|---|---|---|---|")
    wide = Start(tilt=math.radians(30.0), yaw=math.radians(30.0))
    for label, start in (("2°", START), ("30°", wide)):
        for entrant in contenders(start)[:2]:
            found = []
            for seed in track(
                range(seeds), description=f"{entrant.name} from {label}", transient=True, console=BAR
            ):
                log = sense(flight, Sensors(), np.random.default_rng([seed, 0]))
                found.append(flown(entrant, flight, log, Sensors(), seed, start))
            median = np.median([np.mean(r.squared) for r in found]) / 15.0
            wrong = [np.flatnonzero(np.abs(r.yaw) > math.radians(2.0)) for r in found]
            settled = [(w[-1] + 1) * EVERY * flight.dt if len(w) else 0.0 for w in wrong]
            share = in_band(r.squared for r in found)
            print(
                f"| {label} | {entrant.name} | {share:.0%} | {median:.2f} | "
                f"{np.median(settled):.0f} s | {max(settled):.0f} s |"
            )


def least(call: Callable[[], object], rounds: int) -> float:
    """CPU seconds, the least of the rounds."""
    taken = []
    for _ in range(rounds):
        begun = time.process_time()
        call()
        taken.append(time.process_time() - begun)
    return min(taken)


def _often(call: Callable[[], object], times: int) -> None:
    for _ in range(times):
        call()


def repeated(step: Callable[..., Any], pick: bool) -> Callable[..., Any]:
    """A compiled loop over one call: predictions in a row, corrections all of the same state."""
    if pick:

        @njit(cache=False)
        def loop(q, s, a, b, c, times):  # type: ignore[no-untyped-def]
            for _ in range(times):
                s = step(q, s, a, b, c)
            return s.time
    else:

        @njit(cache=False)
        def loop(q, s, a, b, c, times):  # type: ignore[no-untyped-def]
            total = 0.0
            for _ in range(times):
                after, code, _ = step(q, s, a, b)
                total += code + after.position[0]
            return total

    return loop


def cost(rounds: int) -> None:
    """Print microseconds a call from compiled code, and how many times as long plain NumPy takes."""
    flight, times = survey(2.0), 5000
    log = sense(flight, Sensors(), np.random.default_rng(0))
    imu = log.imu[50]
    dvl = next(m for m in log.after[50] if isinstance(m, Dvl))
    gyro, force = imu.angular_velocity, imu.specific_force
    rows: dict[str, dict[str, float]] = {}
    calls = {
        "predict": ("predict", gyro, force, 0.01),
        "DVL": ("correct_dvl", dvl.velocity, dvl.covariance, 0.0),
        "depth": ("correct_depth", -3.0, 0.02, 0.0),
        "heading": ("correct_heading", flight.pose(0).yaw, 0.02, 0.0),
    }
    for entrant in track(
        [e for e in contenders(START) if e.name != "Cipg*"], description="timing", transient=True
    ):
        state = entrant.begin(0.0, flight.pose(0), flight.velocities[0])
        for k in range(50):  # The observer's window fills.
            sample = log.imu[k]
            state = entrant.kernels.predict(
                entrant.estimator.compiled, state, sample.angular_velocity, sample.specific_force, 0.01
            )
            if k % 4 == 3:
                q = entrant.estimator.compiled
                state = entrant.kernels.correct_dvl(q, state, dvl.velocity, dvl.covariance)[0]
                state = entrant.kernels.correct_heading(q, state, flight.pose(k).yaw, 0.02)[0]
        rows[entrant.name] = {}
        for label, (name, a, b, c) in calls.items():
            loop = repeated(getattr(entrant.kernels, name), name == "predict")
            q = entrant.estimator.compiled
            loop(q, state, a, b, c, 1)
            taken = least(partial(loop, q, state, a, b, c, times), rounds)
            rows[entrant.name][label] = 1e6 * taken / times

    start = InEkf(mounting=MOUNTING).begin(0.0, flight.pose(0), flight.velocities[0])
    X = textbook.extended(start.rotation, start.velocity, start.position)
    b, P, densities = np.zeros(6), start.covariance, np.array([7e-5, 9.8e-4, 1e-5, 1e-4])
    R_d, t = np.asarray(DVL.rotation, np.float64), np.asarray(DVL.translation, np.float64)
    plain: dict[str, Callable[[], object]] = {
        "predict": lambda: textbook.predict(X, b, P, gyro, force, 0.01, densities),
        "DVL": lambda: textbook.correct(
            X, b, P, *textbook.dvl(X, b, gyro, 1e-5, dvl.velocity, dvl.covariance, R_d, t)
        ),
        "depth": lambda: textbook.correct(X, b, P, *textbook.depth(X, -3.0, 0.02, np.array(PRESSURE))),
        "heading": lambda: textbook.correct(X, b, P, *textbook.heading(X, 0.3, 0.02)),
    }
    rows["InEkf in NumPy"] = {}
    for label, call in plain.items():
        call()
        rows["InEkf in NumPy"][label] = 1e6 * least(partial(_often, call, 200), rounds) / 200
    print("\ncost: microseconds a call\n")
    print("| | " + " | ".join(calls) + " |")
    print("|---|" + "--:|" * len(calls))
    for name, row in rows.items():
        print(f"| {name} | " + " | ".join(f"{row[label]:.1f}" for label in calls) + " |")
    ratios = [f"{rows['InEkf in NumPy'][label] / rows['InEkf'][label]:.0f}" for label in calls]
    print("| times as fast as NumPy | " + " | ".join(ratios) + " |")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=["cost", "accuracy", "consistency"], help="one of the tables")
    parser.add_argument("--seeds", type=int, default=10, help="flights of each case of the accuracy")
    parser.add_argument("--many", type=int, default=100, help="flights for the consistency")
    parser.add_argument("--rounds", type=int, default=5, help="of the timing")
    arguments = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, {os.cpu_count()} CPUs")
    if arguments.only in (None, "cost"):
        cost(arguments.rounds)
    if arguments.only in (None, "consistency"):
        consistency(arguments.many)
    if arguments.only in (None, "accuracy"):
        accuracy(arguments.seeds)


if __name__ == "__main__":
    main()
