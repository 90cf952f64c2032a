"""A robot that has to swim, and knows where it is only by its sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from dream.control._kernels import begin
from dream.control.autopilot import Autopilot, nominal
from dream.control.diagnosis import Diagnosis, NamedFault, controllable, failing, found, learnt_before
from dream.control.diagnosis._kernels import forget
from dream.control.health import Condition, Watch
from dream.errors import MissionAborted
from dream.estimation import InEkf, InEkfState, InertialErrors, Mounting, Start
from dream.geometry import SE2, SE3, wrap_angle
from dream.perception.lighting import Lighting
from dream.protocol import SurveyProtocol
from dream.robots import _kernels
from dream.robots.camera import SimulatedCamera
from dream.robots.teleport import launch_height
from dream.sim.camera_noise import noise_generator
from dream.sim.render import Renderer
from dream.sim.sensors import (
    AHRS,
    BAR30,
    DVL_A50,
    ICM_20602,
    RANGE_MODES,
    Bursts,
    Compass,
    DopplerLog,
    InertialUnit,
    Outage,
    PressureGauge,
)
from dream.sim.sensors.outage import table
from dream.sim.solids import Solids
from dream.sim.vehicle import BLUEROV2_HEAVY, Current, Diverged, Spread, State, Vehicle
from dream.sim.world import World
from dream.types import Arrival, Observation, Setpoint
from dream.vehicle import GRAVITY, HOTEL_W, Fault, PartFault, ThrusterFault, VehiclePart, light, watt_points
from dream.vehicle._kernels import NO_FAULT

BEAT = 0.01
"""Seconds of water, inertial unit, estimate and autopilot."""
HELD = 10.0
"""Seconds that it is held still at the launch, for the biases of its gyroscopes and of its compass."""
STEADY = 40.0
"""Seconds for which a compass errs alike: iron turns it by the heading, which a survey keeps for a lane, so
that the readings within that time say no more than one."""
STAY = 0.3
"""Seconds at a setpoint that count as having arrived. The servo of the camera (Hitec HS-5055MG, 60° in 0.2 s)
has tilted it by then."""
ROOM = 30.0
"""Seconds that a move, or the way up, may take beyond what it takes at half the speeds."""
JOULES = 3600.0
"""Of a watt-hour."""
SURFACED = 0.5
"""Metres of its true depth at which it has."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What swims, in what, and by what it finds its way."""

    vehicle: Vehicle = BLUEROV2_HEAVY
    """As the autopilot believes it to be."""
    spread: Spread = field(default_factory=Spread)
    """How far the one in the water is from that."""
    current: float = 0.1
    """m/s of the mean current, from a direction that is drawn for each mission."""
    gust: float = 0.03
    """m/s by which it varies."""
    imu: InertialUnit = ICM_20602
    dvl: DopplerLog = DVL_A50
    gauge: PressureGauge = BAR30
    compass: Compass = AHRS
    autopilot: Autopilot = field(default_factory=Autopilot)
    watch: Watch = field(default_factory=Watch)
    diagnosis: Diagnosis = field(default_factory=Diagnosis)
    outages: tuple[Outage, ...] = ()
    """When its sensors are silent."""
    dvl_bursts: Bursts = field(default_factory=Bursts)
    """When its DVL loses the bottom, for no reason that is seen."""
    fault: Fault | None = None
    """Of one of its thrusters or parts, of which the autopilot is not told."""
    low_volts: float = 14.4
    """Of its battery, under load and smoothed over 3 s, below which it sags, as a BlueROV2 is called home."""
    near: float = 0.05
    """Metres from a setpoint, by the estimate, that count as there."""
    aligned: float = math.radians(2.0)
    """Radians, likewise."""
    slow: float = 0.05
    """m/s, likewise."""

    def __post_init__(self) -> None:
        for name in ("current", "gust"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected 0 m/s or more, got {getattr(self, name)}")
        for name in ("near", "aligned", "slow"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected a tolerance above 0, got {getattr(self, name)}")
        if not 0.0 < self.low_volts < math.inf:
            raise ValueError(f"low_volts: expected a voltage above 0, got {self.low_volts}")
        for name, rate in (("gauge", self.gauge.rate), ("compass", self.compass.rate)):
            every = 1.0 / (rate * BEAT)
            if every < 1.0 - 1e-9 or abs(every - round(every)) > 1e-6:
                raise ValueError(f"{name}.rate: expected a part of {1.0 / BEAT:g} Hz, got {rate:g}")
        if isinstance(self.fault, ThrusterFault):
            self.fault.check_fits(self.vehicle.thrusters.count)
        if abs(self.imu.rate * BEAT - 1.0) > 1e-9:
            raise ValueError(f"imu.rate: expected {1.0 / BEAT:g} Hz, as the loop, got {self.imu.rate:g}")

    def fails_at(self, part: VehiclePart) -> float:
        """Seconds of the mission at which a part fails; infinite where it does not."""
        if isinstance(self.fault, PartFault) and self.fault.part is part:
            return self.fault.at_s
        return math.inf

    @property
    def helmsman(self) -> Autopilot:
        """The autopilot at speeds that the vehicle bears."""
        return self.autopilot.upright(self.vehicle.hull, self.vehicle.thrusters)

    @property
    def estimator(self) -> InEkf:
        """That knows where these instruments sit, and was held still at the launch."""
        start = Start(
            tilt=math.radians(1.0),
            yaw=math.radians(0.5),
            velocity=0.01,
            gyro_bias=2.0 * self.imu.gyro_noise / math.sqrt(HELD),
        )
        errors = InertialErrors(
            gyro_noise=self.imu.gyro_noise,
            accelerometer_noise=self.imu.accel_noise,
            gyro_walk=self.imu.gyro_walk,
            accelerometer_walk=self.imu.accel_walk,
            gyro_range=self.imu.gyro_range,
            accelerometer_range=self.imu.accel_range,
            rate=self.imu.rate,
            gravity=GRAVITY,
        )
        mounting = Mounting(self.dvl.T_base_dvl, self.gauge.position)
        return InEkf(imu=errors, mounting=mounting, start=start)


class Simulated:
    """Swims to where it is sent, as far as it knows where it is.

    What it does: the vehicle of `sim.vehicle` in a current, the sensors of `sim.sensors`, the invariant
    filter of `estimation` and the autopilot of `control`, in one compiled loop at 100 Hz. What it observes is
    drawn from where it really is, and says where it believes to be. A contact ends the move. At the launch it
    was held still at a pose that it knows as well as the filter's `Start` says, which frees the gyroscopes of
    their bias and sets the compass. Once the fault of a thruster is named, it goes on with the others,
    slower; where the others do not do, it surfaces. Without its depth sensor it has heights from the DVL, and
    of a dark picture it believes nothing. Its observations tell of the trouble.

    Assumes: a launch whose pose in the map is known to about a degree and a centimetre.
    Fails when: the estimate is lost, which ends the mission by its name.
    """

    def __init__(
        self,
        world: World,
        protocol: SurveyProtocol,
        start: SE2 | None = None,
        *,
        motion: Motion | None = None,
        renderer: Renderer | None = None,
        solids: Solids | None = None,
        fineness: int = 1,
    ) -> None:
        """Put the robot into the world, at its first start pose unless told otherwise.

        Args:
            world: Where.
            protocol: By which rules it looks and moves.
            start: Snapped to the lattice.
            motion: What swims, and by what it finds its way; a BlueROV2 Heavy with a DVL A50 unless given.
            renderer: Of this world, where one is made already.
            solids: Of this world, where they are made already.
            fineness: Pixels of colour along each side of a pixel of depth and labels.
        """
        pose = world.starts[0] if start is None else start
        if not world.bounds.contains(pose.x, pose.y):
            raise ValueError(f"start: expected a pose inside {world.bounds}, got ({pose.x}, {pose.y})")
        pose = protocol.snap(pose)
        self._motion = motion = Motion() if motion is None else motion
        self._protocol = protocol
        self._camera = SimulatedCamera(world, protocol, pose, renderer, fineness)
        # The first move's randomness is the camera's, too; the vehicle's is its own.
        self._rng = noise_generator(world, pose, -1)
        seabed = float(world.terrain.height(pose.x, pose.y))
        z = launch_height(world, protocol, pose) - self._camera.errors.height
        T_world_base = SE3.level(pose.x, pose.y, z, pose.yaw)
        self._tilt = protocol.camera_pitch
        self._depth = -float(T_world_base.translation[2])
        self._moves = 0
        self._lighting = Lighting()
        self.finding: NamedFault | None = None
        """The fault of a thruster, once it is named."""
        self.ailing: dict[VehiclePart, str] = {}
        """What is wrong with battery and depth sensor, once it is named, in words."""
        self._ship, self._voyage = _launched(
            motion, protocol, solids or Solids(world), T_world_base, seabed, self._rng
        )
        if _kernels.clearance(self._ship, self._voyage.x) <= 0.0:
            raise ValueError(f"start: ({pose.x}, {pose.y}) touches the world. See `dream draw`")
        filtering = motion.estimator
        state = filtering.begin(0.0, *filtering.start.draw(T_world_base, self._rng))
        rates = self._voyage.bias[:3] + motion.imu.gyro_noise / math.sqrt(HELD) * self._rng.standard_normal(3)
        self._state = self._at_ping = replace(state, gyro_bias=rates).packed

    def observe(self) -> Observation:
        """One frame from where it really is, with the pose that it believes in; the same until it moves."""
        now = float(self._voyage.clock[_kernels.TIME])
        seen = self._camera.observe(
            now,
            self._moves,
            self.truth,
            self.estimate.pose,
            self._tilt,
            float(self._voyage.clock[_kernels.DRAWN]) / JOULES,
            light(self._motion.fault, now),
        )
        seen = self._lighting.seen(seen)
        return replace(seen, trouble="; ".join(filter(None, (*self._troubles, self._lighting.trouble))))

    def go_to(self, setpoint: Setpoint) -> Arrival:
        """Swim there; at contact, stop. The camera tilts on the way.

        It follows the seabed at the setpoint's altitude, or leads straight to its height: by the pressure,
        since the filter has its heights from there.

        Raises:
            MissionAborted: The estimate is not to be trusted any more, or the thrusters that are left do not
            do; the vehicle has surfaced, or tried to.
            Diverged: The simulated motion is not: a parameter is wrong.
        """
        east, north, up = self.estimate.position.tolist()
        gap = math.hypot(setpoint.x - east, setpoint.y - north)
        if setpoint.z is not None:
            # Where it is sent is a height as its observations tell it.
            setpoint = replace(setpoint, z=setpoint.z - self._camera.errors.height)
            gap = math.hypot(gap, setpoint.z - up)
        clock, before = self._voyage.clock, self._troubles
        clock[[_kernels.DISTANCE, _kernels.WAY, _kernels.CONDITION]] = 0.0
        clock[_kernels.CLEARANCE] = math.inf
        how = self._fly(setpoint, self._seconds(gap))
        if how == _kernels.NAMED:
            how = self._fly(setpoint, self._seconds(gap))
        self._moves += 1
        self._tilt = self._tilt if setpoint.tilt is None else setpoint.tilt
        condition = Condition(int(clock[_kernels.CONDITION]))
        if how == _kernels.GIVEN_UP:
            raise MissionAborted(f"navigation: {condition.name.lower()}; {self._surface()}")
        if how == _kernels.BROKEN:
            raise Diverged(
                f"motion: expected one that stays near the world, got none on the way to {setpoint}"
            )
        collided, (x, y, z) = how == _kernels.COLLIDED, self.estimate.position.tolist()
        return Arrival(
            self.estimate.pose.se2,
            collided=collided,
            distance=float(clock[_kernels.DISTANCE if setpoint.z is None else _kernels.WAY]),
            clearance=float(clock[_kernels.CLEARANCE]),
            note=_note(
                condition, [one for one in self._troubles if one not in before], late=how == _kernels.LATE
            ),
            sigma=float(_kernels.position_sigma(self._state)),
            truth=self.truth,
            contact=(x, y, z + self._camera.errors.height) if collided else None,
        )

    @property
    def truth(self) -> SE3:
        """`T_world_base` as it is."""
        return State.of(self._voyage.x).T_world_base

    @property
    def estimate(self) -> InEkfState:
        """What it knows of its motion."""
        return InEkfState(*self._state)

    @property
    def _troubles(self) -> list[str]:
        """What is wrong with thrusters, battery and depth sensor."""
        return [*([] if self.finding is None else [str(self.finding)]), *self.ailing.values()]

    def _seconds(self, gap: float) -> float:
        """That a move over so many metres may take."""
        gains = self._ship.gains
        return 2.0 * gap / gains.speed + 2.0 * math.pi / gains.turn_rate + ROOM

    def _adapt(self, finding: NamedFault) -> None:
        """Go on with the thrusters that are left, slower, as if what was learnt since had not been.

        Raises:
            MissionAborted: They do not do.
        """
        self.finding = finding
        motion, voyage = self._motion, self._voyage
        hull, thrusters = motion.vehicle.slowest, motion.vehicle.thrusters
        pace = motion.diagnosis.pace
        names = ("speed", "acceleration", "turn_rate", "turn_acceleration", "ascent")
        slower = {name: pace * getattr(motion.helmsman, name) for name in names}
        self._ship = self._ship._replace(
            nominal=failing(self._ship.nominal, hull, thrusters, finding),
            gains=replace(motion.helmsman, **slower).gains,
        )
        voyage.memory[8:14] = learnt_before(voyage.diagnosis)
        voyage.memory[4:8] *= pace
        if not controllable(thrusters, finding):
            raise MissionAborted(f"{finding}, and the others cannot steer without it; {self._surface()}")

    def _surface(self) -> str:
        """Go straight up, without an estimate; how that went."""
        began = self._voyage.clock[_kernels.TIME]
        seconds = 2.0 * self._depth / self._ship.gains.ascent + ROOM
        if not _kernels.surface(self._ship, self._voyage, seconds, self._rng):
            raise Diverged("motion: expected one that stays near the world, got none on the way up")
        deep, took = -float(self._voyage.x[2]), self._voyage.clock[_kernels.TIME] - began
        said = "surfaced" if deep <= SURFACED else "could not surface"
        return f"the vehicle {said}: it is {deep:.1f} m deep after {took:.0f} s"

    def _fly(self, goal: Setpoint, seconds: float) -> int:
        motion = self._motion
        self._state, self._at_ping, how, _ = _kernels.fly(
            self._ship,
            self._voyage,
            self._state,
            self._at_ping,
            np.array([goal.x, goal.y, goal.yaw]),
            math.nan if goal.altitude is None else float(goal.altitude),
            math.nan if goal.z is None else float(goal.z),
            seconds,
            motion.near,
            motion.aligned,
            motion.slow,
            STAY,
            self._rng,
            np.empty((0, 9)),
        )
        if how == _kernels.COLLIDED:
            # From where it stands now, the next move begins anew.
            self._voyage.memory[:] = begin(
                self._state.position, self.estimate.pose.yaw, motion.autopilot.drag_share
            )
            # What the vehicle touches pushes it, too.
            forget(self._voyage.diagnosis)
        self._look_over()
        if self.finding is None:
            named = found(self._voyage.diagnosis, float(self._voyage.clock[_kernels.TIME]))
            if named is not None:
                self._adapt(named)
        return int(how)

    def _look_over(self) -> None:
        """Name what the loop has found wrong with battery and depth sensor."""
        clock = self._voyage.clock
        volts = float(clock[_kernels.LEAST_VOLTS])
        if volts < self._motion.low_volts:
            self.ailing.setdefault(VehiclePart.SAG, f"the battery sags to {volts:.1f} V")
        if math.isfinite(clock[_kernels.STUCK]):
            self.ailing.setdefault(VehiclePart.GAUGE, "the depth sensor is stuck")
        if math.isfinite(clock[_kernels.SILENT]):
            self.ailing.setdefault(VehiclePart.GAUGE, "the depth sensor is silent")


def _note(condition: Condition, named: list[str], *, late: bool) -> str:
    told = {
        Condition.BLIND: "no bottom track for a while: it went slowly",
        Condition.LOST: "no bottom track for long: it held",
    }
    parts = [told[condition]] if condition in told else []
    parts += named
    if late:
        parts.append("the move took too long and was broken off")
    return "; ".join(parts)


def _launched(
    motion: Motion,
    protocol: SurveyProtocol,
    solids: Solids,
    T_world_base: SE3,
    seabed: float,
    rng: np.random.Generator,
) -> tuple[_kernels.Ship, _kernels.Voyage]:
    """The vehicle at rest over ground, with all errors of its mission drawn."""
    truth = motion.spread.draw(motion.vehicle, rng)
    bearing = rng.uniform(-math.pi, math.pi)
    east, north = motion.current * math.cos(bearing), motion.current * math.sin(bearing)
    current = Current(mean=(east, north, 0.0), gust=motion.gust)
    tops, rates = np.array(RANGE_MODES, np.float64).T.copy()
    filtering = motion.estimator
    x, error = truth.at_rest(T_world_base), motion.compass.begin(rng)
    off = []
    for k in range(round(HELD * motion.compass.rate)):
        heading, error = motion.compass.read(k / motion.compass.rate, x, error, rng)
        off.append(wrap_angle(heading.yaw - T_world_base.yaw))
    zero = float(np.mean(off))
    watt_commands, watt_roots = watt_points(truth.thrusters.voltage)
    ship = _kernels.Ship(
        body=truth.body,
        fault=motion.fault.packed if isinstance(motion.fault, ThrusterFault) else NO_FAULT,
        sags_at=motion.fails_at(VehiclePart.SAG),
        sticks_at=motion.fails_at(VehiclePart.GAUGE),
        flow=current.flow,
        solids=solids.index,
        radius=protocol.body_radius,
        height=protocol.body_height,
        inertial=motion.imu.constants,
        acoustic=motion.dvl.constants,
        gauge=motion.gauge.constants,
        magnetic=motion.compass.constants,
        ping_tops=tops,
        ping_rates=rates,
        depth_sigma=motion.gauge.sigma,
        heading_sigma=motion.compass.sigma * math.sqrt(2.0 * motion.compass.rate * STEADY),
        heading_zero=zero,
        scale=motion.dvl.begin(rng),
        outages=table(motion.outages),
        bursts=motion.dvl_bursts.means,
        filter=filtering.compiled,
        gains=motion.helmsman.gains,
        nominal=nominal(motion.vehicle.slowest, motion.vehicle.thrusters),
        plant=motion.diagnosis.plant(motion.vehicle.slowest, motion.vehicle.thrusters),
        limits=motion.watch.limits,
        stuck_rise=motion.gauge.stuck_rise,
        stuck_readings=float(motion.gauge.stuck_readings),
        rest_volts=float(truth.thrusters.voltage),
        watt_commands=watt_commands,
        watt_roots=watt_roots,
        hotel=HOTEL_W,
        dt=BEAT,
        depth_every=round(1.0 / (motion.gauge.rate * BEAT)),
        heading_every=round(1.0 / (motion.compass.rate * BEAT)),
    )
    clock = np.zeros(_kernels.CLOCK)
    clock[_kernels.SENT], clock[_kernels.SEABED] = -1.0, seabed
    clock[[_kernels.FAILED, _kernels.LEAST_VOLTS, _kernels.STUCK, _kernels.SILENT]] = math.inf
    clock[[_kernels.VOLTS, _kernels.MEAN_VOLTS]] = truth.thrusters.voltage
    clock[_kernels.READING] = math.nan
    voyage = _kernels.Voyage(
        x=x.vector,
        contact=np.zeros(3),
        gust=current.begin(rng),
        bias=motion.imu.begin(rng),
        gauge_error=motion.gauge.begin(rng),
        compass_error=error,
        memory=begin(x.position, T_world_base.yaw, motion.autopilot.drag_share),
        commands=np.zeros(truth.thrusters.count),
        diagnosis=motion.diagnosis.begin(motion.vehicle.slowest, motion.vehicle.thrusters),
        clock=clock,
        sample=np.array([0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY, math.nan, math.nan]),
        # It ends at once, and the good state begins.
        chain=np.array([1.0, 0.0]),
        ping_velocity=np.zeros(3),
        ping_covariance=np.zeros((3, 3)),
        since=np.zeros((_kernels.MOST_BEATS, 8)),
    )
    return ship, voyage
