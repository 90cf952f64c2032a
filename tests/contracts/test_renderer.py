"""What every renderer keeps to, whatever the world."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dream.geometry import SE3, Camera
from dream.protocol import PROTOCOLS
from dream.sim.render import FAR, NEAR, Renderer
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Label

NAMES = ("flat/empty", "reef/string", "wreck/1", "pool/arc")
CAMERA = Camera.from_fov(96, 72, math.radians(90.0))


@pytest.fixture(scope="module", params=NAMES)
def made(request: pytest.FixtureRequest) -> tuple[World, Renderer]:
    world = make_world(request.param, 1)
    return world, Renderer(world)


def pose_of(world: World, turn: float = 0.0) -> SE3:
    start, protocol = world.starts[0], PROTOCOLS[world.protocol]
    z = float(world.terrain.height(start.x, start.y)) + protocol.altitude
    return SE3.level(start.x, start.y, z, start.yaw + turn) @ protocol.T_base_camera


@pytest.mark.few(3)
def test_images_have_the_shapes_types_and_values_that_are_promised(made: tuple[World, Renderer]) -> None:
    world, renderer = made
    for turn in (0.0, 2.0, 4.0):
        frame = renderer.render(CAMERA, pose_of(world, turn))
        shape = (CAMERA.height, CAMERA.width)
        assert frame.rgb.shape == (*shape, 3)
        assert frame.rgb.dtype == np.uint8
        assert frame.depth.shape == frame.labels.shape == frame.ids.shape == shape
        assert frame.depth.dtype == np.float32
        assert frame.labels.dtype == np.uint8
        assert frame.ids.dtype == np.int32
        assert np.isin(frame.labels, list(Label)).all()
        assert ((frame.labels == Label.WATER) == np.isnan(frame.depth)).all()
        assert ((frame.labels == Label.TARGET) == (frame.ids >= 0)).all()
        assert frame.ids.max() < len(world.targets)
        valid = frame.depth[np.isfinite(frame.depth)]
        assert ((valid >= 0.99 * NEAR) & (valid <= 1.0001 * FAR)).all()
        assert len(np.unique(frame.rgb.reshape(-1, 3), axis=0)) > 50


def test_measuring_gives_what_drawing_gives(made: tuple[World, Renderer]) -> None:
    world, renderer = made
    frame, measured = renderer.render(CAMERA, pose_of(world)), renderer.measure(CAMERA, pose_of(world))
    np.testing.assert_array_equal(frame.depth, measured.depth)
    np.testing.assert_array_equal(frame.labels, measured.labels)
    np.testing.assert_array_equal(frame.ids, measured.ids)


def test_the_same_pose_gives_the_same_bits_and_another_pose_does_not(made: tuple[World, Renderer]) -> None:
    world, renderer = made
    first = renderer.render(CAMERA, pose_of(world))
    other = renderer.render(CAMERA, pose_of(world, 1.0))
    again, anew = renderer.render(CAMERA, pose_of(world)), Renderer(world).render(CAMERA, pose_of(world))
    for name in ("rgb", "depth", "labels", "ids"):
        assert (
            getattr(first, name).tobytes() == getattr(again, name).tobytes() == getattr(anew, name).tobytes()
        )
    assert first.rgb.tobytes() != other.rgb.tobytes()


def test_images_share_no_memory_with_the_renderer(made: tuple[World, Renderer]) -> None:
    world, renderer = made
    first = renderer.render(CAMERA, pose_of(world))
    kept = first.rgb.copy()
    first.rgb[:], first.depth[:], first.labels[:], first.ids[:] = 0, 0.0, 0, 0
    np.testing.assert_array_equal(renderer.render(CAMERA, pose_of(world)).rgb, kept)


def test_the_world_and_the_pose_are_left_as_they_were() -> None:
    world = make_world("reef/string", 1)
    pose = pose_of(world)
    before = world.terrain.heights.tobytes(), world.targets.position.tobytes(), pose.rotation.tobytes()
    Renderer(world).render(CAMERA, pose)
    assert before == (
        world.terrain.heights.tobytes(),
        world.targets.position.tobytes(),
        pose.rotation.tobytes(),
    )


def test_a_larger_image_shows_the_same_view(made: tuple[World, Renderer]) -> None:
    world, renderer = made
    small, large = (
        renderer.measure(CAMERA, pose_of(world)),
        renderer.measure(CAMERA.scaled(3), pose_of(world)),
    )
    # The middle of three pixels has the centre of the one.
    np.testing.assert_array_equal(large.labels[1::3, 1::3], small.labels)
    np.testing.assert_allclose(large.depth[1::3, 1::3], small.depth, rtol=1e-3)


def test_what_is_no_camera_or_no_pose_is_refused(made: tuple[World, Renderer]) -> None:
    world, renderer = made
    with pytest.raises(ValueError, match="T_world_camera: expected an SE3, got ndarray"):
        renderer.render(CAMERA, np.eye(4))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="camera: expected a Camera, got SE3"):
        renderer.measure(pose_of(world), CAMERA)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="at least one pixel"):
        renderer.measure(Camera(0, 72, 48.0, 48.0, 48.0, 36.0), pose_of(world))
    with pytest.raises(ValueError, match="finite"):
        renderer.measure(CAMERA, SE3(np.eye(3), np.array([0.0, math.nan, 0.0])))
    with pytest.raises(ValueError, match="rotation"):
        renderer.measure(CAMERA, SE3(2.0 * np.eye(3), np.zeros(3)))
