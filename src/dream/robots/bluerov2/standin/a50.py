"""Pings → lines of JSON over TCP: a Water Linked DVL A50."""

from __future__ import annotations

import heapq
import json
import math
import re
import socket
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from dream.geometry import wrap_angle
from dream.robots.bluerov2.standin.memory import MemoryStream
from dream.robots.bluerov2.standin.tank import Tank
from dream.robots.bluerov2.threads import Threads
from dream.sim.sensors import RANGE_MODES, Ping

Float64Array = npt.NDArray[np.float64]
Json = dict[str, Any]

FORMAT = "json_v3.3"
FLIP = np.array([1.0, -1.0, -1.0])
"""Forward-left-up to forward-right-down, and back."""
RESET_TAKES = 0.05
"""Seconds until a reset of dead reckoning shows."""
CALIBRATION_TAKES = 5.0
"""Seconds that a calibration of the gyroscopes takes; at most 15 on the instrument."""
LOCAL_EVERY = 0.2
"""Seconds between two reports of dead reckoning."""
WATER_ALTITUDE = 4.5
"""Metres above the ground from which on it can track the water."""
WATER_EVERY = 0.5
"""Seconds between two reports of water track."""
QUEUE = 15
"""Triggered pings that may wait."""
DRIFT = math.radians(0.2) / 60.0
"""rad/s by which the yaw of its dead reckoning drifts: 0.1 to 0.3° a minute after calibration."""
MOST_LINE = 1 << 16
"""Bytes of a command; a client that sends a longer one is cut off."""
MOST_BEHIND = 1 << 20
"""Bytes that a client may leave unread; one that leaves more is cut off."""
MOST_CLIENTS = 16
GARBAGE = ("half", "text", "huge", "nan", "types")
"""Lines that are no reports: a report broken off, no JSON, two megabytes, NaN for numbers, wrong types."""
HUGE = 1 << 21
RANGES: dict[str, tuple[float, float]] = {
    "speed_of_sound": (1000.0, 2000.0),
    "mounting_rotation_offset": (0.0, 360.0),
}
FLAGS = ("acoustic_enabled", "dark_mode_enabled", "periodic_cycling_enabled")


@dataclass(frozen=True, slots=True)
class DvlFaults:
    """How it errs; may be replaced at any time."""

    silent: bool = False
    """Nothing is sent, but connections stay."""
    garbage: str = ""
    """One of `GARBAGE`, or "all" for one after the other: such a line before each velocity report."""
    hot: bool = False
    """About to shut down: bit 0 of the status."""
    lost: bool = False
    """No ping has bottom lock."""
    altitude_stuck: float | None = None
    """Metres that it says, whatever the altitude is."""
    altitude_factor: float = 1.0
    """By which every altitude is multiplied."""
    outliers: float = 0.0
    """Share of the pings whose altitude is multiplied by `outlier_factor`."""
    outlier_factor: float = 10.0
    false_bottom: float | None = None
    """Metres above the ground of something that sends the echo back instead; it is not there for a vehicle
    that is lower."""
    false_share: float = 0.5
    """Share of the pings that it sends back."""
    velocity_frozen: bool = False
    """Every velocity is the last one before, with new stamps, and valid."""
    bottom_moves: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m/s in the world at which that moves which sends the echoes back."""
    latency: float = 0.0
    """Seconds that reports take beyond what their stamps tell."""
    merit: float | None = None
    """m/s that it says as figure of merit, whatever it is."""

    def __post_init__(self) -> None:
        if self.garbage not in ("", "all", *GARBAGE):
            raise ValueError(f"faults.garbage: expected one of {('all', *GARBAGE)}, got {self.garbage!r}")
        for name in ("outliers", "false_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"faults.{name}: expected a share, got {getattr(self, name)}")
        for name in ("altitude_stuck", "altitude_factor", "outlier_factor", "false_bottom"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < math.inf:
                raise ValueError(f"faults.{name}: expected a number above 0, got {value}")
        for name in ("latency", "merit"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < math.inf:
                raise ValueError(f"faults.{name}: expected 0 or more, got {value}")
        if len(self.bottom_moves) != 3 or not np.isfinite(self.bottom_moves).all():
            raise ValueError(f"faults.bottom_moves: expected three finite m/s, got {self.bottom_moves}")


class A50:
    """A server of the A50's JSON protocol, over the pings of a tank.

    What it does: pings at the rate of the range mode for its altitude, sends a `velocity` report to all who
    are connected once the ping's report can be there, `position_local` five times a second, and a `response`
    to each command. Velocities are those of the DVL's origin over ground, forward-right-down, in its own
    frame, or in the vehicle's with a `mounting_rotation_offset` (clockwise, seen from above). They scale
    with the configured speed of sound against the one of the tank's water.
    Reference: Water Linked, TCP JSON API json_v3.3 (docs.waterlinked.com), a protocol over port 16171.
    Assumes: the beams are numbered front left, rear left, rear right, front right; strengths are made up.
    A ping without lock reports zeros, and the last altitude.

    Its own dead reckoning integrates its own velocities with the true attitude and a yaw that drifts.
    """

    def __init__(
        self, tank: Tank, *, host: str | None = "127.0.0.1", port: int = 0, booted: float = 49.0
    ) -> None:
        """Listen.

        Args:
            tank: Whose pings.
            host: Where it listens; None for nowhere: then `attach` is the only way in.
            port: Likewise; 0 for any free one.
            booted: Seconds since it started, at the tank's start: its clock is arbitrary until it is set.
        """
        self.tank = tank
        self.faults = DvlFaults()
        self.config: Json = {
            "speed_of_sound": tank.conditions.dvl.sound_speed,
            "acoustic_enabled": True,
            "dark_mode_enabled": False,
            "mounting_rotation_offset": 0.0,
            "range_mode": "auto",
            "periodic_cycling_enabled": True,
        }
        self._server: socket.socket | None = None
        self.address: tuple[str, int] = ("", 0)
        """Where it listens; nowhere, without a host."""
        if host is not None:
            self._server = socket.create_server((host, port))
            self._server.setblocking(False)
            self.address = self._server.getsockname()[:2]
        self._luck = np.random.default_rng(0)
        """Of the faults, apart from that of the pings."""
        self._valid: tuple[Float64Array, Float64Array] | None = None
        """The last valid velocity and its covariance, as they were reported."""
        self._clients: list[_Client] = []
        self._offset = booted - tank.time
        self._ntp = ""
        self._next_ping = self._next_local = tank.time
        self._triggered = 0
        self._altitude = 0.0
        self._last_report = tank.time
        self._count = 0
        self._later: list[tuple[float, int, Callable[[], None]]] = []
        self._garbage = 0
        self._place, self._turned, self._reset_yaw = np.zeros(3), 0.0, 0.0
        self._fixed: tuple[float, Float64Array] | None = None
        self._variance = 0.0
        self._reset()

    @property
    def clients(self) -> int:
        """How many are connected."""
        return len(self._clients)

    @property
    def clock(self) -> float:
        """Seconds, as it counts them."""
        return self.tank.time + self._offset

    def jump_clock(self, seconds: float) -> None:
        """Its clock leaps."""
        self._offset += seconds

    def attach(self, threads: Threads) -> MemoryStream:
        """A connection without a network, as if one had connected: what a dive `dial`s on a rig.

        Args:
            threads: What the dive waits by. One that lets one thread run at a time: clients are not locked.
        """
        pipe = MemoryStream(threads)
        self._clients.append(_Client(pipe.far))
        return pipe

    def disconnect(self) -> None:
        """Cut all clients off."""
        for client in self._clients:
            client.close()
        self._clients = []

    def close(self) -> None:
        """Stop listening."""
        self.disconnect()
        if self._server is not None:
            self._server.close()

    def beat(self) -> None:
        """After each beat of the tank: ping, report, answer."""
        self._accept()
        for client in list(self._clients):
            for line in client.lines():
                self._command(client, line)
        now = self.tank.time
        self._sound(now)
        while self._later and self._later[0][0] <= now:
            heapq.heappop(self._later)[2]()
        if now >= self._next_local - 1e-9:
            self._next_local += LOCAL_EVERY
            self._tell(self._local())
        for client in self._clients:
            client.push()
        self._clients = [client for client in self._clients if client.open]

    # ------------------------------------------------------------------------------------ pings
    def _sound(self, now: float) -> None:
        if self.config["range_mode"] == "wt":
            if self.config["acoustic_enabled"] and now >= self._next_ping - 1e-9:
                self._next_ping = now + WATER_EVERY
                self._tell(self._water_report(self.tank.ping()))
            return
        if self.config["acoustic_enabled"]:
            self._triggered = 0
            due = now >= self._next_ping - 1e-9
        else:
            due = self._triggered > 0 and now >= self._next_ping - 1e-9
        if not due:
            return
        self._triggered = max(self._triggered - 1, 0)
        ping = self.tank.ping()
        if not math.isnan(ping.dvl.altitude):
            self._altitude = ping.dvl.altitude
        period = 1.0 / self._rate(ping.dvl.altitude)
        # On average, although pings are sent on a beat.
        self._next_ping = max(self._next_ping, now - period) + period
        self._at(ping.arrives, lambda: self._report(ping))

    def _rate(self, altitude: float) -> float:
        """Pings a second: of the range mode that is set, or of the first that reaches the altitude."""
        modes = _modes(self.config["range_mode"])
        return next((rate for top, rate in modes if altitude <= top), modes[-1][1])

    def _report(self, ping: Ping) -> None:
        faults = self.faults
        within = ping.dvl.altitude <= _modes(self.config["range_mode"])[-1][0]
        valid = ping.dvl.valid and within and not faults.lost
        velocity, covariance = np.zeros(3), np.zeros((3, 3))
        if valid:
            factor = self.config["speed_of_sound"] / self.tank.conditions.dvl.sound_speed
            c, s = _turn(math.radians(self.config["mounting_rotation_offset"]))
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) * FLIP
            velocity = factor * (turn @ (ping.dvl.velocity - self._in_dvl(faults.bottom_moves)))
            covariance = factor * factor * (turn @ ping.dvl.covariance @ turn.T)
        if faults.velocity_frozen and self._valid is not None:
            valid, (velocity, covariance) = True, self._valid
        if valid:
            self._valid = (velocity, covariance)
            self._reckon(ping.dvl.time, velocity, covariance)
        self._garble()
        report = self._velocity_report(ping, velocity, covariance, valid, "velocity", "bottom")
        report["altitude"] = self._echo(report["altitude"])
        if faults.merit is not None:
            report["fom"] = faults.merit
        if faults.latency > 0.0:
            self._at(self.tank.time + faults.latency, lambda: self._tell(report))
        else:
            self._tell(report)

    def _echo(self, altitude: float) -> float:
        """Metres that it says for an altitude."""
        faults = self.faults
        above = -1.0 if faults.false_bottom is None else altitude - faults.false_bottom
        if above > 0.0 and self._luck.random() < faults.false_share:
            altitude = above
        if faults.outliers > 0.0 and self._luck.random() < faults.outliers:
            altitude *= faults.outlier_factor
        altitude *= faults.altitude_factor
        return altitude if faults.altitude_stuck is None else faults.altitude_stuck

    def _in_dvl(self, velocity: npt.ArrayLike) -> Float64Array:
        """A velocity (3,) of the world in the DVL's axes, forward-left-up."""
        world = self.tank.T_world_base.rotation @ self.tank.conditions.dvl.T_base_dvl.rotation
        return np.asarray(world.T @ np.asarray(velocity, np.float64), np.float64)

    def _velocity_report(
        self, ping: Ping, velocity: Float64Array, covariance: Float64Array, valid: bool, kind: str, mode: str
    ) -> Json:
        now = self.tank.time
        since, self._last_report = now - self._last_report, now
        along = self.tank.conditions.dvl.beams @ np.nan_to_num(ping.dvl.velocity)
        transducers = []
        for k in range(4):
            heard = not math.isnan(ping.ranges[k]) and not self.faults.lost
            distance = float(ping.ranges[k]) if heard else 0.0
            transducers.append(
                {
                    "id": k,
                    "velocity": float(along[k]) if heard and valid else 0.0,
                    "distance": distance,
                    "rssi": -30.0 - 2.0 * distance if heard else -100.0,
                    "nsd": -90.0,
                    "beam_valid": heard,
                }
            )
        return {
            "time": 1000.0 * since,
            "vx": float(velocity[0]),
            "vy": float(velocity[1]),
            "vz": float(velocity[2]),
            "fom": math.sqrt(max(float(np.trace(covariance)), 0.0)),
            "covariance": covariance.tolist(),
            "altitude": self._altitude,
            "transducers": transducers,
            "velocity_valid": bool(valid),
            "status": int(self.faults.hot),
            "tracking_mode": mode,
            "format": FORMAT,
            "type": kind,
            "time_of_validity": round(1e6 * (ping.dvl.time + self._offset)),
            "time_of_transmission": round(1e6 * self.clock),
        }

    def _water_report(self, ping: Ping) -> Json:
        """Velocity through the water, which it has from some metres above the ground on."""
        valid = self._altitude >= WATER_ALTITUDE and ping.dvl.valid and not self.faults.lost
        if not math.isnan(ping.dvl.altitude):
            self._altitude = ping.dvl.altitude
        velocity, covariance = np.zeros(3), np.zeros((3, 3))
        if valid:
            water = self._in_dvl(self.tank.conditions.current.mean)
            velocity, covariance = FLIP * (ping.dvl.velocity - water), np.diag([1e-3, 1e-3, 1e-3])
        return self._velocity_report(ping, velocity, covariance, valid, "velocity_water", "water")

    # ------------------------------------------------------------------------------------ dead reckoning
    def _attitude(self) -> Float64Array:
        """(3, 3) from its own frame, forward-right-down, to a level north-east-down one."""
        to_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
        world = self.tank.T_world_base.rotation @ self.tank.conditions.dvl.T_base_dvl.rotation
        return np.asarray(to_ned @ world * FLIP, np.float64)

    def _since_reset(self) -> Float64Array:
        """(3, 3) from its own frame to the one that it had at the reset, levelled; yaw drifts."""
        c, s = _turn(DRIFT * (self.tank.time - self._turned) - self._reset_yaw)
        return np.asarray(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ self._attitude())

    def _reckon(self, time: float, velocity: Float64Array, covariance: Float64Array) -> None:
        moving = self._since_reset() @ velocity
        if self._fixed is not None:
            before, was = self._fixed
            dt = time - before
            self._place += 0.5 * dt * (was + moving)
            self._variance += dt * dt * float(np.trace(covariance))
        self._fixed = (time, moving)

    def _reset(self) -> None:
        rotation = self._attitude()
        self._reset_yaw = math.atan2(rotation[1, 0], rotation[0, 0])
        self._place, self._turned, self._fixed, self._variance = np.zeros(3), self.tank.time, None, 0.0

    def _local(self) -> Json:
        r = self._since_reset()
        return {
            "ts": self.clock,
            "x": float(self._place[0]),
            "y": float(self._place[1]),
            "z": float(self._place[2]),
            "std": math.sqrt(self._variance),
            "roll": math.degrees(math.atan2(r[2, 1], r[2, 2])),
            "pitch": math.degrees(-math.asin(min(max(r[2, 0], -1.0), 1.0))),
            "yaw": math.degrees(wrap_angle(math.atan2(r[1, 0], r[0, 0]))),
            "type": "position_local",
            "status": 0 if not self.faults.lost else 1,
            "format": FORMAT,
        }

    # ------------------------------------------------------------------------------------ commands
    def _command(self, client: _Client, line: bytes) -> None:
        try:
            asked = json.loads(line)
        except (ValueError, RecursionError):
            asked = None
        if not isinstance(asked, dict) or not isinstance(asked.get("command"), str):
            self._respond(client, "", error="expected a command")
            return
        name, values = asked["command"], asked.get("parameters") or {}
        handler = _COMMANDS.get(name)
        if handler is None:
            self._respond(client, name, error=f"unknown command {name[:40]}")
        elif not isinstance(values, dict):
            self._respond(client, name, error="expected parameters by name")
        else:
            handler(self, client, name, values)

    def _respond(self, client: _Client, to: str, result: Any = None, *, error: str = "") -> None:
        response = {
            "response_to": to,
            "success": not error,
            "error_message": error,
            "result": result,
            "format": FORMAT,
            "type": "response",
        }
        if not self.faults.silent:
            client.give(json.dumps(response).encode() + b"\r\n")

    def _do_reset(self, client: _Client, name: str, values: Json) -> None:
        self._respond(client, name)
        self._at(self.tank.time + RESET_TAKES, self._reset)

    def _do_calibrate(self, client: _Client, name: str, values: Json) -> None:
        self._at(self.tank.time + CALIBRATION_TAKES, lambda: self._respond(client, name))

    def _do_trigger(self, client: _Client, name: str, values: Json) -> None:
        if self.config["acoustic_enabled"]:
            self._respond(client, name, error="acoustic_enabled is true")
        elif self._triggered >= QUEUE:
            self._respond(client, name, error="the queue is full")
        else:
            self._triggered += 1
            self._respond(client, name)

    def _do_version(self, client: _Client, name: str, values: Json) -> None:
        about = {
            "chipid": "0x00000000stand-in",
            "hardware_revision": 6,
            "is_ready": True,
            "product_id": 15380,
            "product_name": "DVL A50",
            "variant": "Standard",
            "version": "2.7.2 (stand-in)",
            "version_short": "2.7.2",
        }
        self._respond(client, name, about)

    def _do_get_config(self, client: _Client, name: str, values: Json) -> None:
        self._respond(client, name, dict(self.config))

    def _do_set_config(self, client: _Client, name: str, values: Json) -> None:
        for key, value in values.items():
            problem = _config_problem(key, value)
            if problem:
                self._respond(client, name, error=problem)
                return
        self.config.update({key: float(v) if key in RANGES else v for key, v in values.items()})
        self._respond(client, name)

    def _do_set_ntp(self, client: _Client, name: str, values: Json) -> None:
        address = values.get("ntp_address")
        if not isinstance(address, str) or len(address) > 255:
            self._respond(client, name, error="expected an ntp_address")
            return
        self._ntp = address
        self._respond(client, name)

    def _do_get_ntp(self, client: _Client, name: str, values: Json) -> None:
        self._respond(client, name, {"ntp_address": self._ntp})

    def _do_set_time(self, client: _Client, name: str, values: Json) -> None:
        if self._ntp:
            self._respond(client, name, error="synchronised by NTP")
            return
        try:
            then = datetime.fromisoformat(str(values.get("now")).replace("Z", "+00:00"))
            if then.tzinfo is None:
                raise ValueError("no zone")
        except ValueError:
            self._respond(client, name, error="expected now as RFC 3339")
            return
        self._offset = then.timestamp() - self.tank.time
        self._respond(client, name)

    def _do_time_status(self, client: _Client, name: str, values: Json) -> None:
        status = {"ntp_synchronized": bool(self._ntp), "ntp_address": self._ntp, "unix_time": self.clock}
        self._respond(client, name, status)

    def _do_force_sync(self, client: _Client, name: str, values: Json) -> None:
        # That the command was understood says nothing: the inner success counts.
        self._respond(client, name, {"success": bool(self._ntp)})

    # ------------------------------------------------------------------------------------ connections
    def _at(self, time: float, what: Callable[[], None]) -> None:
        self._count += 1
        heapq.heappush(self._later, (time, self._count, what))

    def _accept(self) -> None:
        while self._server is not None and len(self._clients) < MOST_CLIENTS:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients.append(_Client(connection))

    def _tell(self, report: Json) -> None:
        self._raw(json.dumps(report).encode() + b"\r\n")

    def _raw(self, data: bytes) -> None:
        if not self.faults.silent:
            for client in self._clients:
                client.give(data)

    def _garble(self) -> None:
        kind = self.faults.garbage
        if kind == "all":
            kind = GARBAGE[self._garbage % len(GARBAGE)]
            self._garbage += 1
        if kind:
            self._raw(_garbage_line(kind))


class _Connection(Protocol):
    """As a socket that does not block."""

    def recv(self, most: int, /) -> bytes: ...
    def send(self, data: bytearray, /) -> int: ...
    def close(self) -> None: ...


class _Client:
    """A connection: what it has sent so far, and what it has not read yet."""

    __slots__ = ("_connection", "_heard", "_unsent", "open")

    def __init__(self, connection: _Connection) -> None:
        self._connection = connection
        self._heard, self._unsent = bytearray(), bytearray()
        self.open = True

    def lines(self) -> list[bytes]:
        """What has been sent since, line by line."""
        try:
            data = self._connection.recv(MOST_LINE)
            if not data:
                self.close()
        except BlockingIOError:
            return []
        except OSError:
            self.close()
            return []
        self._heard += data
        *lines, rest = bytes(self._heard).split(b"\n")
        self._heard = bytearray(rest)
        if len(rest) > MOST_LINE:
            self.close()
        return [line for line in lines if line.strip()]

    def give(self, data: bytes) -> None:
        """To be sent."""
        if len(self._unsent) > MOST_BEHIND + HUGE:
            self.close()
        else:
            self._unsent += data

    def push(self) -> None:
        """Send what it takes."""
        if not self._unsent or not self.open:
            return
        try:
            del self._unsent[: self._connection.send(self._unsent)]
        except BlockingIOError:
            return
        except OSError:
            self.close()

    def close(self) -> None:
        self.open = False
        self._connection.close()


def _turn(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def _modes(name: str) -> tuple[tuple[float, float], ...]:
    """Greatest altitude and rate of the range modes that a range_mode lets it use; none where it means none.

    "auto" is all, "=a" one, and "a<=b" those from a to b.
    """
    if name == "auto":
        return RANGE_MODES
    found = re.fullmatch(r"=([0-4])|([0-4])<=([0-4])", name)
    if found is None:
        return ()
    first, last = int(found[1] or found[2]), int(found[1] or found[3])
    return RANGE_MODES[first : last + 1]


def _config_problem(key: str, value: Any) -> str:
    """What is wrong with a value; empty where nothing is."""
    if key in FLAGS:
        return "" if isinstance(value, bool) else f"{key}: expected true or false"
    if key in RANGES:
        low, high = RANGES[key]
        fits = isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high
        return "" if fits else f"{key}: expected {low:g} to {high:g}"
    if key == "range_mode":
        known = isinstance(value, str) and (value == "wt" or bool(_modes(value)))
        return "" if known else "range_mode: expected auto, wt, =a or a<=b with modes from 0 to 4"
    return f"unknown parameter {str(key)[:40]}"


def _garbage_line(kind: str) -> bytes:
    if kind == "half":
        return b'{"time": 106.3, "vx": -0.003, "vy": 0.00\r\n'
    if kind == "text":
        return b"\xff\xfe no JSON at all \x00\r\n"
    if kind == "huge":
        return b'{"type": "velocity", "note": "' + b"x" * HUGE + b'"}\r\n'
    report: Json = {
        "time": math.nan,
        "vx": math.nan,
        "vy": math.inf,
        "vz": 0.0,
        "fom": math.nan,
        "covariance": [[math.nan] * 3] * 3,
        "altitude": math.nan,
        "transducers": [],
        "velocity_valid": True,
        "status": 0,
        "format": FORMAT,
        "type": "velocity",
        "time_of_validity": 0,
        "time_of_transmission": 0,
    }
    if kind == "types":
        report |= {"vx": "0.1", "vy": None, "fom": [], "covariance": "none", "velocity_valid": "yes"}
        report |= {"time": {}, "altitude": True, "time_of_validity": "now"}
    return json.dumps(report).encode() + b"\r\n"


_COMMANDS: dict[str, Callable[[A50, _Client, str, Json], None]] = {
    "reset_dead_reckoning": A50._do_reset,
    "calibrate_gyro": A50._do_calibrate,
    "trigger_ping": A50._do_trigger,
    "get_version_info": A50._do_version,
    "get_config": A50._do_get_config,
    "set_config": A50._do_set_config,
    "set_time_ntp": A50._do_set_ntp,
    "get_time_ntp": A50._do_get_ntp,
    "set_time_manual": A50._do_set_time,
    "get_time_status": A50._do_time_status,
    "force_sync_ntp": A50._do_force_sync,
}
