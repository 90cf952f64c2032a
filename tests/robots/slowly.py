"""The loop of `Simulated` beat by beat, from the objects of the package: a slow twin of the compiled one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from dream.control.health import Condition
from dream.estimation import InEkfState
from dream.geometry import SE2, SE3, wrap_angle
from dream.measurements import Depth, Heading, Imu
from dream.protocol import SurveyProtocol
from dream.robots import Motion, _kernels
from dream.robots.simulated import BEAT, HELD, STEADY
from dream.robots.teleport import launch_height
from dream.sim.camera_noise import noise_generator
from dream.sim.sensors import Ping
from dream.sim.solids import Solids
from dream.sim.vehicle import Contact, Current, held
from dream.sim.world import World

Array = npt.NDArray[np.float64]
Beat = tuple[Imu, Depth | None, Heading | None]


class Slow:
    """A launch and its beats. Randomness is drawn in the order in which the compiled loop draws it."""

    def __init__(
        self, world: World, protocol: SurveyProtocol, start: SE2, motion: Motion, solids: Solids
    ) -> None:
        self.motion, self.protocol, self.solids = motion, protocol, solids
        self.rng = rng = noise_generator(world, start, -1)
        self.seabed = float(world.terrain.height(start.x, start.y))
        T_world_base = SE3.level(start.x, start.y, launch_height(world, protocol, start), start.yaw)
        self.vehicle = motion.spread.draw(motion.vehicle, rng)
        bearing = rng.uniform(-math.pi, math.pi)
        east, north = motion.current * math.cos(bearing), motion.current * math.sin(bearing)
        self.current = Current(mean=(east, north, 0.0), gust=motion.gust)
        self.state = self.vehicle.at_rest(T_world_base)
        self.compass_error, off = motion.compass.begin(rng), []
        for k in range(round(HELD * motion.compass.rate)):
            time = k / motion.compass.rate
            heading, self.compass_error = motion.compass.read(time, self.state, self.compass_error, rng)
            off.append(wrap_angle(heading.yaw - T_world_base.yaw))
        self.zero = float(np.mean(off))
        self.scale = motion.dvl.begin(rng)
        self.gust = self.current.begin(rng)
        self.bias = motion.imu.begin(rng)
        self.gauge_error = motion.gauge.begin(rng)
        self.filter = motion.estimator
        begun = self.filter.begin(0.0, *self.filter.start.draw(T_world_base, rng))
        rates = self.bias[:3] + motion.imu.gyro_noise / math.sqrt(HELD) * rng.standard_normal(3)
        self.estimate = self.at_ping = replace(begun, gyro_bias=rates)
        self.helm = motion.autopilot.begin(motion.vehicle.slowest, motion.vehicle.thrusters, T_world_base)
        self.contact = Contact()
        self.ping: Ping | None = None
        self.since: list[Beat] = []
        self.next_ping = self.last_dvl = self.last_depth = 0.0
        self.beats, self.time = 0, 0.0
        self.condition = Condition.FINE

    def carried(self, estimate: InEkfState, beat: Beat) -> InEkfState:
        imu, depth, heading = beat
        estimate = self.filter.predict(estimate, imu, BEAT)
        for message in (depth, heading):
            if message is not None:
                estimate = self.filter.correct(estimate, message)
        return estimate

    def beat(self, goal: SE2, z: float | None = None) -> None:
        """Towards a goal, at the protocol's altitude unless a height is given."""
        motion, rng, estimate, time = self.motion, self.rng, self.estimate, self.time
        if self.beats % _kernels.CHECKED == 0:
            self.condition = motion.watch.condition(
                imu_age=0.0,
                depth_age=time - self.last_depth,
                dvl_age=time - self.last_dvl,
                velocity_sigma=_kernels.velocity_sigma(estimate.packed),
                position_sigma=_kernels.position_sigma(estimate.packed),
            )
        assert self.condition is Condition.FINE
        height = self.seabed + self.protocol.altitude if z is None else z
        target = (goal.x, goal.y, height, goal.yaw)
        commands = self.helm.steer(
            estimate.pose, estimate.velocity, estimate.angular_velocity, target, BEAT
        )  # fmt: skip

        before = self.state
        self.gust = self.current.stirred(self.gust, BEAT, rng)
        after = self.vehicle.step(before, commands, BEAT, self.current, gust=self.gust)
        self.state, self.contact = held(
            self.vehicle, self.solids, self.protocol, before, after, self.contact
        )  # fmt: skip
        self.beats += 1
        self.time = now = time + BEAT

        imu, self.bias = motion.imu.read(now, before, self.state, self.bias, rng)
        depth = heading = None
        if self.beats % round(1.0 / (motion.gauge.rate * BEAT)) == 0:
            depth, self.gauge_error = motion.gauge.read(now, self.state, self.gauge_error, rng)
            self.last_depth = now
        if self.beats % round(1.0 / (motion.compass.rate * BEAT)) == 0:
            heading, self.compass_error = motion.compass.read(now, self.state, self.compass_error, rng)
            sigma = heading.sigma * math.sqrt(2.0 * motion.compass.rate * STEADY)
            heading = Heading(now, wrap_angle(heading.yaw - self.zero), sigma)
        felt: Beat = (imu, depth, heading)

        if self.ping is not None and now >= self.ping.arrives:
            estimate = self.filter.correct(self.at_ping, self.ping.dvl)
            for earlier in self.since:
                estimate = self.carried(estimate, earlier)
            # Nothing is refused in these flights.
            dvl = self.ping.dvl
            seabed = self.at_ping.position[2] + motion.dvl.position[2] - dvl.altitude
            part = min(1.0 / motion.dvl.rate(dvl.altitude) / _kernels.SEABED_TIME, 1.0)
            self.seabed += part * (float(seabed) - self.seabed)
            self.ping, self.since, self.last_dvl = None, [], now
        self.estimate = estimate = self.carried(estimate, felt)
        if self.ping is not None:
            self.since.append(felt)
        elif now >= self.next_ping:
            ping = motion.dvl.ping(now, self.state, self.solids, self.scale, rng)
            self.next_ping = now + 1.0 / motion.dvl.rate(ping.dvl.altitude)
            if ping.dvl.valid:
                self.ping, self.at_ping = ping, estimate
