"""The contract with a real ArduSub: a vehicle, or its simulator SITL. Skipped unless asked for.

    DREAM_ARDUSUB=udpin:0.0.0.0:14550 pytest tests/hardware/test_ardusub.py -v

Checklist for a vehicle:

* It floats free at the surface, in water of a metre or more, the tether slack, nobody near its thrusters.
* No other ground station is connected; the address is one that BlueOS or SITL sends MAVLink to.
* It is disarmed. Without more it stays so: a parameter is changed and put back, modes are changed.
* DREAM_ARDUSUB_MOVE=1 lets it arm, turn by about 50° either way, and go 0.3 m down and up again.
* DREAM_ARDUSUB_FAILSAFE=1, with the former, lets the station fall silent: it has to disarm by itself.
* A hand is at the switch of its power.
"""

import math
import os
import time
from collections.abc import Iterator

import pytest

from dream.robots.bluerov2.mavlink import Link
from dream.robots.bluerov2.telemetry import Measurement
from tests.contracts.ardusub import Answers, Moves, Subject

ADDRESS = os.environ.get("DREAM_ARDUSUB", "")

pytestmark = pytest.mark.skipif(not ADDRESS, reason="DREAM_ARDUSUB has no address of an ArduSub")


def allowed(name: str) -> bool:
    return os.environ.get(name) == "1"


@pytest.fixture(scope="module")
def subject() -> Iterator[Subject]:
    heard: list[Measurement] = []
    placed: list[float] = []

    def tap(at: float, channel: str, sent: bool, message: object) -> None:
        kind = message.get_type()  # type: ignore[attr-defined]
        if not sent and kind == "LOCAL_POSITION_NED":
            placed.append(at)

    with Link(ADDRESS, now=time.monotonic, deliver=heard.append, tap=tap) as link:
        link.operator_alive()
        telemetry = link.connect(30.0)
        if telemetry.armed:
            pytest.skip("it is armed already, by somebody else")
        before = link.telemetry.mode
        # ArduSub sends it only where it has a position.
        link.set_message_interval("LOCAL_POSITION_NED", 5.0)
        subject = Subject(
            link,
            heard,
            moves=allowed("DREAM_ARDUSUB_MOVE"),
            fails=allowed("DREAM_ARDUSUB_MOVE") and allowed("DREAM_ARDUSUB_FAILSAFE"),
            has_position=False,
        )
        subject.wait(2.5)
        subject.has_position = bool(placed)
        if math.isnan(telemetry.depth):
            link.zero_depth()
        try:
            yield subject
        finally:
            link.restore()
            link.set_mode(before)


class TestAnswers(Answers):
    """Disarmed."""


class TestMoves(Moves):
    """Armed."""
