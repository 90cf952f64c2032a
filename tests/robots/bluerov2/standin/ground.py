"""A ground station without sockets, for the stand-in's tests."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

from dream.geometry import SE2
from dream.robots.bluerov2.standin.ardusub import ArduSub
from dream.robots.bluerov2.standin.parameters import STABLE, Firmware
from dream.robots.bluerov2.standin.tank import Conditions, Tank
from dream.robots.bluerov2.standin.wire import Address
from dream.sim.world import World

Message = Any
NORTH = SE2(0.0, -0.8, 1.5707963267948966)


class Ground:
    """Talks to an ArduSub byte for byte, and keeps what it says."""

    def __init__(
        self,
        world: World,
        *,
        start: SE2 = NORTH,
        depth: float | None = None,
        conditions: Conditions | None = None,
        firmware: Firmware = STABLE,
        system: int = 1,
    ) -> None:
        self.tank = Tank(world, start=start, depth=depth, conditions=conditions)
        self.heard: list[Message] = []
        self._parser = mav.MAVLink(None)
        self.sub = ArduSub(self.tank, self._take, firmware=firmware, system=system)
        self.sticks: dict[str, int] | None = {}
        """Sent at 10 Hz; None for silence."""
        self.beats = True
        """Are heartbeats sent?"""

    def _take(self, data: bytes, to: Address | None) -> None:
        self.heard += self._parser.parse_buffer(data) or []

    def say(self, message: Message, *, system: int = 255) -> None:
        """As this ground station."""
        speaker = mav.MAVLink(None, srcSystem=system, srcComponent=190)
        self.sub.hear(message.pack(speaker), ("127.0.0.1", 14550))

    def beat(self, *, system: int = 255) -> None:
        """A heartbeat."""
        self.say(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), system=system)

    def stick(
        self, x: int = 0, y: int = 0, z: int = 500, r: int = 0, *, target: int = 1, system: int = 255
    ) -> None:
        """MANUAL_CONTROL."""
        self.say(mav.MAVLink_manual_control_message(target, x, y, z, r, 0), system=system)

    def command(self, number: int, *values: float, target: int = 1) -> int:
        """A COMMAND_LONG, and the result of its acknowledgement."""
        padded = (*values, *([0.0] * (7 - len(values))))
        mark = len(self.heard)
        self.say(mav.MAVLink_command_long_message(target, 1, number, 0, *padded))
        acks = [m for m in self.heard[mark:] if m.get_type() == "COMMAND_ACK" and m.command == number]
        return acks[-1].result if acks else -1

    def mode(self, number: int) -> int:
        """MAV_CMD_DO_SET_MODE."""
        return self.command(mav.MAV_CMD_DO_SET_MODE, mav.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, number)

    def arm(self) -> int:
        """MAV_CMD_COMPONENT_ARM_DISARM."""
        return self.command(mav.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def run(self, seconds: float) -> None:
        """Let time pass, with sticks at 10 Hz and heartbeats at 2 Hz."""
        for k in range(round(seconds * 100)):
            if self.sticks is not None and k % 10 == 0:
                self.stick(**self.sticks)
            if self.beats and k % 50 == 0:
                self.beat()
            self.tank.advance(self.sub.commands)
            self.sub.beat()

    def under_way(self, mode: int) -> None:
        """Armed in a mode, after the second in which it is held still; the motors begin to run."""
        self.run(2.0)
        assert self.mode(mode) == 0
        assert self.arm() == 0
        self.run(0.51)

    def all(self, kind: str) -> list[Message]:
        """What it heard of a type."""
        return [message for message in self.heard if message.get_type() == kind]

    def last(self, kind: str) -> Message:
        """The newest of a type."""
        return self.all(kind)[-1]

    @property
    def texts(self) -> list[str]:
        """Of STATUSTEXT."""
        return [message.text for message in self.all("STATUSTEXT")]

    def velocity(self, mask: int, frame: int = 8, **values: float) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""
        names = ("x", "y", "z", "vx", "vy", "vz", "afx", "afy", "afz", "yaw", "yaw_rate")
        numbers = [values.get(name, 0.0) for name in names]
        self.say(mav.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *numbers))
