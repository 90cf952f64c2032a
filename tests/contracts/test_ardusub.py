"""The stand-in keeps the contract that a real ArduSub has to keep, in its tank and on a simulated clock."""

from collections.abc import Iterator

import pytest

from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.lockstep import LockStep
from dream.robots.bluerov2.standin.parameters import NEXT
from dream.robots.bluerov2.standin.tank import BEAT
from dream.robots.bluerov2.standin.telemetry import AIR_PRESSURE
from dream.robots.bluerov2.standin.wire import SURFACE, Cable
from dream.robots.bluerov2.telemetry import Measurement
from dream.sim.worlds import make_world
from tests.contracts.ardusub import Answers, Moves, Subject


@pytest.fixture(scope="class")
def subject(request: pytest.FixtureRequest) -> Iterator[Subject]:
    has_position = request.cls is TestMovesPlaced
    heard: list[Measurement] = []
    clock = LockStep()
    cable = Cable(clock)
    with StandIn(
        make_world("pool/arc", 1), ground=SURFACE, host=None, datagrams=cable, firmware=NEXT
    ) as standin:
        standin.ardusub.fix = has_position
        standin.ardusub.parameters.change("FS_PILOT_TIMEOUT", 1.0)
        swimming = True

        def swim() -> None:
            while swimming:
                standin.beat()
                clock.sleep(BEAT)

        water = clock.start(swim, "water")
        with Link(
            cable, now=clock, deliver=heard.append, surface_pressure=AIR_PRESSURE, threads=clock
        ) as link:
            link.operator_alive()
            link.connect(10.0)
            yield Subject(link, heard, moves=True, fails=True, has_position=has_position, threads=clock)
        swimming = False
        water.join(1.0)


class TestAnswers(Answers):
    """Disarmed, and without a position."""


class TestMoves(Moves):
    """Armed, and without one."""


class TestMovesPlaced(Moves):
    """Armed, and with one."""
