"""Survey protocols: the sensor, the moves and the rules that a number is only meaningful with.

`dream-v1` is fixed for ever; another sensor or another set of moves is another named protocol.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from dream.geometry import SE2, SE3, Camera, camera_mount, wrap_angle
from dream.names import look_up

PADDED = 1e-6
"""A depth that is nearer than this share below the greatest is the greatest itself, as float32 or millimetres
write it: what many sensors say where nothing returns."""
TRUSTED = 0.8
"""Share of labels that must be right for them to be trusted."""
ORDERED = ("reach", "group_radius", "cap")
"""Fields that go by the site where a protocol moves in space, see `SurveyProtocol.ordered`."""
SHOWN = 2
"""Pixels of the picture that a model is shown, along each side of a pixel of the camera for mapping."""


def farthest_return(max_depth: float) -> float:
    """The greatest depth, metres, that is not what stands for none."""
    return max_depth * (1.0 - PADDED)


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """What depth and labels get wrong, in each frame anew. Poses and colours stay true."""

    depth: float
    """Per metre: a depth z scatters by σ = `depth` z², as that of a stereo pair does."""
    missed: float
    """Probability that an individual in view is not recognised: all its pixels, in that frame."""
    false_targets: float
    """Mean number of spots of bare seabed in a frame that are taken for a target."""
    false_size: tuple[float, float]
    """Least and greatest width of such a spot on the ground, evenly between; metres."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.depth < math.inf:
            raise ValueError(f"noise.depth: expected 0 or more per metre, got {self.depth}")
        if not 0.0 <= self.missed <= 1.0:
            raise ValueError(f"noise.missed: expected a probability, got {self.missed}")
        if not 0.0 <= self.false_targets <= 100.0:
            raise ValueError(f"noise.false_targets: expected 0 to 100 in a frame, got {self.false_targets}")
        if not 0.0 < self.false_size[0] <= self.false_size[1] < math.inf:
            raise ValueError(
                f"noise.false_size: expected two widths above 0 m, the lesser first, got {self.false_size}"
            )


@dataclass(frozen=True, slots=True)
class LastingErrors:
    """What a sensor gets wrong again and again: at the same places, or all mission long.

    Looking again does not help. Each is switched off where it is 0, or empty.
    """

    labels: tuple[tuple[float, float], ...] = ()
    """Metres from the camera and the share of surface whose label is wrong there; straight between two of
    them, up to the first and from the last one on the same."""
    blob: tuple[float, float] = (0.5, 2.0)
    """Least and greatest width of a piece of surface whose label is wrong, fixed in the world; metres."""
    depth: float = 0.0
    """Greatest share of its range by which depth is off, one share a mission, evenly between both signs."""
    height: float = 0.0
    """Greatest metres by which the height of the vehicle is off, likewise."""
    tilt: float = 0.0
    """Greatest radians by which the tilt of the camera is off, likewise."""

    def __post_init__(self) -> None:
        far = [metres for metres, _ in self.labels]
        if far != sorted(set(far)) or not all(
            0.0 <= m < math.inf and 0.0 <= share <= 0.9 for m, share in self.labels
        ):
            raise ValueError(
                f"lasting.labels: expected rising metres of 0 or more, each with a share in [0, 0.9], "
                f"got {self.labels}"
            )
        if not 0.2 <= self.blob[0] <= self.blob[1] <= 20.0:
            raise ValueError(
                f"lasting.blob: expected two widths from 0.2 to 20 m, the lesser first, got {self.blob}"
            )
        for name, most in (("depth", 0.5), ("height", 5.0), ("tilt", 0.5)):
            if not 0.0 <= getattr(self, name) <= most:
                raise ValueError(f"lasting.{name}: expected 0 to {most:g}, got {getattr(self, name)}")


@dataclass(frozen=True, slots=True)
class Grain:
    """What the sensor of a camera adds to a picture: noise of photons and of reading. Colours in [0, 1]."""

    photons: float
    """Of white: σ of light L is sqrt(L / `photons`)."""
    reading: float
    """σ of linear light whatever there is."""
    quality: int
    """Of the JPEG that the picture comes as."""

    def __post_init__(self) -> None:
        if not 1.0 <= self.photons < math.inf:
            raise ValueError(f"grain.photons: expected 1 or more, got {self.photons}")
        if not 0.0 <= self.reading <= 1.0:
            raise ValueError(f"grain.reading: expected 0 to 1, got {self.reading}")
        if not 1 <= self.quality <= 100:
            raise ValueError(f"grain.quality: expected 1 to 100, got {self.quality}")


@dataclass(frozen=True, slots=True)
class Space:
    """How a vehicle moves and looks in three dimensions. Metres and radians.

    Heights are absolute, as a pressure sensor gives them: a move leads straight to its end.
    """

    climbs: tuple[float, ...]
    """Allowed climbs, positive upwards, multiples of the lattice; 0 is always allowed. One is made together
    with turn and advance."""
    tilts: tuple[float, ...]
    """Allowed pitches of the camera, downwards; the tilt at the start is the protocol's `camera_pitch`."""
    lowest: float
    """Least height of the vehicle's centre above the ground."""
    highest: float
    """Greatest height above the ground, or above what stands on it, from which something counts as what can
    be inspected at all."""
    surface: float
    """Least depth of the vehicle's centre under water."""
    incidence: float
    """Greatest angle between a surface's normal and the line of sight at which it counts as inspected."""
    label_lengths: float
    """Labels are told as far as so many attenuation lengths of the water, and no farther than `max_depth`."""
    depth_lengths: float
    """Likewise depths."""

    def __post_init__(self) -> None:
        if not self.climbs or any(climb == 0.0 or not math.isfinite(climb) for climb in self.climbs):
            raise ValueError(f"space.climbs: expected metres other than 0, got {self.climbs}")
        if not self.tilts or any(not abs(tilt) < 0.5 * math.pi for tilt in self.tilts):
            raise ValueError(f"space.tilts: expected less than a quarter turn each, got {self.tilts}")
        for name in ("lowest", "highest", "surface", "label_lengths", "depth_lengths"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"space.{name}: expected more than 0, got {getattr(self, name)}")
        if not self.lowest < self.highest:
            raise ValueError(f"space.highest: expected more than {self.lowest} m, got {self.highest}")
        if not 0.0 < self.incidence < 0.5 * math.pi:
            raise ValueError(
                f"space.incidence: expected more than 0 and less than a quarter turn, got {self.incidence}"
            )


@dataclass(frozen=True, slots=True)
class SurveyProtocol:
    """Vehicle, camera, map and moves of a survey. Metres and radians."""

    name: str
    altitude: float
    """Height of the vehicle's centre above the bare seabed; boulders and reef do not lift it. In space, that
    at the start."""
    body_radius: float
    """The vehicle is a level cylinder."""
    body_height: float
    camera: Camera
    """For mapping; what a model is shown is `camera.scaled(SHOWN)`."""
    camera_pitch: float
    """Downwards."""
    min_depth: float
    max_depth: float
    """Depths along the optical axis outside these are not valid, nor is the greatest; see `returns`."""
    reach: float
    """How far over ground a label is trusted and a cell counts as explored (the paper's d_max); in space,
    how far straight through the water."""
    cell: float
    """Side of a map cell."""
    band: tuple[float, float]
    """Heights above the local seabed between which anything is solid (the paper's h_min and h_max)."""
    lattice: float
    """Spacing of the positions."""
    headings: int
    """Number of headings in a full turn."""
    turns: tuple[int, ...]
    """Allowed turns in heading steps, positive to the left."""
    advances: tuple[float, ...]
    """Nominal lengths of an advance; 0 (turn only) is always allowed."""
    launch_radius: float
    """Ground this near the start is known to be free."""
    group_radius: float
    """No group of targets is smaller than this: the prior that makes a stop justifiable."""
    cap: int
    """Steps after which a mission ends; an unfinished one counts as this many. In space the least, see
    `ordered`."""
    traversal: float | None = None
    """Where set, an individual counts when it passed under or in front of the vehicle this near."""
    noise: SensorNoise | None = None
    """What the sensor gets wrong; None where depth and labels are the truth."""
    swims: bool = False
    """The vehicle has inertia, drag and a current to fight, and knows its pose by its sensors of motion.
    Where it has not, it moves exactly, and its pose is the truth."""
    space: Space | None = None
    """How it moves and looks in three dimensions; None where it keeps its altitude over ground and the tilt
    of its camera: a planar protocol."""
    lasting: LastingErrors | None = None
    """What the sensor gets wrong all mission long, beside `noise`."""
    seen: Grain | None = None
    """Where set, labels and depth are what a network makes of the picture, which has this grain. Errors of
    labels and depth are then its own; those that are declared are what planners and maps reckon with."""

    def __post_init__(self) -> None:
        for name in ("altitude", "body_radius", "body_height", "max_depth", "reach", "cell", "lattice"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected metres above 0, got {getattr(self, name)}")
        for name in ("min_depth", "launch_radius", "group_radius"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name}: expected 0 m or more, got {getattr(self, name)}")
        if not -math.inf < self.band[0] < self.band[1] < math.inf:
            raise ValueError(f"band: expected two heights, the lower first, got {self.band}")
        if not abs(self.camera_pitch) <= 0.5 * math.pi:
            raise ValueError(f"camera_pitch: expected at most a quarter turn, got {self.camera_pitch}")
        if not 1 <= self.headings <= 3600:
            raise ValueError(f"headings: expected 1 to 3600, got {self.headings}")
        if self.space is not None:
            for climb in self.space.climbs:
                if abs(climb / self.lattice - round(climb / self.lattice)) > 1e-9:
                    raise ValueError(
                        f"space.climbs: expected multiples of the lattice of {self.lattice} m, got {climb}"
                    )
            if self.camera_pitch not in self.space.tilts:
                raise ValueError(
                    f"space.tilts: expected the camera's pitch of {self.camera_pitch} among them, "
                    f"got {self.space.tilts}"
                )
            if self.traversal is not None:
                raise ValueError("traversal: expected none where a vehicle moves in space")
        if self.cap < 1:
            raise ValueError(f"cap: expected at least 1, got {self.cap}")
        if self.traversal is not None:
            # A narrower camera would leave ground that no heading brings in front of the vehicle.
            if self.camera.horizontal_fov < 2.0 * self.heading_step:
                fov, step = math.degrees(self.camera.horizontal_fov), math.degrees(self.heading_step)
                raise ValueError(
                    f"camera: expected two heading steps of {step:g}° in view for a traversal, got {fov:g}°"
                )
            cells = self.lattice / self.cell
            if abs(cells - round(cells)) > 1e-9 or round(cells) < 1:
                raise ValueError(
                    f"lattice: expected a whole number of {self.cell} m cells for a traversal, "
                    f"got {self.lattice} m"
                )
            if not self.cell < self.traversal <= self.reach:
                raise ValueError(
                    f"traversal: expected more than a cell's {self.cell} m and no more than the reach of "
                    f"{self.reach} m, got {self.traversal} m"
                )

    def ordered(self, area: float, labels: float, group_radius: float) -> SurveyProtocol:
        """The same for a site: no label counts from farther than they are told, and steps go by the area.

        A mission has as many steps as the area is large over the metres up to which a label is trusted, at
        least `cap`: lanes as wide apart as twice that, with a look each metre, take half of them.

        Args:
            area: To survey, square metres.
            labels: Metres straight through the water up to which labels are told.
            group_radius: Metres: no group that is looked for is smaller.
        """
        there = replace(self, reach=min(self.reach, labels), group_radius=group_radius)
        return replace(there, cap=max(self.cap, math.ceil(area / there.trusted - 1e-6)))

    @property
    def T_base_camera(self) -> SE3:
        """The camera at the start sits at the vehicle's centre and looks ahead and down."""
        return camera_mount(self.camera_pitch)

    @property
    def tilts(self) -> tuple[float, ...]:
        """Allowed pitches of the camera, downwards."""
        return (self.camera_pitch,) if self.space is None else self.space.tilts

    @property
    def climbs(self) -> tuple[float, ...]:
        """Allowed climbs, 0 among them, from the lowest."""
        return (0.0,) if self.space is None else tuple(sorted({0.0, *self.space.climbs}))

    def launch_height(self, seabed: float) -> float:
        """World z at the altitude above a seabed at that height; in space the lattice's next height above."""
        z = seabed + self.altitude
        return z if self.space is None else math.ceil(z / self.lattice - 1e-9) * self.lattice

    @property
    def returns(self) -> tuple[float, float]:
        """Least and greatest depth that something returned from, metres."""
        return self.min_depth, farthest_return(self.max_depth)

    @property
    def trusted(self) -> float:
        """Metres up to which a label is trusted: the reach, or less where labels err lastingly.

        Then it is where `TRUSTED` of them are right: a look from nearer tells more than many from farther.
        """
        errors = self.lasting.labels if self.lasting is not None else ()
        if not errors:
            return self.reach
        far, wrong = np.array(errors).T
        found = float(np.interp(1.0 - TRUSTED, wrong, far, left=far[0], right=self.reach))
        return min(max(found, self.cell), self.reach)

    @property
    def blind(self) -> float:
        """Metres of ground ahead of a vehicle at its altitude that the camera never sees."""
        steepest = self.camera_pitch + math.atan((self.camera.height - self.camera.cy) / self.camera.fy)
        return self.altitude / math.tan(steepest)

    @property
    def heading_step(self) -> float:
        """Radians between neighbouring headings."""
        return 2.0 * math.pi / self.headings

    @property
    def turn_angles(self) -> tuple[float, ...]:
        """Allowed turns in (−π, π]."""
        return tuple(wrap_angle(turn * self.heading_step) for turn in self.turns)

    def offset(self, heading: int, advance: float) -> tuple[int, int]:
        """Lattice steps (east, north) of an advance along a heading: the published table.

        A nominal length rarely fits the lattice, so 1 m may be 1.12 m and 2 m may be 1.80 m.
        """
        angle = (heading % self.headings) * self.heading_step
        # Nudged, so that a half that is one only up to rounding goes the same way on every machine.
        return tuple(math.floor(advance * f(angle) / self.lattice + 0.5 + 1e-9) for f in (math.cos, math.sin))  # type: ignore[return-value]

    def heading_index(self, yaw: float) -> int:
        """The heading of the lattice nearest to `yaw`."""
        return round(yaw / self.heading_step) % self.headings

    def snap(self, pose: SE2) -> SE2:
        """The lattice pose nearest to `pose`."""
        return SE2(
            round(pose.x / self.lattice) * self.lattice,
            round(pose.y / self.lattice) * self.lattice,
            wrap_angle(self.heading_index(pose.yaw) * self.heading_step),
        )


DREAM_V1 = SurveyProtocol(
    name="dream-v1",
    altitude=2.0,
    body_radius=0.35,
    body_height=0.4,
    camera=Camera.from_fov(320, 240, math.radians(90.0)),
    camera_pitch=math.radians(20.0),
    min_depth=0.1,
    max_depth=20.0,
    reach=8.0,
    cell=0.25,
    band=(0.5, 2.5),
    lattice=0.5,
    headings=12,
    turns=(0, 1, -1, 2, -2, 3, -3, 6),
    advances=(1.0, 2.0),
    launch_radius=2.5,
    group_radius=1.5,
    cap=200,
)

POOL_V1 = SurveyProtocol(
    name="pool-v1",
    altitude=0.6,
    body_radius=0.35,
    body_height=0.4,
    camera=Camera.from_fov(320, 240, math.radians(90.0)),
    camera_pitch=math.radians(20.0),
    min_depth=0.1,
    max_depth=20.0,
    reach=1.5,
    cell=0.05,
    band=(0.2, 1.0),
    lattice=0.05,
    headings=24,
    turns=(0, 1, -1, 2, -2, 3, -3, 4, -4, 6, -6, 12),
    advances=(0.1, 0.2),
    launch_radius=0.6,
    group_radius=0.3,
    cap=200,
    traversal=0.6,
)

DREAM_V1_NOISY = replace(
    DREAM_V1,
    name="dream-v1-noisy",
    noise=SensorNoise(depth=0.002, missed=0.1, false_targets=0.3, false_size=(0.15, 0.5)),
)
"""`dream-v1` with a sensor that errs; a false target is about as large as one clump of shells."""

DREAM_V1_NAV = replace(DREAM_V1_NOISY, name="dream-v1-nav", swims=True)
"""`dream-v1-noisy` with a vehicle that has to swim, and knows where it is only by its sensors."""

DREAM_V2 = replace(
    DREAM_V1_NOISY,
    name="dream-v2",
    cap=300,
    space=Space(
        climbs=(-1.0, -0.5, 0.5, 1.0),
        tilts=(math.radians(45.0), math.radians(20.0), math.radians(-25.0)),
        lowest=0.8,
        highest=5.0,
        surface=0.5,
        incidence=math.radians(70.0),
        label_lengths=2.0,
        depth_lengths=3.0,
    ),
    lasting=LastingErrors(
        labels=((2.0, 0.02), (5.0, 0.10), (8.0, 0.25)),
        blob=(0.5, 2.0),
        depth=0.02,
        height=0.05,
        tilt=math.radians(1.5),
    ),
)
"""In three dimensions, in water that ends what is seen, with errors that last; reasons: docs/protocols.md."""

DREAM_V2_TRUE = replace(DREAM_V2, name="dream-v2-true", noise=None, lasting=None)
"""`dream-v2` with a sensor that does not err."""

DREAM_V2_NAV = replace(DREAM_V2, name="dream-v2-nav", swims=True)
"""`dream-v2` with a vehicle that has to swim, and knows where it is only by its sensors."""

DREAM_V2_SEEN = replace(
    DREAM_V2,
    name="dream-v2-seen",
    seen=Grain(photons=4000.0, reading=0.003, quality=90),
)
"""`dream-v2` from colours alone: a network tells labels and depth."""

REACHES = (4.0, 6.0, 8.0, 10.0)
"""Metres: the reaches that `dream-v1` is swept over; 8 is its own."""


def reach_variant(reach: float) -> str:
    """The name of the protocol that differs from `dream-v1` only in its reach."""
    return DREAM_V1.name if reach == DREAM_V1.reach else f"{DREAM_V1.name}-reach{reach:g}"


_OTHER_REACHES = [
    replace(DREAM_V1, name=reach_variant(reach), reach=reach) for reach in REACHES if reach != DREAM_V1.reach
]
_ALL = (
    DREAM_V1,
    POOL_V1,
    DREAM_V1_NOISY,
    DREAM_V1_NAV,
    DREAM_V2,
    DREAM_V2_TRUE,
    DREAM_V2_NAV,
    DREAM_V2_SEEN,
    *_OTHER_REACHES,
)
PROTOCOLS = {protocol.name: protocol for protocol in _ALL}


def protocol_named(name: str) -> SurveyProtocol:
    """The protocol of that name; a ValueError with the nearest one where there is none."""
    return look_up(PROTOCOLS, name, "protocol")


def protocol_for(made_for: str, name: str | None = None) -> SurveyProtocol:
    """The protocol of a name; without one that by which worlds made for a protocol are explored.

    Those of dream-v1, the plane, are explored in space. A ValueError where there is none of the name.
    """
    if name is None and made_for == DREAM_V1.name:
        return DREAM_V2
    return protocol_named(name or made_for)


def noisy_variants(protocol: SurveyProtocol) -> list[SurveyProtocol]:
    """The protocols that differ from it in nothing but a sensor that errs.

    Where a move leads and which individuals a pose sees is the same under all of them.
    """
    return [
        other
        for other in PROTOCOLS.values()
        if other.noise is not None
        and replace(other, name=protocol.name, noise=protocol.noise, lasting=protocol.lasting) == protocol
    ]
