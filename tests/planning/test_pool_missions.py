"""Missions in the tank, where only what was traversed counts."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest

from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.geometry import SE2, SE3
from dream.mapping import OccupancyMap, check_completion
from dream.mission import Robot, explore
from dream.planning import Belief
from dream.protocol import POOL_V1, SensorNoise, SurveyProtocol
from dream.robots.teleport import Teleport
from dream.sim.worlds import make_world
from dream.types import Arrival, Mission, Observation, Setpoint, Step
from tests.mapping.test_traversed import NOWHERE, TANK, cells, tank

NOISY = replace(
    POOL_V1,
    name="pool-v1-noisy",
    noise=SensorNoise(depth=0.002, missed=0.1, false_targets=0.3, false_size=(0.03, 0.12)),
)
"""It sees spots on the bare floor that no shell is."""
OFF = 0.02
"""Metres by which the believed position errs, anew after each move."""


@dataclass
class Beside:
    """A robot that is up to `OFF` beside where it believes to be; it goes to nodes of the lattice."""

    robot: Robot
    generator: np.random.Generator
    off: tuple[float, float] = (0.0, 0.0)

    def observe(self) -> Observation:
        seen = self.robot.observe()
        true = seen.T_world_base
        believed = SE3(true.rotation, true.translation + np.array([*self.off, 0.0]))
        return replace(seen, T_world_base=believed)

    def go_to(self, setpoint: Setpoint) -> Arrival:
        node = POOL_V1.snap(SE2(setpoint.x, setpoint.y, setpoint.yaw))
        arrival = self.robot.go_to(replace(setpoint, x=node.x, y=node.y, yaw=node.yaw))
        angle, length = self.generator.uniform(0.0, 2.0 * np.pi), OFF * np.sqrt(self.generator.random())
        self.off = (length * np.cos(angle), length * np.sin(angle))
        pose, truth = arrival.pose, SE3.level(arrival.pose.x, arrival.pose.y, 0.0, arrival.pose.yaw)
        return replace(arrival, pose=SE2(pose.x + self.off[0], pose.y + self.off[1], pose.yaw), truth=truth)


def flown(seed: int, protocol: SurveyProtocol, start: int = 0, *, beside: bool = False) -> Iterator[Step]:
    world = make_world("pool/arc", seed)
    if not beside:
        return simulate(world, Belief(), protocol, start=start)
    robot = Beside(Teleport(world, protocol, world.starts[start]), np.random.default_rng(seed))
    return explore(robot, Belief(), OccupancyMap(world.bounds, protocol))


@pytest.mark.rare
@pytest.mark.parametrize(("seed", "protocol", "beside"), [(1, POOL_V1, False), (4, NOISY, True)])
def test_it_traverses_the_shells_touches_nothing_and_stops_by_itself(
    seed: int, protocol: SurveyProtocol, *, beside: bool
) -> None:
    world = make_world("pool/arc", seed)
    scorer = Scorer(world, POOL_V1)
    for step in flown(seed, protocol, beside=beside):
        coverage = scorer.add(step)
        assert not step.arrival.collided
        reasoning = step.decision.reasoning
        said = re.search(
            r"(\d+) of (\d+) target cells were traversed; (\w+) of the rest", reasoning.completion
        )
        if step.decision.done:
            assert said is not None
            assert said[3] == "none"
    assert step.ended == "done"
    assert step.index < 60
    assert coverage.instances >= 0.95
    for x, y in world.obstacles.position[1:, :2]:
        row, col = step.occupancy.cell_of(x, y)
        assert step.occupancy.distance_to_solid[row, col] <= 0.06, "both pipes are in the map"


@pytest.mark.rare
def test_what_it_says_of_the_traversal_is_true_of_the_map() -> None:
    before: tuple[int, int, int] | None = None
    walked = 0
    for step in flown(2, POOL_V1):
        reasoning, occupancy = step.decision.reasoning, step.occupancy
        said = re.search(
            r"(\d+) of (\d+) target cells were traversed; (\w+) of the rest", reasoning.completion
        )
        if said is not None and before is not None:
            left = 0 if said[3] == "none" else int(said[3])
            assert (int(said[1]), int(said[2]), left) == before
            promised = re.search(r"traverse (\d+) target cell", reasoning.next_target)
            walked += promised is not None
            assert (promised is not None) or not left, "what can be traversed is, first of all"
            assert reasoning.target_area.startswith("What is left to traverse:") == bool(left)
        target = occupancy.target
        before = (
            int((target & occupancy.traversed).sum()),
            int(target.sum()),
            len(check_completion(occupancy, step.observation.pose).untraversed),
        )
    assert walked > 10


def test_it_gives_up_what_it_cannot_traverse_and_tries_again_once_refused() -> None:
    target = cells(np.s_[29:31, 44:46])
    occupancy = tank(target)
    pilot = Belief().begin(Mission(POOL_V1, TANK, 200))
    T_world_base = SE3.level(0.0, 0.0, -0.9, 0.0)
    blank = np.zeros(NOWHERE.shape, np.uint8)
    stuck = Observation(
        0.0,
        np.zeros((*NOWHERE.shape, 3), np.uint8),
        NOWHERE,
        blank,
        POOL_V1.camera,
        T_world_base,
        POOL_V1.T_base_camera,
    )
    # It never gets anywhere: as if something that is not in the map held it.
    decisions = [pilot.decide(stuck, occupancy) for _ in range(4)]
    assert not decisions[0].done
    assert decisions[0].advance > 0.0
    assert decisions[2].done, "what it came back to for the third time is given up"
    assert "4 of the rest can be" in decisions[2].reasoning.completion
    assert not decisions[3].done, "refused, it tries once more"
