"""What reads outside input, given bytes that are nearly right: each is taken, or refused by an error of ours.

    python -m tests.fuzz --seconds 600 --seed 0        all readers in turn; what goes wrong is kept in fuzz/
    python -m tests.fuzz --only survey map             those whose names begin so
    python -m tests.fuzz --replay fuzz/map-001         one input again

A reader of outside input joins `KINDS`: valid bytes to begin with, what reads them, and what it may raise.
"""

from __future__ import annotations

import argparse
import io
import itertools
import logging
import os
import pickle
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import warnings
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

import numpy as np

SLICE_S = 2.0
"""Each reader is tried so long in turn."""
LIMIT_S = 10.0
"""A reader that takes longer hangs."""
MOST_MEMORY = 6 << 30
"""Bytes of address space; a reader that asks for more is told at once."""
WORDS = (
    *(b"nan", b"-1", b"1e999", b"-0", b"0", b"99999999999999999999", b"null", b"true", b'""', b"[]", b"{}"),
    *(b"\x00", b"\xff\xfe", b"\xef\xbb\xbf", b"\x1b[2J", b"\\u0000", b"\n", b",", b'"', b"../../etc/passwd"),
)
"""What stands where a number stood, or anywhere."""


class Hung(BaseException):
    """Not an error that a reader could catch and take for damage."""


@dataclass(frozen=True, slots=True)
class Kind:
    """One reader."""

    seeds: Callable[[Path], list[bytes]]
    """Valid inputs; what else the reader needs is put into the folder."""
    read: Callable[[bytes, Path], object]
    """Read all of an input."""
    accepted: tuple[type[BaseException], ...] = (ValueError, OSError)
    """Clear errors of ours, and of the system."""


@dataclass(frozen=True, slots=True)
class Finding:
    """An input that was neither taken nor refused by an error of ours."""

    kind: str
    data: bytes
    error: str


# Readers. Each imports what it needs, so that one alone is quick.


def _file(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    """A reader of a file in the folder."""

    def reading(data: bytes, folder: Path) -> object:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        found = read(path)
        return list(found) if isinstance(found, Iterator) else found

    return reading


def _world(name: str) -> Kind:
    from dream.sim.files import load_world, save_world
    from dream.sim.worlds import make_world

    def seeds(folder: Path) -> list[bytes]:
        save_world(make_world("pool/arc", 1), folder / "world")
        return [(folder / "world" / name).read_bytes()]

    return Kind(seeds, _file(f"world/{name}", lambda path: load_world(path.parent)))


def _run(name: str) -> Kind:
    from dream.recording import read_config, read_steps, read_summary, record, write_config, write_summary
    from tests.recorded_runs import CONFIG, SUMMARY, painted_coverage, painted_mission

    def seeds(folder: Path) -> list[bytes]:
        run = folder / "run"
        run.mkdir()
        write_config(run, CONFIG)
        write_summary(run, SUMMARY)
        for _ in record(painted_mission(2), run, annotate=painted_coverage):
            pass
        return [(run / name).read_bytes()]

    readers = {"config.json": read_config, "steps.jsonl": read_steps, "summary.json": read_summary}
    return Kind(seeds, _file(f"run/{name}", lambda path: readers[name](path.parent)))


def _replies() -> Kind:
    from dream.recording import read_exchanges, record
    from tests.recorded_runs import exchange, painted_mission

    def seeds(folder: Path) -> list[bytes]:
        run = folder / "run"
        run.mkdir()
        (step,) = painted_mission(1)
        answered = exchange(pictures={"map": b"a picture"}, answered_by="painted-1", outcome="followed")
        lacks = ("no JSON object", "step_m: Field required")
        failed = exchange(replies=("Left.", "{}"), lacks=lacks, fallback="invalid", requests=2, cost_usd=None)
        asked = replace(step, decision=replace(step.decision, exchanges=(answered, failed)))
        for _ in record([asked], run):
            pass
        paths = [run / "replies" / name for name in ("0000.json", "0000-2.json")]
        found = [path.read_bytes() for path in paths]
        paths[1].unlink()
        return found

    return Kind(seeds, _file("run/replies/0000.json", lambda path: read_exchanges(path.parents[1], 0)))


def _cassette() -> Kind:
    from dream.planning.vlm.asking.cassette import keep, play, prepare
    from dream.planning.vlm.asking.question import RawAnswer

    outcomes = (
        RawAnswer(('{"direction": "left"}',), "", 1, 2500, 210, 0.0075, 3.25, "painted-1"),
        RawAnswer((), "timeout: no answer within 60 s", 1, cost_usd=None, seconds=60.0),
    )

    def seeds(folder: Path) -> list[bytes]:
        prepare(folder)
        found = []
        for outcome in outcomes:
            keep(folder, "seed", outcome, "dream 1", "Where to?", {"map": b"a picture"})
            found.append((folder / "seed.json").read_bytes())
        return found

    return Kind(seeds, _file("kept.json", lambda path: play(path.parent, path.stem, "dream 1")))


def _map() -> Kind:
    from dream.mapping import OccupancyMap
    from tests.recorded_runs import painted_mission

    def seeds(folder: Path) -> list[bytes]:
        *_, last = painted_mission(2)
        last.occupancy.save(folder / "map.npz")
        return [(folder / "map.npz").read_bytes()]

    return Kind(seeds, _file("map.npz", OccupancyMap.load))


def _volume() -> Kind:
    from dream.geometry import SE3, camera_mount
    from dream.mapping.volume import Volume
    from dream.protocol import DREAM_V2

    def seeds(folder: Path) -> list[bytes]:
        camera = DREAM_V2.camera
        depth, labels = (np.full((camera.height, camera.width), value) for value in (3.0, 2))
        volume = Volume(DREAM_V2)
        volume.integrate(
            depth, labels.astype(int), camera, SE3.level(0.0, 0.0, -5.0, 0.0) @ camera_mount(0.3)
        )
        volume.save(folder / "volume.npz")
        return [(folder / "volume.npz").read_bytes()]

    return Kind(seeds, _file("volume.npz", Volume.load))


def _observation() -> Kind:
    from dream.protocol import DREAM_V1
    from dream.robots.replay import keep, read
    from tests.recorded_runs import painted_mission

    def seeds(folder: Path) -> list[bytes]:
        for _ in keep(painted_mission(1), folder, DREAM_V1):
            pass
        return [path.read_bytes() for path in sorted((folder / "observations").iterdir())]

    return Kind(seeds, _file("0000.npz", read))


def _prior() -> Kind:
    from dream.geometry import Bounds
    from dream.mapping.prior import Prior

    bounds = Bounds(0.0, 0.0, 2.0, 1.0)

    def seeds(folder: Path) -> list[bytes]:
        cells = np.linspace(0.0, 1.0, 32, dtype=np.float32).reshape(4, 8)
        Prior(bounds, 0.25, cells, cells > 0.5, 0.1, 1.0, "survey 1").save(folder / "prior.npz")
        return [(folder / "prior.npz").read_bytes()]

    about = {"sigma": 0.1, "years": 1.0, "source": "survey 1"}
    return Kind(seeds, _file("prior.npz", lambda path: Prior.load(path, about, bounds, 0.25)))


def _space() -> Kind:
    from dream.scene import encoded, load, made, mapped, save
    from dream.scene.parts import Path as Way
    from tests.scene.test_building import ABOUT, ball, targets

    def seeds(folder: Path) -> list[bytes]:
        one, at = ball(3, (2.0, 2.0, -5.0)), np.arange(3)
        way = Way(
            at.astype(np.int32),
            np.zeros((3, 3), np.float32),
            np.zeros(3, np.float32),
            np.zeros(3, np.float32),
            at > 1,
        )
        scene = made(
            **ABOUT,
            targets=targets(one, np.zeros(len(one), int), 1),
            obstacles=one + 3.0,
            voxels=mapped(0.5, np.column_stack([at, at, at]) * 0.5, at > 0, at, at - 1),
            path=way,
        )
        save(scene, folder / "space.npz")
        return [(folder / "space.npz").read_bytes()]

    return Kind(seeds, _file("space.npz", lambda path: encoded(load(path))))


def _lesson() -> Kind:
    from dream.learning import rollouts

    def seeds(folder: Path) -> list[bytes]:
        images, odds = np.zeros((3, 2, 72, 96), np.uint8), np.full((3, 7), 1 / 7, np.float32)
        rollouts.write(folder / "lesson.npz", rollouts.Frames(images, odds))
        return [(folder / "lesson.npz").read_bytes()]

    return Kind(seeds, _file("lesson.npz", rollouts.read), accepted=())


def _survey() -> Kind:
    from dream.survey import files
    from tests.survey.scenes import reef, wreck

    return Kind(
        lambda _: [files.dumped(reef()), files.dumped(wreck())], lambda data, _: files.loaded(data, "x")
    )


def _geopackage() -> Kind:
    from dream.survey.archive import open_archive
    from tests.survey.scenes import reef

    def seeds(folder: Path) -> list[bytes]:
        with open_archive(str(folder / "seed.gpkg"), begin=True) as archive:
            archive.add(reef())
        return [(folder / "seed.gpkg").read_bytes()]

    def read(path: Path) -> None:
        with open_archive(str(path)) as archive:
            for entry in archive.entries():
                archive.get(entry.number)

    return Kind(seeds, _file("surveys.gpkg", read))


def _site() -> Kind:
    from dream.survey.site import read_site

    seed = b'{"name": "Bay", "latitude": 37.1, "longitude": -76.2, "heading_deg": 10.0, "datum": "sea"}'
    return Kind(lambda _: [seed], _file("site.json", read_site))


def _suite() -> Kind:
    from dream.evaluation.suites import read_suite

    return Kind(lambda _: [b"reef/string 1..3\nwreck/1 2 start 1  # remark\n"], _file("mine.txt", read_suite))


def _results(name: str) -> Kind:
    from dream.evaluation.results import read_results

    root = Path(__file__).parent.parent / "results/sweep/reach-4"

    def seeds(folder: Path) -> list[bytes]:
        shutil.copytree(root, folder / "bench")
        return [(root / name).read_bytes()]

    return Kind(seeds, _file(f"bench/{name}", lambda path: read_results(path.parent)))


def _mission() -> Kind:
    from dream.evaluation.results import Flown, mission_path, read_mission, read_results, write_mission

    results = read_results(Path(__file__).parent.parent / "results/sweep/reach-4")
    row = min(results.rows, key=lambda row: row.steps)
    name = str(mission_path(Path(), row.key))

    def seeds(folder: Path) -> list[bytes]:
        return [write_mission(folder, Flown(row, results.traces[row.key])).read_bytes()]

    return Kind(seeds, _file(name, read_mission))


def _bounds() -> Kind:
    from dream.evaluation.oracle.bounds import every_known, read_bounds, write_bounds

    def seeds(folder: Path) -> list[bytes]:
        write_bounds(folder / "seed.jsonl", list(every_known().values())[:2])
        return [(folder / "seed.jsonl").read_bytes()]

    return Kind(seeds, _file("bounds.jsonl", read_bounds))


def _orders() -> Kind:
    from dream.planning.vlm.orders import read_mission, write_mission

    def seeds(folder: Path) -> list[bytes]:
        from dream.orders import everything
        from dream.types import Target

        write_mission(folder / "seed.json", "map all of it", everything(Target.ANY))
        return [(folder / "seed.json").read_bytes()]

    return Kind(seeds, _file("mission.json", read_mission))


def _reply() -> Kind:
    from dream.planning.vlm.asking.finding import answer_in
    from dream.planning.vlm.reply import STEPS, dream_reply
    from dream.protocol import DREAM_V1

    kind = dream_reply(DREAM_V1)
    said = ", ".join(f'"{step}": "Some words."' for step in STEPS)
    answer = f'{{{said}, "direction": "left", "turn_deg": 30, "step_m": 1, "done": false}}'
    fenced = f"Well.\n```json\n{answer}\n```\nThat is it."

    def read(data: bytes, _: Path) -> object:
        return kind.model_validate_json(answer_in(data.decode("utf-8", "replace"), kind)).decision

    return Kind(lambda _: [answer.encode(), fenced.encode()], read)


def _lens() -> Kind:
    from dream.robots.bluerov2.lens import Calibrated, Lens

    def seeds(folder: Path) -> list[bytes]:
        found = []
        matrix = np.array([[400.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]])
        for count, fisheye in ((5, False), (4, True)):
            lens = Lens(640, 480, matrix, 0.01 * np.ones(count), fisheye, Calibrated.WATER)
            lens.write(folder / "seed.yaml")
            found.append((folder / "seed.yaml").read_bytes())
        return found

    return Kind(seeds, _file("camera.yaml", Lens.read))


def _onnx() -> Kind:
    from dream.perception.onnx import Network
    from tests.perception.models import redness

    return Kind(lambda folder: [redness(folder / "seed.onnx").read_bytes()], _file("model.onnx", Network))


def _sidecar() -> Kind:
    from dream.perception.sidecar import read_sidecar

    seed = (
        b'{"output": "logits", "classes": {"floor": "seabed", "shell": "target", "pipe": "obstacle"},'
        b' "layout": "NHWC", "mean": [0.5, 0.5, 0.5], "std": [1, 1, 1]}'
    )
    return Kind(lambda _: [seed], _file("model.json", read_sidecar))


def _a50() -> Kind:
    from dream.robots.bluerov2.dvl_a50 import BadLine, read_line

    report = (
        b'{"time":106.3,"vx":0.1,"vy":-0.2,"vz":0.01,"fom":0.002,"covariance":[[1e-6,0,0],[0,1e-6,0],[0,0,1e-6]],'
        b'"altitude":0.49,"transducers":[{"id":0,"velocity":0.1,"distance":0.5,"rssi":-30.6,"nsd":-88.5,'
        b'"beam_valid":true}],"velocity_valid":true,"status":0,"format":"json_v3.1","type":"velocity",'
        b'"time_of_validity":1638191471563017,"time_of_transmission":1638191471752336}'
    )
    answer = (
        b'{"response_to":"get_config","success":true,"error_message":"","result":{"speed_of_sound":1475},'
    )
    seeds = [report, answer + b'"format":"json_v3.1","type":"response"}']
    return Kind(lambda _: seeds, lambda data, _: [read_line(line) for line in data.split(b"\n")], (BadLine,))


def _mavlink() -> Kind:
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    from dream.robots.bluerov2.mavlink import Link
    from tests.robots.bluerov2.test_mavlink import Clock, Vehicle

    vehicle = Vehicle(Clock())
    told = (
        dialect.MAVLink_heartbeat_message(2, 3, 81, 19, 4, 3),
        dialect.MAVLink_attitude_message(1000, 0.1, -0.1, 1.0, 0.0, 0.0, 0.1),
        dialect.MAVLink_scaled_pressure2_message(1000, 1013.0, 0.0, 2000),
        dialect.MAVLink_sys_status_message(0, 0, 0, 100, 16000, 100, 90, 0, 0, 0, 0, 0, 0),
        dialect.MAVLink_statustext_message(4, b"Leak detected"),
        dialect.MAVLink_param_value_message(b"FS_LEAK_ENABLE", 1.0, 9, 1, 0),
    )
    packets = [vehicle.pack(message) for message in told]

    def read(data: bytes, _: Path) -> None:
        silent = Vehicle(Clock())
        link = Link(silent, now=silent.clock, rates={})
        link.receive(data)
        for packet in packets:  # What is whole counts again.
            link.receive(packet)
        assert link.telemetry is not None

    return Kind(lambda _: [*packets, b"".join(packets)], read, accepted=())


def _rtp() -> Kind:
    from dream.robots.bluerov2.rtp import Depacketizer
    from dream.robots.bluerov2.standin.video import packets

    units = [b"\x67sps", b"\x68pps", b"\x65" + bytes([7]) * 3000]
    whole = list(packets(units, sequence=65534, stamp=9000, ssrc=1))

    def read(data: bytes, _: Path) -> None:
        receiver = Depacketizer()
        for time_, packet in enumerate([*whole[:2], data, *whole]):
            receiver.push(packet, float(time_))

    return Kind(lambda _: whole, read, accepted=())


def _log() -> Kind:
    from dream.robots.bluerov2.log import DiveLog, read_log, read_measurements
    from tests.robots.bluerov2.test_log import motion

    def seeds(folder: Path) -> list[bytes]:
        with DiveLog(folder, epoch_ns=1_795_000_000_123_456_789) as log:
            for measurement in motion(0.5):
                log.tap(measurement.time, "navigation", False, measurement)
            log.tap(1.0, "a50", True, '{"command":"get_config"}')
        return [log.path.read_bytes()]

    def read(path: Path) -> None:
        for _ in read_log(path):
            pass
        for _ in read_measurements(path):
            pass

    return Kind(seeds, _file("torn.mcap", read))


KINDS: dict[str, Callable[[], Kind]] = {
    **{f"world-{name}": (lambda name=name: _world(name)) for name in (  # type: ignore[misc]
        "world.json", "terrain.npy", "meshes.obj", "obstacles.csv", "targets.csv",
    )},
    **{f"run-{name}": (lambda name=name: _run(name)) for name in (  # type: ignore[misc]
        "config.json", "steps.jsonl", "summary.json",
    )},
    **{f"bench-{name}": (lambda name=name: _results(name)) for name in (  # type: ignore[misc]
        "manifest.json", "results.csv", "traces.csv.gz",
    )},
    "run-replies": _replies,
    "bench-mission": _mission,
    "cassette": _cassette,
    "map": _map,
    "volume": _volume,
    "observation": _observation,
    "prior": _prior,
    "space": _space,
    "lesson": _lesson,
    "survey": _survey,
    "geopackage": _geopackage,
    "site": _site,
    "suite": _suite,
    "bounds": _bounds,
    "orders": _orders,
    "reply": _reply,
    "lens": _lens,
    "onnx": _onnx,
    "sidecar": _sidecar,
    "a50": _a50,
    "mavlink": _mavlink,
    "rtp": _rtp,
    "log": _log,
}  # fmt: skip


# Mutations


def mutated(seeds: list[bytes], rng: random.Random) -> bytes:
    """One of the seeds, changed in one to six ways."""
    data = rng.choice(seeds)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        if data.startswith(b"PK") and rng.random() < 0.6:
            data = _repacked(data, rng)
        else:
            data = rng.choice(_CHANGES)(data, rng, seeds)
    return data


def _cut(data: bytes, rng: random.Random, most: int = 64) -> tuple[int, int]:
    """A place in the data, and one a little behind it."""
    start = rng.randrange(len(data) + 1)
    return start, min(len(data), start + rng.randint(1, most))


def _flipped(data: bytes, rng: random.Random, _: list[bytes]) -> bytes:
    if not data:
        return b"\x00"
    changed = bytearray(data)
    for _index in range(rng.choice((1, 1, 4, 16))):
        changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _set(data: bytes, rng: random.Random, _: list[bytes]) -> bytes:
    start, end = _cut(data, rng, 8)
    return data[:start] + rng.choice((b"\x00", b"\xff", b"\x7f", b"\x80")) * (end - start) + data[end:]


def _removed(data: bytes, rng: random.Random, _: list[bytes]) -> bytes:
    start, end = _cut(data, rng)
    return data[:start] + data[end:]


def _ended(data: bytes, rng: random.Random, _: list[bytes]) -> bytes:
    return data[: rng.randrange(len(data) + 1)]


def _doubled(data: bytes, rng: random.Random, _: list[bytes]) -> bytes:
    start, end = _cut(data, rng, 4096)
    return data[:end] + data[start:end] * rng.choice((1, 1, 50)) + data[end:]


def _zeroed(data: bytes, rng: random.Random, _: list[bytes]) -> bytes:
    """A page that was never written."""
    start = 512 * rng.randrange(len(data) // 512 + 1)
    end = min(len(data), start + 512 * rng.choice((1, 8)))
    return data[:start] + bytes(end - start) + data[end:]


def _spliced(data: bytes, rng: random.Random, seeds: list[bytes]) -> bytes:
    other = rng.choice(seeds)
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other) + 1) :]


def _worded(data: bytes, rng: random.Random, _: list[bytes]) -> bytes:
    """A word in the place of a number, of a text, or between two bytes."""
    # Not of a whole large file, which is mostly not of words.
    start = rng.randrange(max(1, len(data) - 4096))
    found = list(re.finditer(rb'-?\d+(?:\.\d+)?|"[^"\n]{0,40}"|true|false', data[start : start + 4096]))
    at = (
        rng.choice(found).span()
        if found and rng.random() < 0.8
        else (rng.randrange(len(data) + 1 - start),) * 2
    )
    word = rng.choice(WORDS) * rng.choice((1, 1, 1, 2000))
    return data[: start + at[0]] + word + data[start + at[1] :]


_CHANGES = (_flipped, _set, _removed, _ended, _doubled, _zeroed, _spliced, _worded)


def _repacked(data: bytes, rng: random.Random) -> bytes:
    """An archive one of whose members is changed, lost or another's, with sums that are right again."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # noqa: BLE001 - one that an earlier change has damaged.
        return _flipped(data, rng, [])
    if not members:
        return data
    name = rng.choice(list(members))
    change = rng.randrange(6)
    if change == 0:
        del members[name]
    elif change == 1:
        members[name] = members[rng.choice(list(members))]
    elif change == 2:  # The header of an array says its type and shape.
        head, rest = members[name][:128], members[name][128:]
        members[name] = rng.choice((_worded, _flipped, _set))(head, rng, [head]) + rest
    else:
        members[name] = rng.choice(_CHANGES)(members[name], rng, list(members.values()))
    packed = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(packed, "w") as archive:
        warnings.simplefilter("ignore")
        for each, content in members.items():
            archive.writestr(each, content)
    return packed.getvalue()


# The run


def _rang(number: int, frame: FrameType | None) -> None:
    raise Hung(f"longer than {LIMIT_S:g} s")


def tried(kind: Kind, name: str, data: bytes, folder: Path) -> Finding | None:
    """What is wrong with how an input is read; None where it is taken or refused as it should be."""
    before = signal.signal(signal.SIGALRM, _rang)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            kind.read(data, folder)
    except kind.accepted:
        return None
    except (Exception, Hung) as error:  # noqa: BLE001 - whatever it is, it is no clear error.
        return Finding(name, data, f"{type(error).__name__}: {str(error)[:200]!r}")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    return None


class Fuzzed:
    """A kind with its seeds, in a folder of its own."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self.kind, self.folder = name, KINDS[name](), folder
        folder.mkdir(parents=True, exist_ok=True)
        self.seeds = self.kind.seeds(folder)
        for seed in self.seeds:  # A seed that is refused would test nothing.
            self.kind.read(seed, folder)

    def inputs(self, seed: int | str) -> Iterator[bytes]:
        """For ever the same for the same seed."""
        rng = random.Random(f"{self.name} {seed}")
        while True:
            yield mutated(self.seeds, rng)

    def try_(self, data: bytes) -> Finding | None:
        """See `tried`."""
        return tried(self.kind, self.name, data, self.folder)


def main() -> int:
    """Exit status 1 where something went wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[], help="kinds whose name begins so")
    parser.add_argument("--keep", type=Path, default=Path("fuzz"), help="folder for inputs that went wrong")
    parser.add_argument("--replay", type=Path, help="read one such input again")
    arguments = parser.parse_args()
    logging.disable(logging.CRITICAL)
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, resource.RLIM_INFINITY))
    with tempfile.TemporaryDirectory() as scratch:
        if arguments.replay is not None:
            name = arguments.replay.name.rpartition("-")[0]
            finding = Fuzzed(name, Path(scratch)).try_(arguments.replay.read_bytes())
            print("taken, or refused as it should be" if finding is None else finding.error)
            return finding is not None
        names = [name for name in KINDS if not arguments.only or name.startswith(tuple(arguments.only))]
        if not names:
            parser.error(f"--only: expected the beginning of one of {', '.join(KINDS)}")
        return _fuzz(names, Path(scratch), arguments.seconds, arguments.seed, arguments.keep)


def _fuzz(names: list[str], scratch: Path, seconds: float, seed: int, keep: Path) -> int:
    """Each kind in turn for a while, in a process of its own: some errors end a process."""
    known: dict[str, set[str]] = {name: set() for name in names}
    every = [Fuzzed(name, scratch / name) for name in names]
    until, counts = time.monotonic() + seconds, dict.fromkeys(names, 0)
    for turn in itertools.count():
        for fuzzed in every:
            if time.monotonic() >= until:
                break
            count, findings = _beside(fuzzed, f"{seed} {turn}", min(until, time.monotonic() + SLICE_S))
            counts[fuzzed.name] += count
            for finding in findings:
                alike = re.sub(r"[^A-Za-z: ]+", "#", finding.error)[:30]
                if alike not in known[fuzzed.name]:
                    known[fuzzed.name].add(alike)
                    keep.mkdir(parents=True, exist_ok=True)
                    path = keep / f"{fuzzed.name}-{len(known[fuzzed.name]):03d}"
                    path.write_bytes(finding.data)
                    print(f"{path}: {finding.error}", flush=True)
        if time.monotonic() >= until:
            break
    for name, count in counts.items():
        print(f"{name}: {count} inputs, {len(known[name])} kinds of error")
    return int(any(known.values()))


def _beside(fuzzed: Fuzzed, seed: str, until: float) -> tuple[int, list[Finding]]:
    """How many inputs another process reads until then, and what went wrong, be it that it died of one."""
    told, current = fuzzed.folder / ".told", fuzzed.folder / ".current"
    child = os.fork()
    if child == 0:
        count, findings = 0, []
        for data in fuzzed.inputs(seed):
            if time.monotonic() >= until:
                break
            current.write_bytes(data)
            count += 1
            finding = fuzzed.try_(data)
            if finding is not None:
                findings.append(finding)
            if finding is not None or count % 64 == 0:
                told.write_bytes(pickle.dumps((count, findings)))
        told.write_bytes(pickle.dumps((count, findings)))
        os._exit(0)
    _, status = os.waitpid(child, 0)
    count, findings = pickle.loads(told.read_bytes()) if told.exists() else (1, [])
    told.unlink(missing_ok=True)
    if os.WIFSIGNALED(status):
        name = signal.Signals(os.WTERMSIG(status)).name
        findings.append(Finding(fuzzed.name, current.read_bytes(), f"the process died of {name}"))
    return count, findings


if __name__ == "__main__":
    sys.exit(main())
