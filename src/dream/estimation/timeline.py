"""Messages in the order in which they come in → states in the order in which they were true."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

from dream.estimation.intake import Outcome, Source, Verdict, finite, source_of
from dream.measurements import Imu, Measurement

SAME = 1e-9
"""Seconds between times that are the same."""
STEP = 0.02
"""Seconds that an estimator is carried at once, at most."""


class State(Protocol):
    """What a timeline reads of a state."""

    @property
    def time(self) -> float:
        """Seconds since the mission started."""

    @property
    def outcome(self) -> Outcome | None:
        """What became of the last measurement."""


S = TypeVar("S", bound=State)


class Filter(Protocol[S]):
    """What a timeline carries."""

    def predict(self, state: S, imu: Imu, dt: float) -> S:
        """The state `dt` seconds later."""

    def bridge(self, state: S, imu: Imu, dt: float) -> S:
        """The same where samples are missing, and one stands in for them."""

    def correct(self, state: S, measurement: Measurement) -> S:
        """The state after a measurement of its own time."""


@dataclass(slots=True)
class _Event(Generic[S]):
    """Something that changed the state, and the state after it."""

    time: float
    rank: int
    """Among events of the same time."""
    message: Imu | Measurement | Callable[[S], S] | None
    state: S
    bridged: bool = False
    """Is it a sample that stands for others, which are missing?"""


class Timeline(Generic[S]):
    """Any estimator, on messages of real devices: late, twice, too early, backwards, missing or NaN.

    What it does: remembers the messages of the last `memory` seconds with the states after them. A
    measurement is applied at the time it was true, in the middle of an inertial sample if need be, and what
    came since is applied again: the state is the same as if all had come in order. One that is ahead of the
    inertial samples waits for them. Whatever cannot be used is refused by name, and the vehicle goes on;
    nothing here raises.
    Assumes: inertial samples whose times only grow, from a clock that all messages share.
    Fails when: the clock of the inertial unit is set back, as all its samples are then refused: begin a new
    one.
    """

    def __init__(
        self,
        estimator: Filter[S],
        state: S,
        *,
        memory: float = 1.0,
        ahead: float = 1.0,
        gap: float = 0.1,
        leap: float = 1.0,
    ) -> None:
        """Begin with a state.

        Args:
            estimator: Carries the state.
            state: At the time after which messages count.
            memory: Seconds for which a measurement may be late.
            ahead: Seconds by which a measurement may be ahead of the inertial samples: as long as those may
                be missing, so that what is told meanwhile is taken in where it was true.
            gap: Seconds between two inertial samples from which on some are missing. They are bridged by the
                mean of both, and the estimator is told so. Shorter ones are stretched, and nobody is told.
            leap: Seconds between two inertial samples from which on the clock is not believed, unless the
                next sample agrees.
        """
        for name, value in (("memory", memory), ("ahead", ahead), ("gap", gap), ("leap", leap)):
            if not value >= 0.0:
                raise ValueError(f"{name}: expected seconds of at least 0, got {value}")
        self._estimator = estimator
        self._memory, self._ahead, self._gap, self._leap = memory, ahead, gap, leap
        self._events: list[_Event[S]] = [_Event(state.time, -1, None, state)]
        self._waiting: list[Measurement] = []
        self._sampled = state.time
        self._last: Imu | None = None
        self._leapt = math.nan

    @property
    def state(self) -> S:
        """The newest."""
        return self._events[-1].state

    def take(self, message: Imu | Measurement) -> Outcome:
        """Take in a message, and say what became of it."""
        if isinstance(message, Imu):
            return Outcome(Source.IMU, self._take_sample(message))
        return self._take_measurement(message)

    def amend(self, change: Callable[[S], S]) -> None:
        """Change the newest state by a rule; it is applied again wherever the state is made anew."""
        last = self._events[-1]
        self._events.append(_Event(last.time, 4, change, change(last.state)))

    def _take_sample(self, imu: Imu) -> Verdict:
        if not finite(imu):
            return Verdict.NOT_FINITE
        passed = imu.time - self._sampled
        if abs(passed) <= SAME:
            return Verdict.AGAIN
        if passed < 0.0:
            return Verdict.BACKWARDS
        if passed > self._leap and not SAME < imu.time - self._leapt <= self._leap:
            self._leapt = imu.time
            return Verdict.AHEAD
        missing = passed > self._gap
        stands_for = imu
        if missing and self._last is not None:
            stands_for = replace(
                imu,
                angular_velocity=0.5 * (imu.angular_velocity + self._last.angular_velocity),
                specific_force=0.5 * (imu.specific_force + self._last.specific_force),
            )
        self._leapt = math.nan
        self._last, self._sampled = imu, imu.time
        first = len(self._events)
        self._events.append(_Event(imu.time, 0, stands_for, self.state, missing))
        ready = [m for m in self._waiting if m.time <= imu.time + SAME]
        self._waiting = [m for m in self._waiting if m.time > imu.time + SAME]
        for measurement in ready:
            first = min(first, self._insert(measurement))
        self._replay(first)
        self._forget()
        return Verdict.BRIDGED if missing else Verdict.TAKEN

    def _take_measurement(self, measurement: Measurement) -> Outcome:
        source = source_of(measurement)
        if not math.isfinite(measurement.time):
            return Outcome(source, Verdict.NOT_FINITE)
        if measurement.time > self._sampled + self._ahead:
            return Outcome(source, Verdict.AHEAD)
        if measurement.time < self._events[0].time - SAME:
            return Outcome(source, Verdict.LATE)
        said = [event.message for event in self._at(measurement.time)]
        said += [m for m in self._waiting if abs(m.time - measurement.time) <= SAME]
        if any(type(message) is type(measurement) for message in said):
            return Outcome(source, Verdict.AGAIN)
        if measurement.time > self._sampled + SAME:
            self._waiting.append(measurement)
            return Outcome(source, Verdict.WAITING)
        first = self._insert(measurement)
        self._replay(first)
        outcome = self._events[first].state.outcome
        return outcome if outcome is not None else Outcome(source, Verdict.TAKEN)

    def _at(self, time: float) -> list[_Event[S]]:
        """All events of a time."""
        low = bisect_left(self._events, time - SAME, key=lambda event: event.time)
        high = bisect_right(self._events, time + SAME, key=lambda event: event.time)
        return self._events[low:high]

    def _insert(self, measurement: Measurement) -> int:
        """Put it in its place, whichever of two of one time came in first, and say where that is."""
        rank = [Source.DVL, Source.DEPTH, Source.HEADING].index(source_of(measurement)) + 1
        low = bisect_left(self._events, measurement.time - SAME, key=lambda event: event.time)
        while low < len(self._events):
            event = self._events[low]
            if event.time > measurement.time + SAME or event.rank > rank:
                break
            low += 1
        self._events.insert(low, _Event(measurement.time, rank, measurement, self._events[low - 1].state))
        return low

    def _replay(self, first: int) -> None:
        """Make all states from there on anew."""
        covering = self._next_sample(first)
        for index in range(first, len(self._events)):
            event, state = self._events[index], self._events[index - 1].state
            if covering < index:
                covering = self._next_sample(index)
            if event.time - state.time > SAME:
                state = self._carry(state, self._events[covering], event.time)
            if isinstance(event.message, Imu):
                event.state = state
            elif callable(event.message):
                event.state = event.message(state)
            elif event.message is not None:
                event.state = self._estimator.correct(state, event.message)

    def _next_sample(self, index: int) -> int:
        """Where the inertial sample is that covers the time before an event; past the end without one."""
        while index < len(self._events) and not isinstance(self._events[index].message, Imu):
            index += 1
        return index

    def _carry(self, state: S, sample: _Event[S], until: float) -> S:
        imu, start = sample.message, state.time
        assert isinstance(imu, Imu)
        step = self._estimator.bridge if sample.bridged else self._estimator.predict
        pieces = max(1, math.ceil((until - start) / STEP - SAME))
        for piece in range(1, pieces + 1):
            end = start + (until - start) * piece / pieces
            state = step(state, replace(imu, time=end), end - state.time)
        return state

    def _forget(self) -> None:
        """Drop what is older than the memory, but the state it led to."""
        keep = bisect_right(self._events, self._sampled - self._memory, key=lambda event: event.time)
        if keep > 1:
            base = self._events[keep - 1]
            self._events[:keep] = [_Event(base.time, -1, None, base.state)]
