"""A battery that gets low in mid mission: the vehicle goes home, comes up there and is disarmed."""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from dream.commands.dive.records import print_outcome
from dream.commands.homing import Homing
from dream.homeward import read_budget
from dream.mapping import OccupancyMap
from dream.mission import explore
from dream.planning.belief import Belief
from dream.protocol import POOL_V1
from dream.recording import RecordedStep, read_config, read_steps
from dream.robots.bluerov2.home import SHALLOW
from dream.robots.bluerov2.limits import LOW_SHARE, SAG, Limits
from dream.robots.bluerov2.standin.rig import Rig
from dream.robots.replay import Replayed
from dream.sim.worlds import make_world
from dream.types import Step
from tests.robots.bluerov2 import rigged

TANK = make_world("pool/arc", 1)
NEAR = 0.25
"""Metres from where a mission began within which it is home: a step, and what it errs by."""


@dataclass
class Flown:
    """What came of a mission that something happened to."""

    folder: Path
    error: BaseException | None
    armed: bool
    depth: float
    """Metres, by truth."""
    away: float
    """Metres from where its first look was taken, by truth, over ground."""
    told: list[tuple[float, float, float]] = field(default_factory=list)
    """Time, voltage, and share that is left, twice a second as the surface hears of it."""

    @property
    def steps(self) -> list[RecordedStep]:
        return list(read_steps(self.folder))

    @property
    def summary(self) -> dict[str, Any]:
        told: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        return told

    def turned(self) -> RecordedStep:
        """The step at which it was called home."""
        return next(step for step in self.steps if step.home is not None and step.home.why)


def flown(
    folder: Path, happens: Callable[[Rig], object], limits: Limits | None = None, **options: Any
) -> Flown:
    """A mission in the paper's tank to which something happens once it is at the mission's altitude."""
    folder = folder / "2026-01-01T00-00-00_dive_belief"
    folder.mkdir()
    with Rig(folder, TANK, pictures=5.0, width=160, depth=0.25, limits=limits) as rig:
        told: list[tuple[float, float, float]] = []

        def watch() -> None:
            while True:
                said = rig.link.telemetry
                told.append((rig.now(), said.voltage, said.battery))
                rig.clock.sleep(0.5)

        happens(rig)
        rig.clock.start(watch, "watch")
        dived = rigged.dive(rig, folder, **options)
        assert [finding for finding in dived.found if not finding.ok] == []
        here = rig.standin.T_world_base.translation
        start = rig.start
        return Flown(
            folder,
            dived.error,
            rig.standin.ardusub.armed,
            -float(here[2]),
            math.hypot(here[0] - start.x, here[1] - start.y),
            told,
        )


def runs_low(rig: Rig) -> None:
    """Some seconds after it set out a fifth of its charge is left; its autopilot knows the capacity."""
    rig.standin.ardusub.parameters.change("BATT_CAPACITY", 18_000)
    rig.standin.tank.leave(LOW_SHARE + 0.0115)


def sags(rig: Rig) -> None:
    """Half the charge is left, and a contact becomes bad in mid mission."""
    rig.standin.tank.leave(0.5)
    rig.after(45.0, lambda: setattr(rig.standin.tank, "resistance", 0.35))


@pytest.fixture(scope="module")
def low(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    # By the voltage it would be called home before: by these cells 20 % is 13.9 V at rest.
    return flown(tmp_path_factory.mktemp("low"), runs_low, Limits(TANK.bounds, voltage=13.0))


@pytest.fixture(scope="module")
def sagged(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    return flown(tmp_path_factory.mktemp("sagged"), sags)


@pytest.fixture(params=["low", pytest.param("sagged", marks=pytest.mark.rare)])
def called_home(request: pytest.FixtureRequest) -> Flown:
    found: Flown = request.getfixturevalue(request.param)
    return found


@pytest.mark.slow
def test_with_a_fifth_of_its_charge_left_it_goes_home(low: Flown) -> None:
    turned = low.turned()
    assert turned.home is not None
    assert turned.home.why == "the battery has 20% left"
    assert 4 < turned.step < 25
    # Not before: until the step before that it was told of more.
    began, before, ended = (low.steps[k].time for k in (0, turned.step - 1, -1))
    assert min(left for time, _, left in low.told if began < time < before) > LOW_SHARE
    assert min(volts for time, volts, _ in low.told if began < time < ended) > 13.4


@pytest.mark.rare
def test_with_a_voltage_that_sags_under_load_it_goes_home_while_charge_is_left(sagged: Flown) -> None:
    turned = sagged.turned()
    assert turned.home is not None
    assert turned.home.why == "the battery is at 14.3 V"
    assert 4 < turned.step < 25
    assert turned.time > 45.0 + SAG


@pytest.mark.slow
def test_it_comes_up_near_its_start_and_is_disarmed(called_home: Flown) -> None:
    assert called_home.error is None
    last, summary = called_home.steps[-1], called_home.summary
    assert last.ended == summary["ended"] == "returned"
    assert last.step > called_home.turned().step
    assert summary["home"]["reached"]
    assert summary["collisions"] == 0
    assert not called_home.armed
    assert called_home.depth < SHALLOW
    assert called_home.away < NEAR


def replayed(flown: Flown) -> list[Step]:
    """The mission again, from what was seen."""
    robot, kept = Replayed(flown.folder), read_config(flown.folder).budget
    budget = None if kept is None else read_budget(kept)
    again = list(explore(robot, Belief(), OccupancyMap(TANK.bounds, POOL_V1), budget=budget, ticking=True))
    assert robot.divergences == ()
    return again


@pytest.mark.slow
def test_a_replay_turns_home_where_the_dive_did(called_home: Flown) -> None:
    again, steps = replayed(called_home), called_home.steps
    assert [step.ended for step in again] == [step.ended for step in steps]
    turned = next(step for step in again if step.home is not None and step.home.why)
    assert turned.index == called_home.turned().step


@pytest.mark.slow
def test_all_are_told_why_it_came_home(called_home: Flown, capsys: pytest.CaptureFixture[str]) -> None:
    turned, summary = called_home.turned(), called_home.summary
    assert turned.home is not None
    why = turned.home.why
    # The console shows what the newest step says.
    going = called_home.steps[turned.step + 1].reasoning
    assert going is not None
    assert going.action.startswith("Going home, ")
    assert going.action.endswith(f" steps away: {why}.")
    assert summary["home"]["why"] == why
    print_outcome(summary, None)
    assert f"it is home, where it went since {why}" in capsys.readouterr().out
    assert why in (called_home.folder / "report.html").read_text(encoding="utf-8")


@pytest.mark.rare
def test_a_mission_that_goes_home_is_there_before_its_minutes_are_over(tmp_path: Path) -> None:
    minutes = 1.25
    dived = flown(
        tmp_path, lambda rig: None, Limits(TANK.bounds, minutes=minutes), homing=Homing(home="start")
    )
    assert dived.error is None
    steps = dived.steps
    assert steps[-1].ended == "returned"
    turned = dived.turned()
    assert turned.home is not None
    assert turned.home.why.endswith("are left of the time")
    # Minutes count from when it was armed, its launch included.
    assert steps[0].time > 10.0
    assert 45.0 < steps[-1].time < 60.0 * minutes + steps[0].time
    # A replay is told the seconds that were left for the mission.
    kept = read_config(dived.folder).budget
    assert kept is not None
    assert 60.0 * minutes - 20.0 < kept["seconds"] < 60.0 * minutes - 1.0
    assert [step.ended for step in replayed(dived)] == [step.ended for step in steps]
