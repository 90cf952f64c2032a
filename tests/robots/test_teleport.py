"""What the robot of the simulator sees: the truth, but for the noise that the protocol declares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dream.geometry import SE2
from dream.protocol import DREAM_V1, DREAM_V1_NOISY, SensorNoise, SurveyProtocol
from dream.robots import Teleport
from dream.sim.render import Renderer
from dream.sim.world import World
from dream.types import Observation, Setpoint

FLICKERS = replace(DREAM_V1_NOISY, noise=SensorNoise(0.002, 0.1, 10.0, (0.15, 0.5)))
"""A sensor that sees false targets in every frame."""


def sent(robot: Teleport, *places: tuple[float, float, float]) -> Observation:
    """What it sees after going to these places."""
    for x, y, yaw in places:
        robot.go_to(Setpoint(x, y, yaw, DREAM_V1.altitude))
    return robot.observe()


def on_lattice(x: float, y: float) -> Setpoint:
    pose = DREAM_V1.snap(SE2(x, y, 0.0))
    return Setpoint(pose.x, pose.y, pose.yaw, DREAM_V1.altitude)


def assert_alike(a: Observation, b: Observation) -> None:
    for name in ("rgb", "depth", "labels"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes()


def near(world: World, protocol: SurveyProtocol = FLICKERS) -> tuple[Teleport, SE2]:
    """A robot, and the place where it is."""
    robot = Teleport(world, protocol)
    return robot, robot.observe().pose


def test_without_noise_it_sees_what_the_renderer_draws_bit_for_bit(string_reef: World) -> None:
    robot, here = near(string_reef, DREAM_V1)
    for seen in (robot.observe(), sent(robot, (here.x, here.y, 1.0))):
        frame = Renderer(string_reef).render(DREAM_V1.camera, seen.T_world_camera)
        for name in ("rgb", "depth", "labels"):
            assert getattr(seen, name).tobytes() == getattr(frame, name).tobytes()


def test_colour_can_be_finer_than_depth_and_labels(string_reef: World) -> None:
    plain, fine = (
        Teleport(string_reef, DREAM_V1).observe(),
        Teleport(string_reef, DREAM_V1, fineness=2).observe(),
    )
    frame = Renderer(string_reef).render(DREAM_V1.camera.scaled(2), plain.T_world_camera)
    assert fine.rgb.tobytes() == frame.rgb.tobytes()
    for name in ("depth", "labels"):
        assert getattr(fine, name).tobytes() == getattr(plain, name).tobytes()
    with pytest.raises(ValueError, match=r"rgb: expected \(240, 320\) to match the camera, got \(300, 400\)"):
        replace(plain, rgb=np.zeros((300, 400, 3), np.uint8))


def test_it_ends_exactly_on_its_setpoint_and_after_a_contact_on_the_lattice(string_reef: World) -> None:
    robot, here = near(string_reef, DREAM_V1)
    arrival = robot.go_to(Setpoint(here.x + 2.0, here.y, 0.5, DREAM_V1.altitude))
    assert arrival.pose == SE2(here.x + 2.0, here.y, 0.5)
    tall = np.argmax(string_reef.obstacles.scale[:, 2])
    x, y = map(float, string_reef.obstacles.position[tall, :2])
    robot.go_to(on_lattice(x - 6.0, y))
    arrival = robot.go_to(on_lattice(x, y))
    assert arrival.collided
    assert arrival.pose == DREAM_V1.snap(arrival.pose)


def test_with_noise_depth_and_labels_err_and_nothing_else_does(string_reef: World) -> None:
    truth, seen = Teleport(string_reef, DREAM_V1).observe(), Teleport(string_reef, FLICKERS).observe()
    assert seen.rgb.tobytes() == truth.rgb.tobytes()
    assert seen.pose == truth.pose
    assert seen.time == truth.time
    z = truth.depth.astype(np.float64)
    errors = (seen.depth - z) / (0.002 * z * z)
    assert np.nanstd(errors) == pytest.approx(1.0, abs=0.02)
    assert 0.0 < (seen.labels != truth.labels).mean() < 0.1


def test_a_mission_that_is_flown_again_errs_alike(string_reef: World) -> None:
    (first, here), (again, _) = near(string_reef), near(string_reef)
    for yaw in (0.0, 1.0, 2.0):
        assert_alike(sent(first, (here.x, here.y, yaw)), sent(again, (here.x, here.y, yaw)))


def test_noise_does_not_depend_on_the_way_there(empty_world: World) -> None:
    (first, here), (other, _) = near(empty_world), near(empty_world)
    last = (here.x, here.y, 0.0)
    ahead, behind = sent(first, (here.x + 1.0, here.y, 0.0), last), sent(other, (here.x, here.y, 2.0), last)
    assert_alike(ahead, behind)


def test_holding_and_looking_again_shows_other_errors(string_reef: World) -> None:
    robot, here = near(string_reef)
    first = robot.observe()
    again = sent(robot, (here.x, here.y, here.yaw))
    assert again.rgb.tobytes() == first.rgb.tobytes()
    for name in ("depth", "labels"):
        assert getattr(again, name).tobytes() != getattr(first, name).tobytes()


def test_another_start_has_other_noise(empty_world: World) -> None:
    # From any two places a flat world without anything looks the same but for them.
    depths = []
    for start in empty_world.starts[:2]:
        seen = sent(Teleport(empty_world, DREAM_V1_NOISY, start), (0.0, 0.0, 0.0))
        depths.append(seen.depth.tobytes())
        assert seen.pose == SE2(0.0, 0.0, 0.0)
    assert depths[0] != depths[1]
