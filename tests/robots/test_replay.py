"""A run that is played back is the run again."""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dream.control import setpoint
from dream.course import Planner
from dream.evaluation.runner import labelled_in
from dream.geometry import SE2, SE3
from dream.mapping import OccupancyMap
from dream.mission import Robot, explore
from dream.planning import NearestFrontier, SixSteps
from dream.protocol import DREAM_V1, DREAM_V1_NAV, SurveyProtocol
from dream.robots import Anchored, Simulated, Teleport
from dream.robots.replay import Keeping, Kept, Move, Replayed, keep, read, write
from dream.sim.world import World
from dream.types import Arrival, Decision, Observation, Setpoint, Step

MOVES = 8


def fly(robot: Robot, planner: Planner, world: World, protocol: SurveyProtocol) -> list[Step]:
    occupancy = OccupancyMap(world.bounds, protocol)
    return list(explore(robot, planner, occupancy, max_steps=MOVES, target=labelled_in(world)))


@pytest.fixture(scope="module")
def flown(string_reef: World, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Step], Path]:
    folder = tmp_path_factory.mktemp("run")
    robot = Keeping(Teleport(string_reef, DREAM_V1, fineness=2), folder)
    return fly(robot, SixSteps(), string_reef, DREAM_V1), folder


def same(one: Observation, other: Observation) -> bool:
    return (
        (one.time, one.camera) == (other.time, other.camera)
        and all(
            getattr(one, name).tobytes() == getattr(other, name).tobytes()
            and getattr(one, name).dtype == getattr(other, name).dtype
            and getattr(one, name).shape == getattr(other, name).shape
            for name in ("rgb", "depth", "labels")
        )
        and all(
            np.array_equal(getattr(one, name).rotation, getattr(other, name).rotation)
            and np.array_equal(getattr(one, name).translation, getattr(other, name).translation)
            for name in ("T_world_base", "T_base_camera")
        )
    )


def test_the_planner_decides_again_as_it_did(string_reef: World, flown: tuple[list[Step], Path]) -> None:
    steps, folder = flown
    robot = Replayed(folder)
    assert robot.moves == MOVES
    again = fly(robot, SixSteps(), string_reef, DREAM_V1)
    assert robot.divergences == ()
    assert [step.decision for step in again] == [step.decision for step in steps]
    assert [step.arrival for step in again] == [step.arrival for step in steps]
    assert all(same(one.observation, other.observation) for one, other in zip(steps, again, strict=True))
    for layer in ("solid", "target", "explored", "seabed_seen", "known", "ground"):
        assert getattr(steps[-1].occupancy, layer).tobytes() == getattr(again[-1].occupancy, layer).tobytes()
    assert steps[-1].occupancy.areas() == again[-1].occupancy.areas()


def test_what_passes_by_is_kept_as_a_robot_keeps_it(
    string_reef: World, flown: tuple[list[Step], Path], tmp_path: Path
) -> None:
    steps = fly(Teleport(string_reef, DREAM_V1, fineness=2), SixSteps(), string_reef, DREAM_V1)
    assert list(keep(steps, tmp_path, DREAM_V1)) == steps
    files = sorted((flown[1] / "observations").iterdir())
    assert sorted(path.name for path in (tmp_path / "observations").iterdir()) == [f.name for f in files]
    for file in files:
        one, other = read(file), read(tmp_path / "observations" / file.name)
        assert same(one.observation, other.observation)
        assert (one.move is None) is (other.move is None) is (file.name == "0000.npz")
        if one.move is not None and other.move is not None:
            assert one.move.setpoint == other.move.setpoint
            assert one.move.arrival == other.move.arrival
    with pytest.raises(ValueError, match="expected a folder without any"):
        next(keep(steps, tmp_path, DREAM_V1))


def test_another_planner_is_followed_by_the_record_and_says_so(
    string_reef: World, flown: tuple[list[Step], Path]
) -> None:
    steps, folder = flown
    robot = Replayed(folder)
    again = fly(robot, NearestFrontier(), string_reef, DREAM_V1)
    assert robot.divergences
    assert min(robot.divergences) > 3  # All missions begin with the look-around.
    for step, then in zip(again, steps, strict=True):
        diverged = step.index in robot.divergences
        now, once = step.guarded.decision, then.guarded.decision
        assert diverged is ((now.turn, now.advance) != (once.turn, once.advance))
        assert ("follows the record" in step.arrival.note) is diverged
        assert step.arrival.pose == then.arrival.pose
        assert same(step.observation, then.observation)
    assert again[-1].occupancy.areas() == steps[-1].occupancy.areas()


def test_a_drifting_robot_is_played_back_too(string_reef: World, tmp_path: Path) -> None:
    robot = Keeping(Anchored(Simulated(string_reef, DREAM_V1_NAV), DREAM_V1_NAV), tmp_path)
    here = robot.observe().pose
    arrivals, seen = [], []
    for decision in (Decision(math.pi / 2), Decision(0.0, 1.0)):
        arrivals.append(robot.go_to(setpoint(here, decision, DREAM_V1_NAV)))
        seen.append(robot.observe())
        here = seen[-1].pose
    again = Replayed(tmp_path)
    here = again.observe().pose
    for decision, arrival, then in zip(
        (Decision(math.pi / 2), Decision(0.0, 1.0)), arrivals, seen, strict=True
    ):
        there = again.go_to(setpoint(here, decision, DREAM_V1_NAV))
        assert replace(there, truth=None) == replace(arrival, truth=None)
        assert there.truth is not None
        assert arrival.truth is not None
        assert np.array_equal(there.truth.rotation, arrival.truth.rotation)
        assert same(again.observe(), then)
        here = again.observe().pose
    assert again.divergences == ()


def test_observations_share_no_memory(flown: tuple[list[Step], Path]) -> None:
    robot = Replayed(flown[1])
    first = robot.observe()
    first.depth[:] = 0.0
    first.rgb[:] = 0
    assert not same(first, robot.observe())
    assert same(robot.observe(), flown[0][0].observation)


def test_how_sure_a_picture_was_is_kept_with_it(flown: tuple[list[Step], Path], tmp_path: Path) -> None:
    seen, rng = flown[0][0].observation, np.random.default_rng(2)
    told = replace(
        seen,
        confidence=rng.random(seen.labels.shape).astype(np.float32),
        error=np.where(np.isnan(seen.depth), np.nan, rng.random(seen.labels.shape)).astype(np.float32),
    )
    write(tmp_path / "0000.npz", Kept(None, told))
    again = read(tmp_path / "0000.npz").observation
    assert same(again, told)
    np.testing.assert_array_equal(again.confidence, told.confidence)
    np.testing.assert_array_equal(again.error, told.error)
    with pytest.raises(ValueError, match="error: expected 0 or more"):
        replace(told, error=-np.ones(seen.labels.shape, np.float32))


def test_a_robot_is_asked_once_a_move(string_reef: World, tmp_path: Path) -> None:
    asked: list[str] = []

    class Counting(Teleport):
        def observe(self) -> Observation:
            asked.append("observe")
            return super().observe()

        def go_to(self, setpoint: Setpoint) -> Arrival:
            asked.append("go_to")
            return super().go_to(setpoint)

    robot = Keeping(Counting(string_reef, DREAM_V1), tmp_path)
    there = setpoint(robot.observe().pose, Decision(math.pi / 2), DREAM_V1)
    robot.observe()
    robot.go_to(there)
    robot.go_to(there)
    assert asked == ["observe", "go_to", "observe", "go_to"]


def test_the_end_of_the_record_is_told(flown: tuple[list[Step], Path]) -> None:
    robot = Replayed(flown[1])
    for _ in range(robot.moves):
        robot.go_to(Setpoint(0.0, 0.0, 0.0, 2.0))
    with pytest.raises(ValueError, match=f"expected at most {MOVES} moves"):
        robot.go_to(Setpoint(0.0, 0.0, 0.0, 2.0))
    assert len(robot.divergences) == MOVES


def test_a_run_of_which_nothing_was_kept(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="expected a run with its observations"):
        Replayed(tmp_path)


def test_two_runs_do_not_share_a_folder(string_reef: World, flown: tuple[list[Step], Path]) -> None:
    with pytest.raises(ValueError, match="expected a folder without any"):
        Keeping(Teleport(string_reef, DREAM_V1), flown[1])


@pytest.fixture
def archive(flown: tuple[list[Step], Path], tmp_path: Path) -> Path:
    """A copy of the run's last file."""
    path = tmp_path / "0000.npz"
    path.write_bytes((flown[1] / "observations" / f"{MOVES:04d}.npz").read_bytes())
    return path


def test_a_missing_file_is_named(archive: Path, tmp_path: Path) -> None:
    folder = tmp_path / "observations"
    folder.mkdir()
    for name in ("0000.npz", "0002.npz"):
        (folder / name).write_bytes(archive.read_bytes())
    with pytest.raises(ValueError, match=r"expected 0001.npz before it, which is missing"):
        Replayed(tmp_path)


def _without(name: str) -> Callable[[dict[str, Any]], None]:
    return lambda arrays: arrays.pop(name)


def _with(**changes: Any) -> Callable[[dict[str, Any]], None]:
    return lambda arrays: arrays.update(changes)


@pytest.mark.parametrize(
    "harm",
    [
        _without("depth"),
        _without("arrival"),
        _with(depth=np.zeros((3, 4), np.float32)),
        _with(depth=np.zeros((240, 320), np.float64)),
        _with(rgb_png=np.zeros(10, np.uint8)),
        _with(camera=np.full(6, np.nan)),
        _with(T_world_base=np.zeros((4, 4))),
        _with(T_world_base=np.zeros((3, 4))),
        _with(T_world_base=np.column_stack([np.diag([1.0, -1.0, 1.0]), np.zeros(3)])),
        _with(T_base_camera=np.column_stack([1000.0 * np.eye(3), np.zeros(3)])),
        _with(truth=np.column_stack([np.ones((3, 3)), np.zeros(3)])),
        _with(travelled=np.full(3, np.nan)),
        _with(labels=np.array([{}], dtype=object)),
        _with(error=np.full((240, 320), -1.0, np.float32)),
    ],
)
def test_a_damaged_file_is_named(archive: Path, harm: Callable[[dict[str, Any]], None]) -> None:
    with np.load(archive) as arrays:
        changed = dict(arrays)
    harm(changed)
    np.savez(archive, **changed)
    with pytest.raises(ValueError, match=r"0000.npz: expected what was seen and done"):
        read(archive)


def test_torn_and_other_files_are_named(archive: Path) -> None:
    raw = archive.read_bytes()
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    for content in (raw[: len(raw) // 2], b"", b"PK", b"text", buffer.getvalue()):
        archive.write_bytes(content)
        with pytest.raises(
            ValueError, match="expected what was seen and done, got a damaged or foreign file"
        ):
            read(archive)


def test_nothing_half_written_stays(
    flown: tuple[list[Step], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "writestr", full)
    monkeypatch.setattr(zipfile.ZipFile, "open", full)
    with pytest.raises(OSError, match=r"could not write .*0001.npz \(No space left"):
        write(tmp_path / "0001.npz", Kept(None, flown[0][0].observation))
    assert list(tmp_path.iterdir()) == []


def test_how_sure_it_was_comes_back_to_the_last_bit(flown: tuple[list[Step], Path], tmp_path: Path) -> None:
    seen = flown[0][0].observation
    sure = np.random.default_rng(0).random(seen.depth.shape).astype(np.float32)
    for confidence in (None, sure, np.zeros_like(sure)):
        path = tmp_path / "0000.npz"
        write(path, Kept(None, replace(seen, confidence=confidence)))
        np.testing.assert_array_equal(read(path).observation.confidence, confidence)
    with pytest.raises(ValueError, match=r"confidence: expected probabilities in \[0, 1\]"):
        replace(seen, confidence=2.0 * sure)


def test_every_field_of_an_arrival_comes_back(flown: tuple[list[Step], Path], tmp_path: Path) -> None:
    arrival = Arrival(
        SE2(1 / 3, -2 / 7, 0.1),
        collided=True,
        distance=1.7,
        clearance=math.inf,
        note="leer; ⚓",
        sigma=0.3,
        truth=SE3.level(1.0, 2.0, -3.0, 0.4),
    )
    kept = Kept(Move(Setpoint(1 / 3, 2.0, 3.0, 0.6), arrival), flown[0][0].observation)
    write(tmp_path / "0001.npz", kept)
    again = read(tmp_path / "0001.npz").move
    assert again is not None
    assert kept.move is not None
    assert again.setpoint == kept.move.setpoint
    assert replace(again.arrival, truth=None) == replace(arrival, truth=None)
    assert again.arrival.truth is not None
    assert np.array_equal(again.arrival.truth.translation, [1.0, 2.0, -3.0])
