from __future__ import annotations

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from dream.geometry import Bounds
from dream.robots.bluerov2.check import LOGGED, Finding, Seen, findings
from dream.robots.bluerov2.devices import DENSITY, Devices, dvl_at
from dream.robots.bluerov2.dvl_a50 import SOUND_FRESH, Config, sound_in
from dream.robots.bluerov2.limits import Limits
from dream.robots.bluerov2.parameters import Check, rules
from dream.robots.bluerov2.telemetry import Telemetry

LIMITS = Limits(area=Bounds(-2.0, -2.0, 2.0, 2.0))
WELL_SET = Config(
    speed_of_sound=1480.0, mounting_rotation_offset=0.0, acoustic_enabled=True, range_mode="auto"
)
TIMEOUT = rules(255)[3]

LYING = Telemetry(
    time=10.0,
    mode="MANUAL",
    voltage=16.0,
    depth=0.4,
    own_altitude=-0.3,
    version="4.5.6",
    heartbeat_age=0.5,
    imu_age=0.02,
    attitude_age=0.02,
    pressure_age=0.05,
    own_altitude_age=0.1,
)
SEEN = Seen(frames=60, seconds=3.0, age=0.05)


@dataclass
class Sonar:
    """A DVL that is well."""

    connected: bool = True
    age: float = 0.1
    hot: bool = False
    problem: str = ""
    config: Config | None = WELL_SET


@dataclass
class Found:
    """A vehicle that lies still in fresh water, and all is well."""

    telemetry: Telemetry = LYING
    busy: str = ""
    timeout: float = 1.0
    sonar: Sonar = field(default_factory=Sonar)
    seen: Seen = SEEN
    aligned: str = ""
    sound: tuple[float, float] = SOUND_FRESH
    free: int = 10 << 30
    zeroed_here: bool = False

    def list(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Finding]:
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=self.free))
        checks: list[Check] = [TIMEOUT.check(TIMEOUT.name, self.timeout)]
        found = findings(
            self.telemetry,
            self.busy,
            checks,
            self.sonar,
            self.seen,
            self.aligned,
            LIMITS,
            folder,
            self.sound,
            zeroed_here=self.zeroed_here,
        )
        assert len({finding.name for finding in found}) == len(found)
        return {finding.name: finding for finding in found}


def test_where_all_is_well_every_item_says_what_was_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Found().list(tmp_path, monkeypatch)
    assert {name: finding.said for name, finding in found.items()} == {
        "link": "heartbeat 0.5 s old, 0.0% of the packets missing",
        "autopilot": "4.5.6",
        "mode": "MANUAL, disarmed",
        "nobody else": "nobody else drives it",
        "FS_PILOT_TIMEOUT": "1",
        "inertial unit": "sample 0.02 s old, attitude 0.02 s",
        "depth": "0.40 m, 0.1 s old",
        "battery": "16.0 V",
        "hull": "dry",
        "DVL": "report 0.1 s old",
        "speed of sound": "1480 m/s, all velocities are -0.1% off",
        "camera": "20 frames a second, the newest 0.05 s old",
        "navigation": "begins: all sensors agree that the vehicle lies still",
        "disk": "10.0 GiB free",
    }
    assert all(finding.ok for finding in found.values())


def told(**changes: object) -> Callable[[Found], Found]:
    return lambda found: replace(found, telemetry=replace(found.telemetry, **changes))  # type: ignore[arg-type]


def lying(depth: float, own_altitude: float, *, zeroed_here: bool = True) -> Callable[[Found], Found]:
    return lambda found: replace(
        found,
        telemetry=replace(found.telemetry, depth=depth, own_altitude=own_altitude),
        zeroed_here=zeroed_here,
    )


def heard(**changes: object) -> Callable[[Found], Found]:
    return lambda found: replace(found, sonar=replace(found.sonar, **changes))  # type: ignore[arg-type]


def but(**changes: object) -> Callable[[Found], Found]:
    return lambda found: replace(found, **changes)  # type: ignore[arg-type]


def sounding(speed: float | None) -> Callable[[Found], Found]:
    return heard(config=WELL_SET.model_copy(update={"speed_of_sound": speed}))


TURNED = "the DVL: expected mounting_rotation_offset 0°, got 90°. One of both is to be changed"
RIVAL = "another station uses our system id 255: HEARTBEAT from its component 190. Close it"


@pytest.mark.parametrize(
    ("name", "change", "said", "wanted"),
    [
        ("link", told(heartbeat_age=4.0), "heartbeat 4.0 s old", "a heartbeat every second"),
        ("link", told(heartbeat_age=math.inf), "heartbeat inf s old", "Look at the tether"),
        ("link", told(loss=0.08), "8.0% of the packets missing", "at most 5% missing"),
        ("autopilot", told(version=""), "no version", "ArduSub 4.1 or newer"),
        ("mode", told(armed=True), "MANUAL, armed", "a vehicle that is disarmed"),
        ("nobody else", but(busy=RIVAL), RIVAL, "no station with our id"),
        ("FS_PILOT_TIMEOUT", but(timeout=3.0), "3", "1 at most; --set-parameters makes it 1"),
        ("FS_PILOT_TIMEOUT", but(timeout=math.nan), "not there", "seconds until then"),
        ("inertial unit", told(imu_age=0.3), "sample 0.30 s old", "RAW_IMU and ATTITUDE at 50 Hz"),
        ("inertial unit", told(attitude_age=0.6), "attitude 0.60 s", "RAW_IMU and ATTITUDE at 50 Hz"),
        ("depth", told(pressure_age=2.0), "0.40 m, 2.0 s old", "a Bar30 that agrees with it"),
        ("depth", lying(math.nan, -0.4), "nan m", "--surface-pressure"),
        ("depth", told(own_altitude_age=1.5), "the autopilot does not tell its own", "GLOBAL_POSITION_INT"),
        ("depth", lying(0.0, math.nan), "the autopilot does not tell its own", "GLOBAL_POSITION_INT"),
        ("battery", told(voltage=13.9), "13.9 V", "14.4 V or more"),
        # With less than the reserve a mission would turn home before its first step.
        ("battery", told(voltage=14.35), "14.3 V", "14.4 V or more"),
        ("battery", told(battery=0.2), "16.0 V, 20% left", "above 20%"),
        ("battery", told(voltage=math.nan), "unknown", "14.4 V or more"),
        ("hull", told(leak=True), "water!", "a dry hull"),
        ("DVL", heard(connected=False, problem="no connection to it"), "no connection to it", "an A50 that"),
        ("DVL", heard(age=1.5), "report 1.5 s old", "an A50 that pings"),
        ("DVL", heard(hot=True, problem="it is too hot"), "it is too hot", "below 45 °C"),
        ("DVL", heard(problem=TURNED), TURNED, "tells how it is set"),
        ("DVL", heard(config=None), "it does not tell its settings", "tells how it is set"),
        ("speed of sound", sounding(1520.0), "1520 m/s, all velocities are +2.6% off", "1481 m/s in this"),
        ("speed of sound", sounding(None), "the DVL does not tell it", "set speed_of_sound of the DVL"),
        ("speed of sound", heard(config=None), "the DVL does not tell it", "or --water"),
        ("camera", but(seen=Seen(9, 3.0, 0.1)), "3 frames a second", "five frames a second or more"),
        ("camera", but(seen=Seen(0, 0.0, math.inf)), "0 frames a second", "five frames a second or more"),
        ("camera", but(seen=Seen(60, 3.0, 0.7)), "the newest 0.70 s old", "Is the stream sent"),
        ("camera", but(seen=Seen(60, 3.0, 0.1, "no picture")), "no picture", "Is the stream sent"),
        ("navigation", but(aligned="it moves"), "it moves", "a vehicle that lies still"),
        ("disk", but(free=int(3600 * LOGGED) - 1), "4.7 GiB free", "4.7 GiB or more for the log of 60 min"),
        (
            "depth",
            lying(0.0, own_altitude=-0.9),
            "0.00 m, 0.1 s old, but 0.90 m by the autopilot",
            "lay the v",
        ),
        ("depth", lying(0.0, own_altitude=0.4), "but -0.40 m by the autopilot", "--surface-pressure in hPa"),
        (
            "depth",
            lying(0.0, own_altitude=-0.9, zeroed_here=False),
            "0.00 m, 0.1 s old, but 0.90 m by the autopilot",
            "SCALED_PRESSURE2 from outside the hull",
        ),
        ("depth", lying(-0.25, 0.25, zeroed_here=False), "-0.25 m", "a Bar30 that agrees with it"),
        # The barometer of an autopilot that is SCALED_PRESSURE2, within the hull: sealed, soft, and warm.
        (
            "depth",
            lying(0.0, -0.92, zeroed_here=False),
            "0.00 m, 0.1 s old, but 0.92 m",
            "from outside the hull",
        ),
        (
            "depth",
            lying(0.1, -1.2, zeroed_here=False),
            "0.10 m, 0.1 s old, but 1.20 m",
            "from outside the hull",
        ),
        (
            "depth",
            lying(0.3, -0.62, zeroed_here=False),
            "0.30 m, 0.1 s old, but 0.62 m",
            "from outside the hull",
        ),
    ],
)
def test_what_is_not_well_says_what_was_found_and_what_is_wanted(
    name: str,
    change: Callable[[Found], Found],
    said: str,
    wanted: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found = change(Found()).list(tmp_path, monkeypatch)
    assert not found[name].ok
    assert said in found[name].said
    assert wanted in found[name].wanted
    others = {other for other, finding in found.items() if not finding.ok} - {name}
    # A DVL that does not tell its settings does not tell its speed of sound either.
    assert others <= ({"DVL", "speed of sound"} if change(Found()).sonar.config is None else set())


@pytest.mark.parametrize("zeroed_here", [True, False])
@pytest.mark.parametrize(("depth", "own_altitude"), [(0.0, -0.2), (0.9, -0.65), (-0.1, -0.05)])
def test_the_depth_is_well_where_it_is_about_the_autopilots(
    depth: float, own_altitude: float, zeroed_here: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = lying(depth, own_altitude, zeroed_here=zeroed_here)(Found())
    assert found.list(tmp_path, monkeypatch)["depth"].ok


@pytest.mark.parametrize(
    ("water", "speed", "ok"),
    [
        ("fresh", 1452.0, True),
        ("fresh", 1450.0, False),
        ("fresh", 1510.0, True),
        ("fresh", 1512.0, False),
        ("sea", 1471.0, True),
        ("sea", 1469.0, False),
        ("sea", 1560.0, True),
        ("sea", 1562.0, False),
    ],
)
def test_two_percent_of_velocity_are_borne(
    water: str, speed: float, ok: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = replace(sounding(speed)(Found()), sound=sound_in(DENSITY[water]))
    assert found.list(tmp_path, monkeypatch)["speed of sound"].ok == ok


def test_in_the_sea_its_whole_range_is_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = replace(sounding(1515.0)(Found()), sound=sound_in(DENSITY["sea"]))
    finding = found.list(tmp_path, monkeypatch)["speed of sound"]
    assert (finding.ok, finding.said) == (True, "1515 m/s")
    assert "1500 to 1530 m/s" in finding.wanted


@pytest.mark.parametrize(
    ("address", "at"),
    [("192.168.2.95", ("192.168.2.95", 16171)), ("dvl.local:16172", ("dvl.local", 16172))],
)
def test_a_dvl_is_at_a_host_and_a_port(address: str, at: tuple[str, int]) -> None:
    assert dvl_at(address) == at


@pytest.mark.parametrize("address", ["", ":16171", "host:", "host:a50", "host:0", "host:65536", "host:-1"])
def test_a_dvls_address_that_is_none_is_told(address: str) -> None:
    with pytest.raises(ValueError, match=f"--dvl: expected HOST or HOST:PORT .* got {address}"):
        dvl_at(address)


@pytest.mark.parametrize(
    ("dvl", "why"),
    [
        (SimpleNamespace(hot=False, problem="no velocity", misread=""), ""),
        (SimpleNamespace(hot=True, problem="it is too hot", misread=""), "it is too hot"),
        (SimpleNamespace(hot=False, problem=TURNED, misread=TURNED), TURNED),
    ],
)
def test_a_dive_ends_for_heat_and_for_other_settings(dvl: SimpleNamespace, why: str) -> None:
    devices = Devices.__new__(Devices)
    devices.dvl = dvl  # type: ignore[assignment]
    assert devices.failing() == why
