"""A real ArduSub in software (SITL) around our own tank, in lock-step: it takes the place of our stand-in's.

    DREAM_ARDUSUB_SITL=/path/to/ardusub pytest tests/hardware
    unshare -n bash -c 'ip link set lo up; DREAM_ARDUSUB_SITL=/path/to/ardusub pytest tests/hardware'

The second needs root, and keeps all of it off every network: of itself ArduSub takes its physics on a UDP
port of all interfaces. It binds nothing else; all ports are free ones on loopback, so that many can run.
`--home`, JSON, the names of parameters and what they mean are ArduPilot's; nothing of ArduPilot is here.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import socket
import struct
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.robots.bluerov2.standin import motors
from dream.robots.bluerov2.standin.ardusub import Send
from dream.robots.bluerov2.standin.motors import HALF_PWM, NEUTRAL_PWM
from dream.robots.bluerov2.standin.tank import BEAT, Tank
from dream.robots.bluerov2.standin.telemetry import TILT_CHANNEL
from dream.robots.bluerov2.standin.wire import Address

Float64Array = npt.NDArray[np.float64]

BINARY = os.environ.get("DREAM_ARDUSUB_SITL", "")
"""ArduSub, built for SITL; empty where there is none."""

FRAMES = 4
"""Steps of ArduSub (400 Hz) in a beat of the tank."""
FRAME = 1.000004 * BEAT / FRAMES
"""Seconds by which stamps differ: a hair more than a step, since it cuts them to whole microseconds."""
SERVOS = {18458: 16, 29569: 32}
"""Outputs in a packet by its first two bytes."""
PATIENCE = 20.0
"""Seconds of real time within which it has to answer."""
MOST_BYTES = 1 << 16
TILT_RANGE = math.radians(45.0)
STIRRED = 3
"""Microseconds away from the middle that are thrust."""

HOME = (22.3, 114.2)
"""Degrees of latitude and longitude of the tank: the compass points 3° to the west of north there."""
POOL: dict[str, float] = {
    # A BlueROV2 Heavy as BlueOS sets it up for ArduSub 4.7.
    "FRAME_CONFIG": 2,
    **{f"SERVO{k}_FUNCTION": 32 + k for k in range(1, 9)},
    **{f"SERVO{k}_FUNCTION": 0 for k in (9, 10, 11, 12, 15)},
    "SERVO13_FUNCTION": 181,
    "SERVO14_FUNCTION": 182,
    "SERVO16_FUNCTION": 7,
    "MNT1_TYPE": 1,
    "MNT1_PITCH_MAX": 45,
    "MNT1_PITCH_MIN": -45,
    "RNGFND1_TYPE": 10,
    "ANGLE_MAX": 4500,
    "ATC_INPUT_TC": 0.1,
    **{f"ATC_ANG_{axis}_P": 6.0 for axis in ("RLL", "PIT", "YAW")},
    "BATT_MONITOR": 4,
    "EK3_SRC1_POSXY": 0,
    "GPS1_TYPE": 0,
    # What the simulator adds: a joystick that is away, a calm gauge, a compass that is calibrated, no logs.
    "SIM_RC_FAIL": 1,
    "SIM_BATT_VOLTAGE": 16.4,
    **{f"SIM_{gauge}_RND": 0.005 for gauge in ("BARO", "BAR2", "BAR3")},
    **{f"COMPASS_OFS{n}_{axis}": v for n in ("", 2, 3) for axis, v in (("X", 5), ("Y", 13), ("Z", -18))},
    "SIM_GPS1_ENABLE": 0,
    "LOG_BITMASK": 0,
}
"""What it knows nowhere: a pool, without a receiver."""


def at(home: tuple[float, float] = HOME, altitude: float = 0.0) -> dict[str, float]:
    """POOL, told where it is, and a height of its surface above the sea: 0 is right."""
    return {**POOL, "ORIGIN_LAT": home[0], "ORIGIN_LON": home[1], "ORIGIN_ALT": altitude}


GPS: dict[str, float] = {**POOL, "EK3_SRC1_POSXY": 3, "GPS1_TYPE": 1, "SIM_GPS1_ENABLE": 1}
"""With a receiver."""
SETUPS: dict[str, dict[str, float]] = {
    "stock": POOL,
    "origin": at(),
    "lake": at(altitude=50.0),
    "low": at(altitude=-5.0),
    "gps": GPS,
    "gps-lake": {**GPS, "SIM_GPS1_ALT_OFS": 50.0},
}
"""Parameters by name: nothing known; an origin at the surface, 50 m above, 5 m below; a receiver, at sea
and 50 m above it."""


class Sitl:
    """A real `Autopilot`, in a process of its own: `StandIn(world, autopilot=Sitl)`, or a `partial` of it.

    What it does: in each beat of the tank the process makes four steps, each of which waits for what we say
    of the vehicle: no computer is too slow for it, and none too fast. The vehicle's pose, velocity and
    inertial sample are the tank's; gauge and compass are the process's own. What it says over MAVLink during
    a beat is there at its end; what it hears, it reads within the next 12.5 ms of its own time.
    Time: its own begins with the tank's. It is ready to arm some 20 s later.
    Fails when: the process dies, or says nothing for `PATIENCE`.
    """

    def __init__(
        self,
        tank: Tank,
        send: Send,
        *,
        parameters: Mapping[str, float] = POOL,
        binary: str = BINARY,
        home: tuple[float, float] = HOME,
        folder: Path | None = None,
    ) -> None:
        """Start it.

        Args:
            tank: The vehicle.
            send: Takes bytes for the ground station.
            parameters: Those that are not ArduSub's own defaults.
            binary: ArduSub, built for SITL.
            home: Degrees of latitude and longitude of the world's origin; its surface is at sea level, above
                which the process knows no water.
            folder: Where it leaves what it says; one that is forgotten with it unless given.
        """
        if not binary:
            raise ValueError("binary: expected an ArduSub built for SITL. Set DREAM_ARDUSUB_SITL")
        self.tank, self._send = tank, send
        self._stack = contextlib.ExitStack()
        self._time = 0.0
        self._heard = b""
        self._pulses = [NEUTRAL_PWM] * 16
        self._before = self._placed()
        try:
            self._begin(binary, parameters, home, folder)
        except BaseException:
            self.close()
            raise

    @property
    def pulses(self) -> list[int]:
        """Microseconds to each motor."""
        return [p if 1000 < p < 2000 else NEUTRAL_PWM for p in self._pulses[: self._count]]

    @property
    def commands(self) -> Float64Array:
        """(n,) to the thrusters of the tank."""
        return motors.commands(self.pulses)

    @property
    def tilt(self) -> float:
        """Radians that the camera looks up."""
        pulse = self._pulses[TILT_CHANNEL - 1]
        return TILT_RANGE * (pulse - NEUTRAL_PWM) / HALF_PWM if pulse > 900 else 0.0

    def hear(self, data: bytes, sender: Address | None = None) -> None:
        """Bytes from a ground station; it reads them in the next beat."""
        self._heard += data

    def beat(self) -> None:
        """After each beat of the tank: four steps."""
        if self._heard:
            self._link.sendall(self._heard)
            self._heard = b""
        before, after = self._before, self._placed()
        if before[6:] @ after[6:] < 0.0:
            before[6:] *= -1.0
        imu = self.tank.imu
        (p, q, r), (fx, fy, fz) = imu.angular_velocity.tolist(), imu.specific_force.tolist()
        felt = {"gyro": [p, -q, -r], "accel_body": [fx, -fy, -fz]}
        for k in range(1, FRAMES + 1):
            self._time += FRAME
            now = before + k / FRAMES * (after - before)
            told = {
                "timestamp": round(self._time, 9),
                "imu": felt,
                "position": now[:3].tolist(),
                "quaternion": (now[6:] / np.linalg.norm(now[6:])).tolist(),
                "velocity": now[3:6].tolist(),
                "no_time_sync": 1,
            }
            text = json.dumps(told, separators=(", ", ":"))
            self._physics.sendto(f"\n{text}\n".encode(), self._peer)
            self._step()
        self._before = after
        with contextlib.suppress(BlockingIOError):
            while data := self._link.recv(MOST_BYTES, socket.MSG_DONTWAIT):
                self._send(data, None)
        if self.tank.held and any(abs(pulse - NEUTRAL_PWM) > STIRRED for pulse in self.pulses):
            self.tank.release()

    def close(self) -> None:
        """End it."""
        self._stack.close()

    @property
    def _count(self) -> int:
        return self.tank.vehicle.thrusters.count

    def _placed(self) -> Float64Array:
        """(10,) position and velocity, north-east-down, and wxyz of forward-right-down in that."""
        state = self.tank.state
        (x, y, z), (vx, vy, vz) = state.position.tolist(), state.velocity_world.tolist()
        w, i, j, k = state.wxyz.tolist()
        s = math.sqrt(0.5)
        wxyz = np.array([s * (w + k), s * (i + j), s * (i - j), s * (w - k)])
        return np.array([y, x, -z, vy, vx, -vz, *wxyz])

    def _begin(
        self, binary: str, parameters: Mapping[str, float], home: tuple[float, float], folder: Path | None
    ) -> None:
        stack = self._stack
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="sitl-")))
        (folder / "defaults.parm").write_text("".join(f"{name} {v:g}\n" for name, v in parameters.items()))
        self._physics = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        listener = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        for one in (self._physics, listener):
            one.bind(("127.0.0.1", 0))
            one.settimeout(PATIENCE)
        listener.listen(1)
        physics, link = (one.getsockname()[1] for one in (self._physics, listener))
        log = stack.enter_context((folder / "log.txt").open("wb"))
        words = ["--model", "JSON:127.0.0.1", "--sim-port-out", physics, "--defaults", "defaults.parm"]
        words += ["--home", f"{home[0]},{home[1]},0,0", "--start-time", 1_700_000_000]
        words += ["--serial0", f"tcpclient:127.0.0.1:{link}"]
        for port in (1, 2, 4, 5, 6, 7, 8):
            words += [f"--serial{port}", "none:"]
        # A port that is taken: so it opens none for a joystick.
        words += ["--rc-in-port", physics]
        self._process = subprocess.Popen(
            [str(Path(binary).resolve()), *map(str, words)],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        stack.callback(self._process.wait)
        stack.callback(self._process.kill)
        try:
            self._link = stack.enter_context(listener.accept()[0])
        except TimeoutError as error:
            raise self._silent(error) from error
        self._link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._step()

    def _step(self) -> None:
        """Wait until it has made its step, and keep what it tells its motors."""
        try:
            data, self._peer = self._physics.recvfrom(256)
        except TimeoutError as error:
            raise self._silent(error) from error
        magic, _, _ = struct.unpack_from("<HHI", data)
        self._pulses = list(struct.unpack_from(f"<{SERVOS[magic]}H", data, 8))

    def _silent(self, error: OSError) -> OSError:
        return OSError(
            f"sitl: expected an answer within {PATIENCE:g} s; it ended with {self._process.poll()}: {error}"
        )
