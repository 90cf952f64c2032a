"""The way home: what moves take, what a mission may spend, and that it is home by then."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.cli import run_command
from dream.commands.outcome import home_told
from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.geometry import SE2, SE3, Bounds
from dream.homeward import Budget, Homeward, read_budget
from dream.homeward.pace import Pace, nominal_seconds
from dream.homeward.ways import after, move_to, node_of
from dream.mapping import OccupancyMap
from dream.mission import Robot, explore
from dream.planning import PLANNERS, Belief, Greedy
from dream.planning.space import ways
from dream.protocol import DREAM_V1, protocol_named
from dream.recording import read_config, read_steps, read_summary
from dream.report import repeating_command
from dream.robots import Teleport
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Arrival, Decision, Label, Mission, Observation, Setpoint, Step


@dataclass(slots=True)
class Ailing:
    """Another robot, which has trouble from a time on."""

    robot: Robot
    since: float
    trouble: str = "a lamp is out"
    until: float = math.inf

    def observe(self) -> Observation:
        seen = self.robot.observe()
        return replace(seen, trouble=self.trouble if self.since <= seen.time < self.until else "")

    def go_to(self, setpoint: Setpoint) -> Arrival:
        return self.robot.go_to(setpoint)


@dataclass(slots=True)
class Slowing:
    """Another robot, whose moves take longer from a time on, as against a current."""

    robot: Robot
    since: float
    factor: float
    lost: float = field(default=0.0)
    was: float = field(default=0.0)

    def observe(self) -> Observation:
        seen = self.robot.observe()
        if seen.time > self.since:
            self.lost += (self.factor - 1.0) * (seen.time - self.was)
        self.was = seen.time
        return replace(seen, time=seen.time + self.lost)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        return self.robot.go_to(setpoint)


# ------------------------------------------------------------------------------------------------- pace


def test_what_moves_take_is_learnt_from_them() -> None:
    pace = Pace()
    rng = np.random.default_rng(1)
    for nominal in rng.uniform(0.0, 8.0, 400):
        pace.learn(nominal, 1.7 * nominal + 2.5)
    assert pace.mean(40.0, 10) == pytest.approx(1.7 * 40.0 + 25.0, rel=0.01)


def test_before_any_move_it_is_what_is_believed() -> None:
    pace = Pace(rate=1.2)
    assert pace.mean(30.0, 6) == pytest.approx(1.2 * 30.0)
    assert pace.margin(9) == 0.0


def test_a_way_hardly_takes_more_than_its_margin_says() -> None:
    rng = np.random.default_rng(2)
    pace, ways, moves = Pace(), 300, 12
    for nominal in rng.uniform(0.0, 8.0, 200):
        pace.learn(nominal, nominal + 1.0 + rng.normal(0.0, 0.8))
    over = 0
    for _ in range(ways):
        nominal = rng.uniform(0.0, 8.0, moves)
        took = float((nominal + 1.0 + rng.normal(0.0, 0.8, moves)).sum())
        over += took > pace.mean(float(nominal.sum()), moves) + pace.margin(moves)
    assert over <= 0.01 * ways


# ------------------------------------------------------------------------------------------------ budget


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"seconds": 0.0}, "more than 0 s"),
        ({"seconds": math.nan}, "more than 0 s"),
        ({"battery_wh": -1.0}, "more than 0 Wh"),
        ({"tether_m": -1.0}, "more than 0 m"),
        ({"home": (math.inf, 0.0)}, "finite metres"),
    ],
)
def test_a_budget_that_is_none_is_refused(given: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Budget(**given)


@pytest.mark.parametrize("budget", [Budget(), Budget(90.0), Budget(90.5, 12.25, 40.0, (3.0, -4.5))])
def test_a_budget_is_read_as_it_was_written(budget: Budget) -> None:
    assert read_budget(json.loads(json.dumps(budget.as_dict()))) == budget


def test_a_budget_that_says_nothing_of_a_tether_has_none() -> None:
    told = Budget(90.0).as_dict()
    del told["tether_m"]
    assert read_budget(told) == Budget(90.0)


@pytest.mark.parametrize(
    "told",
    [
        {},
        {"seconds": "many", "battery_wh": None, "tether_m": None, "home": None},
        {"seconds": None, "battery_wh": None, "tether_m": None, "home": [1.0]},
        {"seconds": -1.0, "battery_wh": None, "tether_m": None, "home": None},
    ],
)
def test_a_damaged_budget_is_no_budget(told: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="budget"):
        read_budget(told)


class Motionless:
    """A robot that must not be asked to move."""

    def observe(self) -> Observation:
        raise AssertionError("asked to look")

    def go_to(self, setpoint: Setpoint) -> Arrival:
        raise AssertionError("asked to move")


@pytest.mark.parametrize(
    ("budget", "said"),
    [
        (Budget(seconds=9.0), "expected 10 s or more, which the first look around takes"),
        (Budget(home=(1000.0, 0.0)), "inside the survey area"),
        (Budget(home=(-14.9, 0.0)), "inside the survey area"),
    ],
)
def test_what_no_mission_can_keep_to_is_refused_before_anything_moves(
    empty_world: World, budget: Budget, said: str
) -> None:
    bounds = replace(empty_world.bounds, x_min=-15.0)
    with pytest.raises(ValueError, match=said):
        explore(Motionless(), Belief(), OccupancyMap(bounds, DREAM_V1), budget=budget)


def test_a_home_inside_a_boulder_is_refused() -> None:
    world = make_world("reef/string", 1)
    largest = int(world.obstacles.scale.max(axis=1).argmax())
    x, y, _ = (float(v) for v in world.obstacles.position[largest])
    with pytest.raises(ValueError, match="where something solid is"):
        simulate(world, Belief(), DREAM_V1, budget=Budget(home=(x, y)))


# ---------------------------------------------------------------------------------------------- missions


def flown(
    world: World, budget: Budget, protocol: str = "dream-v1", planner: str = "belief", **more: Any
) -> list[Step]:
    return list(simulate(world, PLANNERS[planner], protocol_named(protocol), budget=budget, **more))


def at_home(step: Step, place: tuple[float, float]) -> bool:
    pose = step.observation.pose
    return math.hypot(pose.x - place[0], pose.y - place[1]) < 0.1


@pytest.fixture(scope="module")
def reef() -> World:
    return make_world("reef/patch", 3)


@pytest.mark.parametrize("protocol", ["dream-v1", "dream-v1-noisy", "dream-v2"])
@pytest.mark.parametrize("seconds", [12.0, 45.0, 110.0, 220.0])
@pytest.mark.few(4)
def test_a_mission_is_home_within_its_seconds(reef: World, protocol: str, seconds: float) -> None:
    steps = flown(reef, Budget(seconds), protocol)
    start = steps[0].observation.pose
    last = steps[-1]
    assert last.ended == "returned"
    assert at_home(last, (start.x, start.y))
    assert last.observation.time <= seconds
    assert last.home is not None
    assert last.home.reached
    assert "are left of the time" in last.home.why
    assert not any(step.arrival.collided for step in steps)


@pytest.mark.parametrize("planner", ["greedy", "lawnmower", "random", "frontier"])
@pytest.mark.few(2)
def test_whoever_decides_is_led_home(reef: World, planner: str) -> None:
    steps = flown(reef, Budget(80.0), planner=planner)
    assert steps[-1].ended == "returned"
    assert steps[-1].observation.time <= 80.0
    assert at_home(steps[-1], (steps[0].observation.pose.x, steps[0].observation.pose.y))


@pytest.fixture(scope="module")
def turned(reef: World) -> list[Step]:
    """A mission that has to turn back."""
    return flown(reef, Budget(150.0))


def test_until_it_turns_the_way_home_is_affordable_with_its_margin(turned: list[Step]) -> None:
    steps = turned
    homes = [step.home for step in steps if step.home is not None]
    assert len(homes) == len(steps)
    before = [home for home in homes if not home.why]
    assert len(before) > 10
    for home in before:
        for balance in home.balances:
            assert balance.way + balance.margin <= balance.left + 1e-9
    farther = max(before, key=lambda home: home.balances[1].way)
    assert farther.balances[1].margin > before[0].balances[1].margin


def test_it_turns_round_once_and_does_not_go_out_again(turned: list[Step]) -> None:
    steps = turned
    whys = [step.home.why if step.home else "" for step in steps]
    since = next(k for k, why in enumerate(whys) if why)
    assert set(whys[since:]) == {whys[since]}
    left = [home.balances[0].way for step in steps[since + 1 :] if (home := step.home) is not None]
    assert all(after <= before for before, after in pairwise(left))


def test_the_steps_that_it_was_given_are_a_budget_as_well(reef: World) -> None:
    steps = flown(reef, Budget(), max_steps=40)
    assert steps[-1].ended == "returned"
    assert steps[-1].index <= 40
    assert "left of the steps" in steps[-1].home.why if steps[-1].home else False


def test_a_battery_is_a_budget(reef: World) -> None:
    steps = flown(reef, Budget(battery_wh=2.0))
    drawn = [step.observation.drawn_wh for step in steps]
    assert steps[-1].ended == "returned"
    assert all(one is not None for one in drawn)
    assert 1.0 < (drawn[-1] or 0.0) <= 2.0
    assert "are left of the battery" in steps[-1].home.why if steps[-1].home else False


def test_it_goes_home_to_where_it_is_told(reef: World) -> None:
    start = reef.starts[0]
    home = (start.x + 4.0, start.y)
    if not reef.bounds.contains(*home, margin=2.0):
        home = (start.x - 4.0, start.y)
    steps = flown(reef, Budget(120.0, home=home))
    assert at_home(steps[-1], home)
    assert not at_home(steps[-1], (start.x, start.y))


def test_a_home_that_no_known_way_leads_to_is_where_it_began(reef: World) -> None:
    start, bounds = reef.starts[0], reef.bounds
    corners = [
        (x, y)
        for x in (bounds.x_min + 1.0, bounds.x_max - 1.0)
        for y in (bounds.y_min + 1.0, bounds.y_max - 1.0)
    ]
    far = max(corners, key=lambda at: math.hypot(at[0] - start.x, at[1] - start.y))
    steps = list(
        explore(
            Teleport(reef, DREAM_V1), Greedy(), OccupancyMap(bounds, DREAM_V1), budget=Budget(40.0, home=far)
        )
    )
    assert steps[-1].ended == "returned"
    assert at_home(steps[-1], (steps[0].observation.pose.x, steps[0].observation.pose.y))


def test_a_mission_that_is_complete_ends_as_done_at_home(empty_world: World) -> None:
    steps = flown(replace(empty_world, bounds=Bounds(-8.0, -8.0, 8.0, 8.0)), Budget())
    said = next(step for step in steps if step.decision.done and not step.open_region)
    last = steps[-1]
    assert last.ended == "done"
    assert last.index >= said.index
    assert at_home(last, (steps[0].observation.pose.x, steps[0].observation.pose.y))
    assert last.home is not None
    assert last.home.why == "the mission is complete"


def test_one_that_need_not_go_home_flies_as_before(reef: World) -> None:
    free = list(simulate(reef, Belief(), DREAM_V1, max_steps=15))
    rich = explore(
        Teleport(reef, DREAM_V1), Belief(), OccupancyMap(reef.bounds, DREAM_V1), budget=Budget(1e6)
    )
    assert all(step.home is None for step in free)
    assert len(free) == 16
    for one, other in zip(free, islice(rich, len(free)), strict=True):
        assert one.decision == other.decision


@dataclass(frozen=True, slots=True)
class Insisting:
    """Says that it is done, again and again, whatever the map says."""

    waited: float = 0.0

    def begin(self, mission: Mission) -> Insisting:
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        return Decision(done=True, waited=self.waited)


@pytest.mark.parametrize("waited", [0.0, 12.0])
def test_who_insists_on_being_done_is_led_home_as_well(reef: World, waited: float) -> None:
    steps = list(simulate(reef, Insisting(waited), DREAM_V1, budget=Budget(150.0), max_steps=40))
    clock = steps[-1].observation.time + sum(step.decision.waited for step in steps)
    assert steps[-1].ended == "returned"
    assert clock <= 150.0


@pytest.mark.parametrize("seconds", [60.0, 100.0, 200.0])
def test_the_next_answer_may_take_as_long_as_the_longest(reef: World, seconds: float) -> None:
    @dataclass(frozen=True, slots=True)
    class Slow:
        def begin(self, mission: Mission) -> Any:
            pilot = Belief().begin(mission)

            class Waiting:
                def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
                    return replace(pilot.decide(observation, occupancy), waited=12.0)

            return Waiting()

    steps = list(simulate(reef, Slow(), DREAM_V1, budget=Budget(seconds)))
    assert steps[-1].observation.time + sum(step.decision.waited for step in steps) <= seconds
    assert steps[-1].ended == "returned"


def test_what_is_not_enough_for_the_place_that_was_asked_for_may_be_enough_for_the_start(reef: World) -> None:
    start = reef.starts[0]
    steps = flown(reef, Budget(14.0, home=(start.x + 5.0, start.y)))
    assert at_home(steps[-1], (start.x, start.y))
    assert steps[-1].observation.time <= 14.0


def test_a_clock_that_goes_on_while_a_planner_thinks_counts_that_once(reef: World) -> None:
    turned = []
    for ticking in (False, True):
        steps = list(
            explore(
                Teleport(reef, DREAM_V1),
                Insisting(10.0),
                OccupancyMap(reef.bounds, DREAM_V1),
                budget=Budget(90.0),
                max_steps=30,
                ticking=ticking,
            )
        )
        turned.append(steps[-1].index)
    assert turned[0] < turned[1]


@pytest.mark.parametrize("until", [math.inf, 62.0], ids=["lasts", "passes"])
@pytest.mark.parametrize("budget", [None, Budget(1e6)])
@pytest.mark.few(2)
def test_trouble_calls_a_mission_home_that_had_enough_left_even_if_it_passes(
    until: float, budget: Budget | None, reef: World
) -> None:
    robot = Ailing(Teleport(reef, DREAM_V1), since=60.0, until=until)
    steps = list(explore(robot, Belief(), OccupancyMap(reef.bounds, DREAM_V1), budget=budget))
    assert sum(bool(step.observation.trouble) for step in steps) == 1 or until == math.inf
    last = steps[-1]
    assert last.ended == "returned"
    assert last.home is not None
    assert last.home.why == "a lamp is out"
    assert at_home(last, (steps[0].observation.pose.x, steps[0].observation.pose.y))
    first = next(step for step in steps if step.home is not None and step.home.why)
    assert 60.0 <= first.observation.time < 70.0


def test_moves_that_become_slower_call_it_home_earlier(reef: World) -> None:
    times = []
    for factor in (1.0, 2.0):
        robot = Slowing(Teleport(reef, DREAM_V1), since=20.0, factor=factor)
        steps = list(explore(robot, Belief(), OccupancyMap(reef.bounds, DREAM_V1), budget=Budget(200.0)))
        assert steps[-1].ended == "returned"
        assert steps[-1].observation.time <= 200.0
        times.append(next(step.index for step in steps if step.home is not None and step.home.why))
    assert times[1] < times[0]


def test_a_vehicle_that_swims_is_home_within_its_seconds(reef: World) -> None:
    steps = list(simulate(reef, Belief(), protocol_named("dream-v1-nav"), budget=Budget(70.0)))
    assert steps[-1].ended == "returned"
    assert steps[-1].observation.time <= 70.0
    assert any(step.arrival.sigma > 0.0 for step in steps)


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_where_it_may_err_is_a_margin(reef: World, sigma: float) -> None:
    steps = list(simulate(reef, Greedy(), DREAM_V1, max_steps=12))
    first, last = steps[0].observation, steps[-1].observation
    margins = []
    for err in (0.0, sigma):
        homeward = Homeward.of(Budget(500.0), first, 200, steps[-1].occupancy, ticking=False)
        move, arrival = Decision(advance=1.0), replace(steps[-1].arrival, sigma=err)
        before, after = replace(first, time=0.0), replace(first, time=nominal_seconds(move))
        homeward.learn(move, before, arrival, after, steps[-1].occupancy)
        home = homeward.stands(last, steps[-1].occupancy, 12)
        margins.append(next(one.margin for one in home.balances if one.name == "time"))
    # Three times as far as it may err, at 0.5 m/s; all was learnt from a move at just that speed.
    assert margins[1] - margins[0] == pytest.approx(3.0 * sigma / 0.5)


@dataclass(slots=True)
class Walled:
    """Another robot, which gets nowhere from a time on."""

    robot: Robot
    since: float
    seen: Observation | None = None

    def observe(self) -> Observation:
        self.seen = self.robot.observe()
        return self.seen

    def go_to(self, setpoint: Setpoint) -> Arrival:
        assert self.seen is not None
        if self.seen.time >= self.since:
            here = self.seen.pose
            setpoint = replace(setpoint, x=here.x, y=here.y)
        return self.robot.go_to(setpoint)


@pytest.fixture
def lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """No way home is known anywhere but at home."""

    def way(pose: SE2, z: float, occupancy: OccupancyMap, home: tuple[float, float, float]) -> Any:
        there = node_of(SE2(home[0], home[1], 0.0), home[2], occupancy.protocol)
        return [] if node_of(pose, z, occupancy.protocol) == there else None

    monkeypatch.setattr("dream.homeward.keeper.way_home", way)


@pytest.mark.usefixtures("lost")
@pytest.mark.parametrize(
    ("protocol", "seconds"), [("dream-v1", 150.0), ("dream-v1-nav", 120.0), ("dream-v2-true", 70.0)]
)
def test_where_no_way_is_known_it_goes_back_as_it_came(reef: World, protocol: str, seconds: float) -> None:
    steps = flown(reef, Budget(seconds), protocol, planner="greedy")
    start, last = steps[0].observation.pose, steps[-1]
    assert last.ended == "returned"
    assert math.hypot(last.observation.pose.x - start.x, last.observation.pose.y - start.y) < 0.6
    turned = next(k for k, step in enumerate(steps) if step.home is not None and step.home.why)
    assert turned > 8
    assert not any(step.arrival.collided for step in steps)


@pytest.mark.usefixtures("lost")
def test_where_the_way_back_fails_too_it_looks_around(reef: World) -> None:
    robot = Walled(Teleport(reef, DREAM_V1), since=60.0)
    steps = list(
        explore(robot, Greedy(), OccupancyMap(reef.bounds, DREAM_V1), budget=Budget(110.0), max_steps=60)
    )
    said = [step.decision.reasoning.action for step in steps if step.home and step.home.why]
    assert steps[-1].ended == "cap"
    assert "bLLLb" in "".join("L" if "looking around" in words else "b" for words in said)


# ------------------------------------------------------------------------------------------------- lattice


@pytest.mark.parametrize("protocol", ["dream-v1", "pool-v1", "dream-v2"])
def test_a_move_and_the_one_back_end_where_they_began(protocol: str) -> None:
    rules = protocol_named(protocol)
    occupancy = OccupancyMap(Bounds(-9.0, -9.0, 9.0, 9.0), rules)
    for heading in range(rules.headings):
        for advance in (0.0, *rules.advances):
            for climb in rules.climbs:
                pose, z = SE2(1.0, -0.5, heading * rules.heading_step), -8.0
                to, height = after(pose, z, Decision(advance=advance, climb=climb), occupancy)
                goal = node_of(pose, z, rules)
                for _ in range(3):
                    if node_of(to, height, rules) == goal:
                        break
                    back = move_to(goal, to, height, rules)
                    assert back is not None
                    to, height = after(to, height, back, occupancy)
                assert node_of(to, height, rules) == goal


def test_no_move_leads_to_a_node_far_off() -> None:
    assert move_to((9, 9, 0), SE2(0.0, 0.0, 0.0), 0.0, DREAM_V1) is None


# ------------------------------------------------------------------------------------------------- volume


def test_a_map_whose_volume_changed_forgets_its_answers_also_where_nothing_shows_from_above() -> None:
    rules = protocol_named("dream-v2")
    occupancy = OccupancyMap(Bounds(100.0, 100.0, 118.0, 118.0), rules)
    asked: list[int] = []
    shape = (rules.camera.height, rules.camera.width)
    depth, labels = np.full(shape, 3.0, np.float32), np.zeros(shape, np.uint8)
    for x in (0.0, 1.0):  # Outside of the area, as drift may bring it.
        occupancy.answer("question", lambda: asked.append(1))
        at = SE3.level(x, 0.0, -8.0, 0.0) @ rules.T_base_camera
        occupancy.integrate(depth, labels, rules.camera, at)
    occupancy.answer("question", lambda: asked.append(1))
    assert len(asked) == 3


def test_the_way_home_builds_the_ways_of_a_volume_once_a_step(
    reef: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[Any] = []
    ways_in = ways.ways_in

    def counted(*asked: Any) -> Any:
        built.append(asked)
        return ways_in(*asked)

    monkeypatch.setattr(ways, "ways_in", counted)
    steps = flown(reef, Budget(60.0), "dream-v2", planner="lawnmower")
    assert steps[-1].ended == "returned"
    assert len(steps) > 5
    assert len(built) <= len(steps)


def test_the_last_lines_say_what_is_over_budget_and_that_it_is_not_home() -> None:
    late = {"reached": True, "why": "a lamp is out", "left": {"steps": 3, "time": -4.25}}
    assert home_told(late) == (
        "it is home, where it went since a lamp is out; over its budget by 4.25 s; "
        "left of what it had: 3 steps"
    )
    assert home_told({"reached": False, "why": "", "left": {}}) == "it is not home, as it should be"


# ------------------------------------------------------------------------------------- command and files


def test_a_run_keeps_its_budget_and_how_it_stood_at_every_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = ["run", "--world", "reef/patch", "--seed", "3", "--protocol", "dream-v1", "--budget-s", "60"]
    assert run_command([*line, "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "returned after" in said
    assert "it is home, where it went since the way home takes up to" in said
    (folder,) = (path for path in tmp_path.iterdir() if not path.is_symlink())
    config, summary, steps = read_config(folder), read_summary(folder), read_steps(folder)
    assert config.budget == {"seconds": 60.0, "battery_wh": None, "tether_m": None, "home": None}
    assert "--return start --budget-s 60" in repeating_command(config)
    assert summary is not None
    assert (summary.ended, summary.success, summary.t_stop) == ("returned", False, None)
    assert summary.home is not None
    assert summary.home["reached"] is True
    assert 0.0 <= summary.home["left"]["time"] < 60.0
    assert all(step.home is not None for step in steps)
    assert (folder / "report.html").is_file()


def test_no_line_of_a_run_without_a_budget_speaks_of_home(empty_world: World) -> None:
    scorer = Scorer(empty_world, DREAM_V1)
    for step in simulate(empty_world, Belief(), DREAM_V1, max_steps=5):
        scorer.add(step)
    assert scorer.summary()["home"] is None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--budget-s", "0"], "--budget-s: expected a number above 0, got 0"),
        (["--battery-wh", "-3"], "--battery-wh: expected a number above 0, got -3"),
        (["--budget-s", "4"], "expected 10 s or more, which the first look around takes"),
        (["--return", "here"], "--return: expected start, or x and y in metres"),
        (["--return", "1,nan"], "--return: expected finite metres"),
        (["--return", "900,1"], "inside the survey area"),
    ],
)
def test_bad_options_are_told_before_there_is_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], said: str
) -> None:
    assert run_command(["run", "--protocol", "dream-v1", *options, "--out", str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@dataclass(slots=True)
class Blinded:
    """Another robot, which from a time on sees something solid all around it."""

    robot: Robot
    since: float

    def observe(self) -> Observation:
        seen = self.robot.observe()
        if seen.time < self.since:
            return seen
        depth = np.full_like(seen.depth, 1.2)
        return replace(seen, depth=depth, labels=np.full_like(seen.labels, Label.OBSTACLE))

    def go_to(self, setpoint: Setpoint) -> Arrival:
        return self.robot.go_to(setpoint)


def test_where_no_way_is_known_it_turns_round_by_what_it_took_so_far_and_looks_for_one(reef: World) -> None:
    robot = Blinded(Teleport(reef, DREAM_V1), since=40.0)
    occupancy = OccupancyMap(reef.bounds, DREAM_V1)
    steps = list(explore(robot, Belief(), occupancy, budget=Budget(120.0), max_steps=90))
    lost = [step for step in steps if step.home is not None and step.home.path is None]
    assert lost
    assert all(step.home is not None and step.home.balances == () for step in lost)
    turned = next(step for step in steps if step.home is not None and step.home.why)
    assert turned.observation.time < 90.0
    assert any("looking around" in step.decision.reasoning.action for step in steps[-4:])
    assert steps[-1].ended == "cap"
    assert not any(step.arrival.collided for step in steps)
