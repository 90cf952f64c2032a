"""The loop: observe → map → decide → guard → move.

Recording, showing and scoring wrap the iterator that `explore` returns; the loop knows none of them.
Simulated, replayed and real are three robots.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Protocol

from dream.compiling import working_time
from dream.control import guard, setpoint
from dream.course import Course, Planner
from dream.homeward import Budget, Homeward
from dream.mapping import OccupancyMap, check_completion
from dream.mapping.prior import Prior
from dream.orders import Orders, everything
from dream.types import (
    LOOK_AROUND,
    Arrival,
    Decision,
    Guarded,
    Observation,
    Reasoning,
    Setpoint,
    Step,
    Target,
)


class Robot(Protocol):
    """What observes and goes. Poses are where it believes to be."""

    def observe(self) -> Observation:
        """Take one camera frame, here and now."""
        ...

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Turn, then advance. Returns where it really ended; stops at contact."""
        ...


def explore(
    robot: Robot,
    planner: Planner,
    occupancy: OccupancyMap,
    *,
    max_steps: int | None = None,
    target: Target = Target.ANY,
    orders: Orders | None = None,
    prior: Prior | None = None,
    budget: Budget | None = None,
    ticking: bool = False,
) -> Iterator[Step]:
    """Run one mission, yielding after every decision; the planner begins at once.

    The first step yielded, with index 0, is the first look, before anything was decided. The last one says
    how the mission ended: `done` when the planner said so and the map's completion check agreed, `cap` when
    the steps were spent. A `done` that the check refuses costs a step. Of several legs the last one ends the
    mission. With a budget the mission ends at home: `done` where it was complete before, `returned` where it
    had to turn round. So does one whose vehicle tells of trouble.

    Args:
        robot: Carries out the moves.
        planner: Decides after the look-around.
        occupancy: An empty map of the survey area; changed as the mission goes.
        max_steps: Decisions at most; the protocol's cap unless given.
        target: What the operator looks for, where there are no orders.
        orders: What the operator orders; to map everything where None.
        prior: What an earlier survey holds of the same ground, on the map's cells; only the planner hears of
            it, and only one that can use it does.
        budget: What it may spend until it is home; None where it need not go home.
        ticking: Does the clock of the robot's observations go on while a planner waits for an answer?

    Returns:
        The steps; the map of each is the live one.

    Raises:
        ValueError: The planner cannot begin, the prior does not fit the map, or no mission can keep to the
            budget; nothing has moved yet.
    """
    protocol = occupancy.protocol
    if prior is not None:
        prior.check_fits(occupancy.bounds, protocol.cell)
    if budget is not None:
        budget.check(occupancy.bounds, protocol)
    orders = everything(target) if orders is None else orders
    cap = protocol.cap if max_steps is None else max_steps
    cap = cap if orders.max_steps is None else min(cap, orders.max_steps)
    course = Course(planner, orders, occupancy, cap, prior)
    return _steps(robot, course, occupancy, cap, budget, ticking)


def _steps(
    robot: Robot,
    course: Course,
    occupancy: OccupancyMap,
    cap: int,
    budget: Budget | None,
    ticking: bool,
) -> Iterator[Step]:
    protocol = occupancy.protocol
    observation = first = robot.observe()
    occupancy.clear_launch(observation.pose.x, observation.pose.y, observation.z)
    _integrate(occupancy, observation)
    waiting = Decision()
    here = Arrival(observation.pose, collided=False, distance=0.0, clearance=math.inf)
    ended = "" if cap > 0 else "cap"
    homeward = None
    if budget is not None or first.trouble:
        homeward = Homeward.of(budget or Budget(), first, cap, occupancy, ticking=ticking)
    home = None if homeward is None else homeward.stands(first, occupancy, 0)
    yield Step(
        0, waiting, Guarded(waiting), here, observation, occupancy, ended=ended, leg=course.leg, home=home
    )

    for index in range(1, cap + 1):
        began = working_time()
        if homeward is not None and homeward.leads:
            decision = homeward.move(observation, occupancy)
        else:
            decision = _look_around() if index <= LOOK_AROUND else course.decide(observation, index - 1)
        planner_s = working_time() - began

        open_region = ""
        # In space the planner's own word ends it: the rule of the map is one of the view from above.
        if decision.done and protocol.space is None:
            open_region = check_completion(occupancy, observation.pose).open_region
        guarded = guard(decision, observation.pose, occupancy, protocol, observation.z)
        over = decision.done and not open_region
        if (
            homeward is not None
            and not over
            and not homeward.affords(guarded.decision, observation, occupancy, index - 1)
        ):
            decision = homeward.move_instead(decision, observation, occupancy)
            guarded = guard(decision, observation.pose, occupancy, protocol, observation.z)
        to = setpoint(observation.pose, guarded.decision, protocol, observation.z)
        arrival = robot.go_to(to)
        before, observation = observation, robot.observe()
        _integrate(occupancy, observation)
        if arrival.contact is not None and to.z is not None:
            occupancy.feel(observation.T_world_base.translation, arrival.contact, (to.x, to.y, to.z))
        if not course.over:
            leg = course.after(index, done=over)
        ended = "done" if course.over else "cap" if index == cap else ""
        if homeward is None and observation.trouble:
            homeward = Homeward.of(Budget(), first, cap, occupancy, ticking=ticking)
        if homeward is not None:
            homeward.learn(guarded.decision, before, arrival, observation, occupancy)
            home = homeward.stands(observation, occupancy, index, complete=course.over)
            if not (homeward.why and home.reached):
                ended = "cap" if index == cap else ""
            elif not course.over:
                ended = "returned"
        yield Step(
            index,
            decision,
            guarded,
            arrival,
            observation,
            occupancy,
            open_region,
            ended,
            planner_s,
            leg,
            home,
        )
        if ended:
            return


def _look_around() -> Decision:
    return Decision(
        turn=math.pi / 2.0,
        reasoning=Reasoning(action="Looking around: a quarter turn to the left, to build the first map."),
    )


def _integrate(occupancy: OccupancyMap, observation: Observation) -> None:
    occupancy.integrate(
        observation.depth,
        observation.labels,
        observation.camera,
        observation.T_world_camera,
        observation.confidence,
        observation.error,
    )
