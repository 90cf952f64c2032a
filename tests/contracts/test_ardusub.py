"""The stand-in keeps the contract that a real ArduSub has to keep."""

import time
from collections.abc import Iterator

import pytest

from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.standin.dive import StandIn
from dream.robots.bluerov2.standin.parameters import NEXT
from dream.robots.bluerov2.standin.telemetry import AIR_PRESSURE
from dream.robots.bluerov2.telemetry import Measurement
from dream.sim.worlds import make_world
from tests.contracts.ardusub import Answers, Moves, Subject


@pytest.fixture(scope="class")
def subject(request: pytest.FixtureRequest) -> Iterator[Subject]:
    has_position = request.cls is TestMoves
    heard: list[Measurement] = []
    with (
        Link(
            "udpin:127.0.0.1:0", now=time.monotonic, deliver=heard.append, surface_pressure=AIR_PRESSURE
        ) as link,
        StandIn(make_world("pool/arc", 1), ground=("127.0.0.1", link.port), firmware=NEXT) as standin,
    ):
        standin.ardusub.fix = has_position
        standin.ardusub.parameters.change("FS_PILOT_TIMEOUT", 1.0)
        standin.start()
        link.operator_alive()
        link.connect(10.0)
        yield Subject(link, heard, moves=True, fails=True, has_position=has_position)


@pytest.mark.slow
class TestAnswers(Answers):
    """Disarmed, and without a position."""


@pytest.mark.slow
class TestMoves(Moves):
    """Armed, and with one."""
