"""The camera of a simulated robot."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from dream.geometry import SE2, SE3, camera_mount
from dream.perception import Parallax, Perception, Sight, View, beam_ends
from dream.protocol import Grain, LastingErrors, SurveyProtocol
from dream.sim.camera_noise import grainy, noise_generator, with_noise
from dream.sim.lasting import mission_errors, with_wrong_labels
from dream.sim.render import Frame, Renderer
from dream.sim.sounding import Sounder, altitude
from dream.sim.visual_range import through_water
from dream.sim.world import UInt8Array, World
from dream.types import Label, Observation

AMIDSHIPS = SE3(np.eye(3), np.zeros(3))
"""Where the DVL sits."""


class SimulatedCamera:
    """Draws what a robot sees, with the errors that the protocol declares.

    What it does: drawn is what is there. Labels are then wrong where they are wrong all mission long; depth
    and labels end where the water's range does; the frame's own noise comes on top, and the mission's errors
    of scale last. Colours stay as they are drawn. Where the protocol is one of sight, a network tells labels
    and depth instead, from colours, pose and altitude, and nothing else of the world goes in.

    Assumes: it is told of every move, since errors are drawn anew with each.
    """

    def __init__(
        self,
        world: World,
        protocol: SurveyProtocol,
        start: SE2,
        renderer: Renderer | None,
        fineness: int,
        perception: Perception | None = None,
    ) -> None:
        """In a world.

        Args:
            world: Where.
            protocol: How it looks, and what it gets wrong.
            start: Where the mission began: its errors follow from that.
            renderer: Of this world, where one is made already.
            fineness: Pixels of colour along each side of a pixel of depth and labels.
            perception: Tells labels and depth under a protocol of sight; the network that comes with DREAM
                unless given.
        """
        self._world = world
        self._protocol = protocol
        self._start = start
        self._given = renderer
        self._fineness = fineness
        self._told_by = perception
        self.errors = mission_errors(world, start, protocol.lasting or LastingErrors())
        """What this mission gets wrong from start to end: zeros where the protocol declares nothing."""

    @cached_property
    def _renderer(self) -> Renderer:
        """Made at the first look: a tour that is only driven needs none."""
        return self._given or Renderer(self._world)

    @cached_property
    def _perception(self) -> Perception:
        if self._told_by is not None:
            return self._told_by.anew
        sight = Sight()
        return Perception(sight, sight, Parallax())

    @cached_property
    def _missed_as(self) -> UInt8Array:
        """(N,) what each individual is taken for that is not recognised; see `with_noise`."""
        return np.where(self._world.hull, Label.OBSTACLE, Label.SEABED).astype(np.uint8)

    def observe(
        self,
        time: float,
        moves: int,
        truth: SE3,
        believed: SE3,
        tilt: float,
        drawn_wh: float,
        light: float = 1.0,
    ) -> Observation:
        """One frame.

        Args:
            time: When.
            moves: Of the robot since the start.
            truth: `T_world_base` that it is drawn from.
            believed: `T_world_base` that the robot's own sensors say. The observation's is off from it by the
                mission's error of height.
            tilt: Pitch of the camera, radians, positive downwards, that it is drawn with. The observation's
                is off from it by the mission's error of tilt.
            drawn_wh: Watt-hours that the robot has drawn so far.
            light: Share of the light that is left in its colours.
        """
        T_world_camera = truth @ camera_mount(tilt)
        if self._protocol.seen is not None:
            seen = self._seen(time, moves, truth, believed, tilt, self._protocol.seen, light)
            return replace(seen, drawn_wh=drawn_wh)
        frame = self._frame(T_world_camera, moves)
        rgb = frame.rgb
        if self._fineness > 1:
            fine = self._protocol.camera.scaled(self._fineness)
            rgb = self._renderer.render(fine, T_world_camera).rgb
        return Observation(
            time=time,
            rgb=_lit(rgb, light),
            depth=frame.depth,
            labels=frame.labels,
            camera=self._protocol.camera,
            T_world_base=_raised(believed, self.errors.height),
            T_base_camera=camera_mount(tilt + self.errors.tilt),
            drawn_wh=drawn_wh,
        )

    def _seen(
        self,
        time: float,
        moves: int,
        truth: SE3,
        believed: SE3,
        tilt: float,
        grain: Grain,
        light: float,
    ) -> Observation:
        """One frame by sight: colours as the camera gives them, and what is made of them."""
        camera = self._protocol.camera
        fine = camera.scaled(self._fineness) if self._fineness > 1 else camera
        drawn = self._renderer.render(fine, truth @ camera_mount(tilt)).rgb
        rgb = grainy(_lit(drawn, light), grain, noise_generator(self._world, self._start, moves))
        T_world_base, mount = _raised(believed, self.errors.height), camera_mount(tilt + self.errors.tilt)
        ranges = Sounder(self._renderer).ranges(truth)
        above = altitude(ranges) if np.isfinite(ranges).any() else self._protocol.altitude
        view = View(camera, T_world_base, mount, above, beam_ends(ranges, AMIDSHIPS))
        shows = self._perception.perceive(rgb, view)
        return Observation(
            time=time,
            rgb=rgb,
            depth=shows.depth,
            labels=shows.labels,
            camera=camera,
            T_world_base=T_world_base,
            T_base_camera=mount,
            confidence=shows.confidence,
            error=shows.error,
        )

    def _frame(self, T_world_camera: SE3, moves: int) -> Frame:
        protocol, camera, world = self._protocol, self._protocol.camera, self._world
        frame = self._renderer.render(camera, T_world_camera)
        if protocol.lasting is not None:
            labels = with_wrong_labels(
                frame, camera, T_world_camera, protocol.lasting, self.errors.key, self._missed_as
            )
            frame = replace(frame, labels=labels)
        if protocol.space is not None:
            frame = through_water(frame, camera, world.water, protocol.space, protocol.max_depth)
        if protocol.noise is not None:
            rng = noise_generator(world, self._start, moves)
            frame = with_noise(frame, camera, T_world_camera, protocol.noise, rng, hull=world.hull)
        if self.errors.depth != 0.0:
            frame = replace(frame, depth=frame.depth * np.float32(1.0 + self.errors.depth))
        return frame


def _lit(rgb: UInt8Array, light: float) -> UInt8Array:
    """Colours with a share of their light; the very same where that is 1."""
    return rgb if light == 1.0 else np.rint(rgb * light).astype(np.uint8)


def _raised(T_world_base: SE3, by: float) -> SE3:
    """The pose so many metres higher; the very same where that is 0."""
    if by == 0.0:
        return T_world_base
    return SE3(T_world_base.rotation, T_world_base.translation + np.array([0.0, 0.0, by]))
