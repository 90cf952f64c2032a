"""In three dimensions no contact is let pass, and what is refused is refused for a reason that is true."""

from __future__ import annotations

import math
import re

import numpy as np
import numpy.typing as npt
import pytest

from dream.control import guard, setpoint
from dream.control.guard import obstruction
from dream.mapping import OccupancyMap
from dream.mapping.volume import FREE, MARGIN, SOLID, UNKNOWN
from dream.protocol import DREAM_V2, DREAM_V2_TRUE, SurveyProtocol
from dream.robots import Teleport
from dream.sim.worlds import make_world
from dream.types import Decision, Observation

Array = npt.NDArray[np.float64]

WORLDS = (
    "reef/fringing",
    "reef/string",
    "reef/patch",
    "reef/mixed",
    "reef/L",
    "reef/S",
    "reef/O",
    "reef/K",
    "reef/E",
    "wreck/1",
    "wreck/2",
    "wreck/3",
    "wreck/4",
    "wreck/5",
)
TRIALS = [(name, 7000 + k) for k, name in enumerate((*WORLDS, *WORLDS[-5:], "wreck/3"))]


def integrated(occupancy: OccupancyMap, observation: Observation) -> None:
    occupancy.integrate(observation.depth, observation.labels, observation.camera, observation.T_world_camera)


def touches(start: Array, end: Array, voxel: Array, cell: float, protocol: SurveyProtocol) -> bool:
    """Does the body with its margin, on its way, touch the voxel that a point lies in? Looked at every mm."""
    low = np.floor(voxel / cell) * cell
    count = max(2, math.ceil(1000.0 * float(np.linalg.norm(end - start))))
    way = start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
    gap = np.maximum(np.maximum(low - way, way - (low + cell)), 0.0)
    beside = np.hypot(gap[:, 0], gap[:, 1]) <= protocol.body_radius + MARGIN + 0.002
    return bool((beside & (gap[:, 2] <= 0.5 * protocol.body_height + MARGIN + 0.002)).any())


def check_reason(why: str, move: Decision, seen: Observation, occupancy: OccupancyMap) -> None:
    protocol, volume = occupancy.protocol, occupancy.volume
    assert volume is not None
    assert protocol.space is not None
    goal = setpoint(seen.pose, move, protocol, seen.z)
    assert goal.z is not None
    end = np.array([goal.x, goal.y, goal.z])
    if "leaves the survey area" in why:
        assert not occupancy.bounds.contains(goal.x, goal.y)
    elif "surface of the water" in why:
        assert goal.z > -protocol.space.surface
    elif "what lies below" in why:
        below = end - np.array([0.0, 0.0, 1.0]) * np.linspace(0.0, protocol.space.lowest, 40)[:, None]
        assert (volume.state(below) == SOLID).any()
    else:
        found = re.search(r"meets (.*) at \((.*), (.*), (.*)\)", why)
        assert found is not None
        wanted = SOLID if found[1] == "something solid" else UNKNOWN
        where = np.array([float(found[k]) for k in (2, 3, 4)])
        assert volume.state(where[None])[0] == wanted
        assert touches(np.array([seen.pose.x, seen.pose.y, seen.z]), end, where, volume.cell, protocol)


def walked(name: str, seed: int, protocol: SurveyProtocol, moves: int) -> tuple[int, int, int]:
    """Moves made, refused and at a contact, by one who decides at random."""
    world = make_world(name, seed)
    rng = np.random.default_rng(seed)
    robot, occupancy = Teleport(world, protocol), OccupancyMap(world.bounds, protocol)
    seen = robot.observe()
    occupancy.clear_launch(seen.pose.x, seen.pose.y, seen.z)
    integrated(occupancy, seen)
    made = refused = contacts = 0
    for _ in range(moves):
        decision = Decision(
            float(rng.choice(protocol.turn_angles)),
            float(rng.choice((0.0, *protocol.advances, *protocol.advances))),
            climb=float(rng.choice(protocol.climbs)),
            tilt=float(rng.choice(protocol.tilts)),
        )
        guarded = guard(decision, seen.pose, occupancy, protocol, seen.z)
        carried_out = guarded.decision
        if (carried_out.advance, carried_out.climb) == (decision.advance, decision.climb):
            assert not guarded.note
        else:
            refused += 1
            why = obstruction(decision, seen.pose, occupancy, protocol, seen.z)
            assert why
            assert why in guarded.note
            check_reason(why, decision, seen, occupancy)
        arrival = robot.go_to(setpoint(seen.pose, carried_out, protocol, seen.z))
        made += carried_out.advance > 0.0 or carried_out.climb != 0.0
        contacts += arrival.collided
        seen = robot.observe()
        integrated(occupancy, seen)
    return made, refused, contacts


@pytest.mark.parametrize(
    "protocol",
    [DREAM_V2, pytest.param(DREAM_V2_TRUE, marks=pytest.mark.rare)],
    ids=lambda p: p.name,
)
def test_no_contact_is_let_pass_and_every_refusal_has_a_true_reason(protocol: SurveyProtocol) -> None:
    made, refused, contacts = walked("wreck/4", 7103, protocol, 80)
    assert contacts == 0
    assert made > 20
    assert refused > 5


@pytest.mark.rare
@pytest.mark.parametrize("name, seed", TRIALS)
def test_nor_in_500_moves_in_each_of_20_worlds(name: str, seed: int) -> None:
    made, _, contacts = walked(name, seed, DREAM_V2, 500)
    assert contacts == 0
    assert made > 100


def test_what_is_solid_is_named_before_what_is_unknown_and_a_free_way_is_let_pass() -> None:
    protocol = DREAM_V2_TRUE
    world = make_world("flat/empty", 1)
    robot, occupancy = Teleport(world, protocol), OccupancyMap(world.bounds, protocol)
    seen = robot.observe()
    occupancy.clear_launch(seen.pose.x, seen.pose.y, seen.z)
    integrated(occupancy, seen)
    assert occupancy.volume is not None
    assert guard(Decision(advance=2.0), seen.pose, occupancy, protocol, seen.z).note == ""
    far_up = Decision(climb=1.0, advance=2.0)
    assert guard(far_up, seen.pose, occupancy, protocol, seen.z).decision.advance > 0.0
    assert (occupancy.volume.state(np.array([[seen.pose.x, seen.pose.y, seen.z]])) == FREE).all()
    down = Decision(climb=-1.0)
    for _ in range(3):
        guarded = guard(down, seen.pose, occupancy, protocol, seen.z)
        robot.go_to(setpoint(seen.pose, guarded.decision, protocol, seen.z))
        seen = robot.observe()
        integrated(occupancy, seen)
    assert seen.z >= float(world.terrain.height(seen.pose.x, seen.pose.y)) + 0.5
