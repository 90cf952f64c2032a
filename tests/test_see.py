"""What `--see` chooses, in a simulated world and in a dive."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from dream.cli import run_command
from dream.commands.dive import Dive
from dream.commands.dive.options import check_options, sight_told
from dream.commands.see import protocol_seen
from dream.evaluation.runner import simulate
from dream.mapping.volume import VoxelState
from dream.perception import FlatFloor, Parallax, Perception, Shells, Sight, View
from dream.planning import PLANNERS
from dream.protocol import DREAM_V2_SEEN
from dream.sim.worlds import make_world
from dream.types import Float32Array, Label, UInt8Array
from tests.perception.models import frozen_network


@pytest.mark.parametrize("name", [None, "dream-v2", "dream-v2-seen"])
def test_learned_is_the_protocol_of_sight(name: str | None) -> None:
    assert protocol_seen(name, "learned") == "dream-v2-seen"


def test_told_is_the_protocol_that_was_asked_for() -> None:
    assert protocol_seen(None, "told") is None
    assert protocol_seen("dream-v1", "told") == "dream-v1"
    assert protocol_seen("dream-v2-seen", "told") == "dream-v2-seen"


@pytest.mark.parametrize("command", ["run", "bench"])
def test_no_other_protocol_is_flown_by_sight(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command([command, "--see", "learned", "--protocol", "dream-v1", "--world", "reef/string"]) == 2
    assert "--see: expected --protocol dream-v2 with learned, got dream-v1" in capsys.readouterr().err


def test_a_dive_sees_by_the_network_unless_it_is_in_a_tank() -> None:
    seen = sight_told(Dive(area=(0.0, 0.0, 8.0, 5.0), protocol="dream-v2")).perception
    assert isinstance(seen.segmenter, Sight)
    assert seen.depth is seen.segmenter
    assert isinstance(seen.check, Parallax)


@pytest.mark.parametrize(
    "told", [Dive(see="shells", protocol="dream-v1"), Dive(protocol="pool-v1"), Dive(stand_in=True)]
)
def test_shells_are_for_a_tank_and_for_who_names_them(told: Dive) -> None:
    seen = sight_told(told).perception
    assert isinstance(seen.segmenter, Shells)
    assert isinstance(seen.depth, FlatFloor)
    assert seen.check is None


def test_shells_are_refused_where_what_stands_up_would_be_run_into() -> None:
    with pytest.raises(ValueError, match="--see: expected learned"):
        check_options(Dive(area=(0.0, 0.0, 30.0, 30.0), protocol="dream-v2", see="shells"))
    check_options(Dive(area=(0.0, 0.0, 30.0, 30.0), protocol="dream-v2"))


def test_a_network_that_is_not_there_is_told_at_a_desk(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="model: expected a readable file"):
        sight_told(Dive(area=(0.0, 0.0, 8.0, 5.0), see=str(tmp_path / "none.onnx")))


class Wall:
    """Says that all of it is an obstacle so many metres away."""

    def __init__(self, away: float) -> None:
        self.away, self.views = away, list[View]()

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        return np.full(rgb.shape[:2], Label.OBSTACLE, np.uint8), np.ones(rgb.shape[:2], np.float32)

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        self.views.append(view)
        return np.full(labels.shape, self.away, np.float32), np.ones(labels.shape, np.float32)


def test_a_mission_by_sight_knows_what_the_network_says_and_no_more() -> None:
    """Also of a wall that is not there: it is mapped, and nothing of the world's own labels is."""
    world, wall = make_world("reef/string", 3), Wall(2.5)
    steps = list(
        simulate(world, PLANNERS["belief"], DREAM_V2_SEEN, max_steps=3, perception=Perception(wall, wall))
    )
    seen = steps[-1].observation
    assert (seen.labels == Label.OBSTACLE).all()
    assert (seen.depth == np.float32(2.5)).all()
    assert seen.confidence is not None
    assert len(wall.views) == 4
    assert all(0.5 < view.altitude < 5.0 for view in wall.views)
    ahead = seen.T_world_camera @ np.array([0.0, 0.0, 2.5])
    volume = steps[-1].occupancy.volume
    assert volume is not None
    assert volume.state(ahead[None])[0] == VoxelState.SOLID


def test_two_missions_by_sight_see_alike() -> None:
    world = make_world("reef/string", 3)
    one, other = (
        [step.observation for step in simulate(world, PLANNERS["belief"], DREAM_V2_SEEN, max_steps=4)]
        for _ in range(2)
    )
    for a, b in zip(one, other, strict=True):
        assert np.array_equal(a.rgb, b.rgb)
        assert np.array_equal(a.labels, b.labels)
        np.testing.assert_array_equal(a.depth, b.depth)


class Lies:
    """What the network says, made wrong on purpose."""

    def __init__(self, how: str, tmp_path: Path) -> None:
        self.how, self.rng = how, np.random.default_rng(0)
        self.sight = Sight(frozen_network(tmp_path / "frozen.onnx") if how == "frozen" else None)

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        labels, sure = self.sight.segment(rgb, view)
        if self.how == "all target":
            return np.full_like(labels, Label.TARGET), np.ones_like(sure)
        if self.how == "noise":
            return self.rng.integers(0, 4, labels.shape).astype(np.uint8), np.ones_like(sure)
        return labels, sure

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        depth, near = self.sight.estimate(rgb, np.full_like(labels, Label.SEABED), view)
        if self.how == "three times as far":
            return 3.0 * depth, near
        if self.how == "noise":
            return self.rng.uniform(0.3, 15.0, depth.shape).astype(np.float32), np.ones_like(near)
        return depth, near


@pytest.mark.parametrize("how", ["all target", "three times as far", "frozen", "noise"])
@pytest.mark.parametrize("world", ["wreck/1", pytest.param("reef/rocks", marks=pytest.mark.rare)])
def test_a_network_that_is_wrong_on_purpose_touches_nothing(how: str, world: str, tmp_path: Path) -> None:
    lies = Lies(how, tmp_path)
    perception = Perception(lies, lies, Parallax())
    for step in simulate(
        make_world(world, 7), PLANNERS["belief"], DREAM_V2_SEEN, max_steps=25, perception=perception
    ):
        assert not step.arrival.collided
