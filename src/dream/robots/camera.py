"""The camera of a simulated robot."""

from __future__ import annotations

from functools import cached_property

from dream.geometry import SE2, SE3, camera_mount
from dream.protocol import SurveyProtocol
from dream.sim.camera_noise import noise_generator, with_noise
from dream.sim.render import Frame, Renderer
from dream.sim.world import World
from dream.types import Observation


class SimulatedCamera:
    """Draws what a robot sees, with the errors that the protocol declares.

    Assumes: it is told of every move, since errors are drawn anew with each.
    """

    def __init__(
        self, world: World, protocol: SurveyProtocol, start: SE2, renderer: Renderer | None, fineness: int
    ) -> None:
        """In a world.

        Args:
            world: Where.
            protocol: How it looks, and what it gets wrong.
            start: Where the mission began: its errors follow from that.
            renderer: Of this world, where one is made already.
            fineness: Pixels of colour along each side of a pixel of depth and labels.
        """
        self._world = world
        self._protocol = protocol
        self._start = start
        self._given = renderer
        self._fineness = fineness

    @cached_property
    def _renderer(self) -> Renderer:
        """Made at the first look: a tour that is only driven needs none."""
        return self._given or Renderer(self._world)

    def observe(self, time: float, moves: int, truth: SE3, believed: SE3, tilt: float) -> Observation:
        """One frame.

        Args:
            time: When.
            moves: Of the robot since the start.
            truth: `T_world_base` that it is drawn from.
            believed: `T_world_base` that the observation says.
            tilt: Pitch of the camera, radians, positive downwards.
        """
        T_base_camera = camera_mount(tilt)
        frame = self._frame(truth @ T_base_camera, moves)
        rgb = frame.rgb
        if self._fineness > 1:
            fine = self._protocol.camera.scaled(self._fineness)
            rgb = self._renderer.render(fine, truth @ T_base_camera).rgb
        return Observation(
            time=time,
            rgb=rgb,
            depth=frame.depth,
            labels=frame.labels,
            camera=self._protocol.camera,
            T_world_base=believed,
            T_base_camera=T_base_camera,
        )

    def _frame(self, T_world_camera: SE3, moves: int) -> Frame:
        camera, noise = self._protocol.camera, self._protocol.noise
        frame = self._renderer.render(camera, T_world_camera)
        if noise is None:
            return frame
        rng = noise_generator(self._world, self._start, moves)
        return with_noise(frame, camera, T_world_camera, noise, rng, hull=self._world.hull)
