"""Contact: what is solid stops the vehicle and counts."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dream.geometry import SE3
from dream.protocol import DREAM_V1
from dream.sim.solids import Solids
from dream.sim.vehicle import BLUEROV2_HEAVY, Contact, State, Vehicle, held
from tests.sim.arenas import EYE, FLOOR, arena, placed
from tests.sim.test_solids import all_triangles, slow_clearance, soup
from tests.sim.vehicle.test_hydrodynamics import energy, neutral

Array = npt.NDArray[np.float64]
RADIUS, HEIGHT = DREAM_V1.body_radius, DREAM_V1.body_height
SWIMMER = neutral(BLUEROV2_HEAVY)
WALL = Solids(arena(placed(0, [[3.0, 0.0, FLOOR]], [1.0, 8.0, 4.0])))
"""Its face is at x = 2.5, from y = −4 to 4."""


def moving(x: float, y: float, z: float, velocity: npt.ArrayLike, yaw: float = 0.0) -> State:
    """At a place, with a velocity in the world."""
    start = SWIMMER.at_rest(SE3.level(x, y, z, yaw))
    return replace(start, velocity=np.array(start.T_world_base.rotation.T @ np.asarray(velocity), np.float64))


def swim(
    solids: Solids,
    state: State,
    seconds: float,
    pull: npt.ArrayLike = (0.0, 0.0, 0.0),
    vehicle: Vehicle = SWIMMER,
) -> tuple[list[State], Contact]:
    contact, states = Contact(), [state]
    for _ in range(round(seconds / 0.01)):
        after = vehicle.step(state, np.zeros(8), 0.01, pull=pull)
        state, contact = held(vehicle, solids, DREAM_V1, state, after, contact)
        states.append(state)
    return states, contact


@pytest.mark.parametrize("yaw", [0.0, 0.8, 2.5])
def test_a_wall_stops_the_vehicle_at_its_radius_and_counts_once(yaw: float) -> None:
    states, contact = swim(WALL, moving(1.0, 0.0, EYE, [0.5, 0.0, 0.0], yaw), 8.0, (15.0, 0.0, 0.0))
    end = states[-1]
    assert end.position[0] == pytest.approx(2.5 - RADIUS, abs=0.01)
    assert end.position[0] < 2.5 - RADIUS
    assert abs(end.velocity_world[0]) < 1e-9
    assert contact == Contact(1, True)


def test_along_a_wall_it_slides() -> None:
    states, contact = swim(WALL, moving(2.0, -3.0, EYE, [0.0, 0.3, 0.0]), 8.0, (5.0, 3.0, 0.0))
    assert states[-1].position[1] > -2.5
    assert states[-1].velocity_world[1] > 0.05
    assert max(state.position[0] for state in states) < 2.5 - RADIUS
    assert contact.collisions == 1


def test_the_floor_stops_it_and_lets_it_go_sideways_and_up() -> None:
    states, contact = swim(WALL, moving(0.0, 0.0, EYE, [0.2, 0.0, -0.5]), 10.0, (4.0, 0.0, -30.0))
    end = states[-1]
    assert end.position[2] == pytest.approx(FLOOR + HEIGHT / 2, abs=0.01)
    assert end.position[2] > FLOOR + HEIGHT / 2
    assert abs(end.velocity_world[2]) < 1e-9
    assert end.velocity_world[0] > 0.05
    assert contact == Contact(1, True)
    state, there = end, contact
    for _ in range(200):
        after = SWIMMER.step(state, np.zeros(8), 0.01, pull=(0.0, 0.0, 30.0))
        state, there = held(SWIMMER, WALL, DREAM_V1, state, after, there)
    assert state.position[2] > end.position[2] + 0.1
    assert there == Contact(1, False)


def test_each_new_contact_counts() -> None:
    state, contact = moving(1.9, 0.0, EYE, [0.0, 0.0, 0.0]), Contact()
    for turn in range(3):
        for pull in (20.0, -12.0):
            for _ in range(300):
                after = SWIMMER.step(state, np.zeros(8), 0.01, pull=(pull, 0.0, 0.0))
                state, contact = held(SWIMMER, WALL, DREAM_V1, state, after, contact)
            assert contact.collisions == turn + 1
        assert not contact.touching


def test_where_nothing_is_near_nothing_changes() -> None:
    before = moving(0.0, 0.0, EYE, [0.3, 0.1, 0.0])
    after = SWIMMER.step(before, np.zeros(8), 0.01)
    state, contact = held(SWIMMER, WALL, DREAM_V1, before, after, Contact())
    assert np.array_equal(state.vector, after.vector)
    assert contact == Contact()


def test_in_a_corner_it_stays() -> None:
    walls = placed(0, [[3.0, 0.0, FLOOR], [0.0, 3.0, FLOOR]], [[1.0, 8.0, 4.0], [8.0, 1.0, 4.0]])
    solids = Solids(arena(walls))
    states, contact = swim(solids, moving(1.0, 1.2, EYE, [0.3, 0.3, 0.0]), 10.0, (10.0, 9.0, 0.0))
    end = states[-1]
    assert np.allclose(end.position[:2], 2.5 - RADIUS, atol=0.02)
    assert np.linalg.norm(end.velocity) < 0.02
    assert contact.touching


def test_what_begins_in_contact_can_only_rise() -> None:
    stuck = moving(0.0, 0.0, FLOOR + 0.05, [0.3, 0.0, 0.0])
    states, contact = swim(WALL, stuck, 3.0, (5.0, 0.0, 30.0))
    assert contact.collisions == 1
    assert not contact.touching
    risen = [state for state in states if state.position[2] < FLOOR + HEIGHT / 2 - 0.01]
    assert max(abs(state.position[0]) for state in risen) == 0.0
    assert states[-1].position[2] > FLOOR + 0.5
    after = replace(stuck, velocity=np.array([0.2, 0.0, -0.4]))
    pressed, contact = held(SWIMMER, WALL, DREAM_V1, stuck, after, Contact())
    assert np.array_equal(pressed.position, stuck.position)
    assert np.array_equal(pressed.velocity, np.zeros(3))
    assert contact == Contact(1, True, stuck=True)


@settings(max_examples=40, deadline=None)
@given(
    yaw=st.floats(-3.1, 3.1),
    speed=st.floats(0.05, 1.0),
    course=st.floats(-1.2, 1.2),
    sinking=st.floats(-0.3, 0.3),
)
def test_an_impact_takes_energy_and_the_velocity_towards_the_wall(
    yaw: float, speed: float, course: float, sinking: float
) -> None:
    velocity = [speed * math.cos(course), speed * math.sin(course), sinking]
    before = moving(2.5 - RADIUS - 1e-4, 0.0, EYE, velocity, yaw)
    moved = replace(before, position=before.position + 0.01 * np.array(velocity))
    after, contact = held(SWIMMER, WALL, DREAM_V1, before, moved, Contact())
    assert contact.collisions == 1
    assert abs(after.velocity_world[0]) < 1e-9
    assert energy(SWIMMER, after) <= energy(SWIMMER, before) + 1e-12
    assert after.position[0] < 2.5 - RADIUS
    # Along the wall it goes on.
    assert np.allclose(after.position[1:], moved.position[1:], atol=1e-6)


@pytest.mark.rare
def test_in_a_rough_world_the_body_is_never_inside_anything() -> None:
    rng = np.random.default_rng(31)
    world = soup(rng, 100)
    solids, triangles = Solids(world), all_triangles(world)
    contacts, looked = 0, 0
    for _ in range(12):
        x, y = rng.uniform(-8.0, 8.0, 2)
        state = moving(x, y, FLOOR + rng.uniform(1.5, 3.5), rng.normal(0.0, 0.5, 3), 0.3)
        if slow_clearance(triangles, x, y, state.position[2] - 0.2, state.position[2] + 0.2) <= RADIUS:
            continue
        pull = rng.normal(0.0, 60.0, 3)
        states, contact = swim(solids, state, 4.0, pull)
        contacts += contact.collisions
        for here in states[::40]:
            px, py, pz = here.position
            looked += 1
            assert slow_clearance(triangles, px, py, pz - HEIGHT / 2, pz + HEIGHT / 2) > RADIUS - 1e-6
    assert contacts > 2
    assert looked > 20
