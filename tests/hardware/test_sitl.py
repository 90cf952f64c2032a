"""The real ArduSub that our tank is put around; see `sitl`. Skipped where there is none."""

import hashlib
from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.robots.bluerov2.standin.tank import Tank
from dream.sim.world import World
from dream.sim.worlds import make_world
from tests.hardware.sitl import BINARY, SETUPS, Sitl

pytestmark = pytest.mark.skipif(not BINARY, reason="DREAM_ARDUSUB_SITL names no ArduSub built for SITL")


@pytest.fixture(scope="module")
def pool() -> World:
    return make_world("pool/arc", 1)


class Rig:
    """A real ArduSub, and what it says."""

    def __init__(self, pool: World, setup: str) -> None:
        self.tank = Tank(pool, depth=0.25)
        self.heard: list[Any] = []
        self.said = hashlib.sha256()
        self._parser = mav.MAVLink(None)
        self._parser.robust_parsing = True
        self._speaker = mav.MAVLink(None, srcSystem=255, srcComponent=190)
        self.sub = Sitl(self.tank, lambda data, to: self._take(data), parameters=SETUPS[setup])

    def _take(self, data: bytes) -> None:
        self.said.update(data)
        self.heard += self._parser.parse_buffer(data) or []

    def say(self, message: Any) -> None:
        self.sub.hear(message.pack(self._speaker))

    def run(self, seconds: float, z: int = 500) -> None:
        for k in range(round(seconds * 100)):
            if k % 5 == 0:
                self.say(mav.MAVLink_manual_control_message(1, 0, 0, z, 0, 0))
            if k % 100 == 0:
                self.say(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            self.tank.advance(self.sub.commands)
            self.sub.beat()

    def command(self, number: int, *values: float) -> None:
        padded = (*values, *([0.0] * (7 - len(values))))
        self.say(mav.MAVLink_command_long_message(1, 1, number, 0, *padded))


@pytest.fixture
def rig(pool: World) -> Iterator[Rig]:
    made = Rig(pool, "stock")
    yield made
    made.sub.close()


def test_it_boots_dives_in_alt_hold_and_holds(rig: Rig) -> None:
    rig.run(20.0)
    moved = [-rig.tank.state.position[2]]
    rig.command(mav.MAV_CMD_DO_SET_MODE, 1, 2)
    rig.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    rig.run(3.0, z=300)
    for _ in range(2):
        rig.run(4.0)
        moved.append(-rig.tank.state.position[2])
    assert moved[0] == 0.25
    assert moved[1] > 0.35
    assert moved[2] == pytest.approx(moved[1], abs=0.05)
    acks = [(m.command, m.result) for m in rig.heard if m.get_type() == "COMMAND_ACK"]
    assert acks == [(176, 0), (400, 0)]


def test_it_says_the_same_every_time_byte_for_byte(pool: World) -> None:
    said = []
    for _ in range(2):
        rig = Rig(pool, "origin")
        rig.run(10.0)
        said.append(rig.said.hexdigest())
        rig.sub.close()
    assert said[0] == said[1]
