"""The simulated camera: it draws the truth, and says what the robot believes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dream.geometry import SE3, camera_mount
from dream.perception import FlatFloor, Parallax, Perception, Shells, View
from dream.protocol import (
    DREAM_V1,
    DREAM_V1_NOISY,
    DREAM_V2,
    LastingErrors,
    SensorNoise,
    SurveyProtocol,
    protocol_named,
)
from dream.robots.camera import SimulatedCamera
from dream.sim.render import Renderer
from dream.sim.visual_range import UNTOLD
from dream.sim.water import Water
from dream.sim.world import World
from dream.types import Float32Array, Label, Observation, UInt8Array

TRUE = protocol_named("dream-v2-true")
TILT = math.radians(45.0)
assert DREAM_V2.lasting is not None
LASTING = DREAM_V2.lasting
OFF = LastingErrors()
EACH = {
    "labels": replace(OFF, labels=LASTING.labels),
    "depth": replace(OFF, depth=LASTING.depth),
    "height": replace(OFF, height=LASTING.height),
    "tilt": replace(OFF, tilt=LASTING.tilt),
}


def poses(world: World) -> tuple[SE3, SE3]:
    """Where it is, and where its sensors say: half a metre to the east."""
    start = world.starts[0]
    z = float(world.terrain.height(start.x, start.y)) + 3.0
    return SE3.level(start.x, start.y, z, start.yaw), SE3.level(start.x + 0.5, start.y, z, start.yaw)


def look(
    world: World, protocol: SurveyProtocol, tilt: float = TILT, moves: int = 0
) -> tuple[Observation, SimulatedCamera]:
    camera = SimulatedCamera(world, protocol, world.starts[0], None, 1)
    return camera.observe(1.0, moves, *poses(world), tilt, 0.5), camera


def test_by_sight_a_picture_is_checked_by_beams_and_by_those_before(string_reef: World) -> None:
    views: list[View] = []

    class Flat(FlatFloor):
        def estimate(
            self, rgb: UInt8Array, labels: UInt8Array, view: View
        ) -> tuple[Float32Array, Float32Array]:
            views.append(view)
            return super().estimate(rgb, labels, view)

    told = Perception(Shells(), Flat(), Parallax())
    protocol = protocol_named("dream-v2-seen")
    camera = SimulatedCamera(string_reef, protocol, string_reef.starts[0], None, 1, told)
    camera.observe(0.0, 0, *poses(string_reef), TILT, 0.0)
    beams = views[0].beams
    assert beams is not None
    truth = poses(string_reef)[0]
    ground = [float(string_reef.terrain.height(x, y)) for x, y, _ in (truth @ beams)]
    np.testing.assert_allclose((truth @ beams)[:, 2], ground, atol=0.05)
    # Another mission begins with the same: what this one saw is none of its business.
    assert told.check is not None
    assert not told.check._shots


def same(a: Observation, b: Observation, *but: str) -> bool:
    arrays = {
        name: getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in ("rgb", "depth", "labels")
    }
    for name in ("T_world_base", "T_base_camera"):
        ours, theirs = getattr(a, name), getattr(b, name)
        arrays[name] = all(
            getattr(ours, part).tobytes() == getattr(theirs, part).tobytes()
            for part in ("rotation", "translation")
        )
    return {name for name, alike in arrays.items() if not alike} == set(but)


@pytest.mark.parametrize("tilt", DREAM_V2.tilts)
def test_it_draws_the_truth_as_its_camera_is_tilted_and_says_what_is_believed(
    string_reef: World, tilt: float
) -> None:
    seen, _ = look(string_reef, DREAM_V1, tilt)
    truth, believed = poses(string_reef)
    frame = Renderer(string_reef).render(DREAM_V1.camera, truth @ camera_mount(tilt))
    for name in ("rgb", "depth", "labels"):
        assert getattr(seen, name).tobytes() == getattr(frame, name).tobytes()
    np.testing.assert_array_equal(seen.T_world_base.translation, believed.translation)
    np.testing.assert_array_equal(seen.T_world_base.rotation, believed.rotation)
    assert seen.tilt == pytest.approx(tilt)


@pytest.mark.parametrize("which", EACH)
def test_each_error_changes_what_it_should_and_nothing_else(string_reef: World, which: str) -> None:
    true, _ = look(string_reef, TRUE)
    seen, camera = look(string_reef, replace(TRUE, lasting=EACH[which]))
    errors = camera.errors
    changed = {"labels": "labels", "depth": "depth", "height": "T_world_base", "tilt": "T_base_camera"}
    assert same(seen, true, changed[which])
    for name in ("depth", "height", "tilt"):
        assert (getattr(errors, name) != 0.0) == (name == which)
    if which == "labels":
        assert 0.005 < (seen.labels != true.labels).mean() < 0.3
    if which == "depth":
        np.testing.assert_allclose(seen.depth, true.depth * (1.0 + errors.depth), rtol=1e-6)
        assert abs(errors.depth) <= LASTING.depth
    if which == "height":
        assert seen.z - true.z == pytest.approx(errors.height)
        assert abs(errors.height) <= LASTING.height
    if which == "tilt":
        assert seen.tilt - TILT == pytest.approx(errors.tilt)
        assert abs(errors.tilt) <= LASTING.tilt


@pytest.mark.parametrize("protocol", [TRUE, DREAM_V1, DREAM_V1_NOISY], ids=lambda protocol: protocol.name)
def test_errors_that_are_all_switched_off_are_no_errors(string_reef: World, protocol: SurveyProtocol) -> None:
    seen, none = (look(string_reef, replace(protocol, lasting=lasting))[0] for lasting in (OFF, None))
    assert same(seen, none)


def test_it_errs_alike_after_every_move_and_when_flown_again(string_reef: World) -> None:
    protocol = replace(TRUE, lasting=LASTING)
    first, later, again = (look(string_reef, protocol, moves=moves)[0] for moves in (0, 9, 0))
    assert same(first, later)
    assert same(first, again)


def test_noise_of_the_frame_comes_on_top(string_reef: World) -> None:
    flickers = replace(DREAM_V2, noise=SensorNoise(0.002, 0.1, 10.0, (0.15, 0.5)))
    (seen, camera), (steady, _) = (
        look(string_reef, protocol) for protocol in (flickers, replace(flickers, noise=None))
    )
    assert same(seen, steady, "depth", "labels")
    scale = 1.0 + camera.errors.depth
    z = steady.depth / scale
    scatter = (seen.depth / scale - z) / (0.002 * z * z)
    assert np.nanstd(scatter) == pytest.approx(1.0, abs=0.02)
    assert abs(np.nanmean(scatter)) < 0.02


def test_in_space_the_water_ends_what_is_told_and_under_planar_protocols_it_does_not(
    string_reef: World,
) -> None:
    murky = replace(string_reef, water=Water("murky", (0.5, 0.5, 0.5), (0.3, 0.3, 0.3), (0.1, 0.1, 0.1)))
    planar, _ = look(murky, DREAM_V1, 0.35)
    seen, _ = look(murky, replace(DREAM_V2, lasting=None), 0.35)
    away = np.linalg.norm(
        planar.camera.back_project(planar.depth, planar.T_world_camera) - planar.T_world_camera.translation,
        axis=-1,
    )
    assert np.nanmax(away) > 15.0
    beyond = ~(away < 6.001)
    assert np.isnan(seen.depth[beyond]).all()
    assert (seen.labels[beyond] == Label.WATER).all()
    between = (away > 4.001) & (away < 5.999)
    assert between.any()
    # Not even what the frame's noise would call otherwise.
    assert (seen.labels[between] == UNTOLD).all()
    assert not np.isnan(seen.depth[between]).any()
