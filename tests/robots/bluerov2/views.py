"""What a camera sees on its way through a simulated world, and what may be wrong with its pictures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache

import numpy as np
import numpy.typing as npt

from dream.geometry import SE2, SE3, Camera
from dream.protocol import protocol_named
from dream.robots.bluerov2.sight import Sight
from dream.sim.render import Renderer
from dream.sim.water import water_named
from dream.sim.worlds import make_world
from dream.types import UInt8Array
from tests.robots.bluerov2.test_bridge import fix_at

BEAT, PERIOD, LAG = 0.04, 0.1, 0.12
"""Seconds between beats, between pictures, and from a view to its picture."""
SIZE = (320, 240)

Wrong = Callable[[UInt8Array, int], UInt8Array]
"""What becomes of a picture by its number."""


@dataclass(frozen=True)
class Seen:
    time: float
    rgb: UInt8Array


@dataclass
class Stream:
    """A camera whose pictures are given to it by hand."""

    connected: bool = True
    unchanged: float = 0.0
    picture: Seen = field(default_factory=lambda: Seen(0.0, np.zeros((6, 8, 3), np.uint8)))
    _since: float = 0.0

    def newest(self, max_age: float) -> Seen:
        return self.picture

    def show(self, time: float, rgb: UInt8Array) -> None:
        if not np.array_equal(rgb, self.picture.rgb):
            self._since = time
        self.picture, self.unchanged = Seen(time, rgb), time - self._since


Moves = Sequence[tuple[float, float, float]]
"""Metres ahead and to the left, and degrees to the left."""


def way(begin: SE2, moves: Moves, *, speed: float, rate: float = 0.5, rest: float = 0.5) -> list[SE2]:
    """Where it is at each beat; it rests after each move."""
    poses = [begin] * round(rest / BEAT)
    for ahead, left, degrees in moves:
        at, turn = poses[-1], math.radians(degrees)
        beats = max(round(max(math.hypot(ahead, left) / speed, abs(turn) / rate) / BEAT), 1)
        for k in range(1, beats + 1):
            s = (k / beats) ** 2 * (3.0 - 2.0 * k / beats)
            c, d = math.cos(at.yaw), math.sin(at.yaw)
            x, y = at.x + s * (ahead * c - left * d), at.y + s * (ahead * d + left * c)
            poses.append(SE2(x, y, at.yaw + s * turn))
        poses += [poses[-1]] * round(rest / BEAT)
    return poses


@dataclass(frozen=True)
class Flight:
    """A way, and a picture of it every `PERIOD`."""

    poses: list[SE2]
    pictures: list[UInt8Array]
    altitude: float = 0.6
    dvl_age: float = 0.1

    def frozen(self, since: float, until: float = math.inf) -> Flight:
        """The same with a camera that shows only the first picture of that time."""
        first, last = (round(min(time, 1e6) / PERIOD) for time in (since, until))
        rgb = self.pictures[first]
        shown = [rgb if first <= k < last else own for k, own in enumerate(self.pictures)]
        return replace(self, pictures=shown)

    def told(self, wrong: Wrong = lambda rgb, k: rgb) -> list[str]:
        """What is said at each beat, of pictures with which something is wrong."""
        stream, said, k = Stream(), list[str](), 0
        sight = Sight(stream)
        for n, pose in enumerate(self.poses):
            while k < len(self.pictures) and PERIOD * k <= BEAT * n:
                stream.show(PERIOD * k, wrong(self.pictures[k], k))
                k += 1
            T_world_base = SE3.level(pose.x, pose.y, -0.9, pose.yaw)
            fix = fix_at(
                time=BEAT * n, T_world_base=T_world_base, altitude=self.altitude, dvl_age=self.dvl_age
            )
            said.append(sight(fix))
        return said

    def gone(self, since: float, until: float) -> float:
        """How far the vehicle got between two times: of the way that has to be gone, a metre of which counts
        as much as 3 radians."""
        some = self.poses[round(since / BEAT) : round(until / BEAT) + 1]
        return max(max(pose.distance(some[0]), abs(pose.yaw - some[0].yaw) / 3.0) for pose in some)


@lru_cache(maxsize=4)
def flight(
    world_name: str,
    moves: Moves,
    *,
    speed: float,
    water: str = "",
    start: int = 0,
    height: float | None = None,
    lag: float = LAG,
) -> Flight:
    """Through a world, from one of its starts, at the protocol's height unless given."""
    world = make_world(world_name, 1)
    if water:
        world = replace(world, water=water_named(water))
    protocol, renderer = protocol_named(world.protocol), Renderer(world)
    camera = Camera.from_fov(*SIZE, protocol.camera.horizontal_fov)
    poses = way(world.starts[start], moves, speed=speed)
    pictures = []
    for k in range(math.ceil(len(poses) * BEAT / PERIOD)):
        at = poses[min(max(round((PERIOD * k - lag) / BEAT), 0), len(poses) - 1)]
        z = float(world.terrain.height(at.x, at.y)) + (height or protocol.altitude)
        T_world_camera = SE3.level(at.x, at.y, z, at.yaw) @ protocol.T_base_camera
        pictures.append(renderer.render(camera, T_world_camera).rgb)
    return Flight(poses, pictures, height or protocol.altitude)


# What may be wrong


@cache
def _grain(sigma: float) -> npt.NDArray[np.int16]:
    """Noise of a field that pictures are cut out of."""
    field = np.random.default_rng(1).standard_normal((2 * SIZE[1], 2 * SIZE[0], 3), np.float32)
    grain: npt.NDArray[np.int16] = np.rint(sigma * field).astype(np.int16)
    return grain


def noisy(rgb: UInt8Array, k: int, sigma: float = 4.0) -> UInt8Array:
    """Each pixel errs for itself, as those of a sensor do."""
    height, width = rgb.shape[:2]
    down, right = np.random.default_rng(k).integers(0, (height, width))
    grain = _grain(sigma)[down : down + height, right : right + width]
    out: UInt8Array = np.clip(rgb + grain, 0, 255).astype(np.uint8)
    return out


def encoded(rgb: UInt8Array, k: int) -> UInt8Array:
    """Noise, and all that an encoder leaves out."""
    import cv2

    data = cv2.imencode(".jpg", noisy(rgb, k), [cv2.IMWRITE_JPEG_QUALITY, 40])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def clocked(rgb: UInt8Array, k: int) -> UInt8Array:
    """Digits that change, in a twentieth of the picture."""
    (height, width), out = rgb.shape[:2], rgb.copy()
    digits = np.random.default_rng(k).integers(0, 2, (3, 12), np.uint8) * 255
    patch = np.kron(digits, np.ones((height // 20, width // 36), np.uint8))
    out[5 : 5 + patch.shape[0], 5 : 5 + patch.shape[1]] = patch[..., None]
    return out


def snowy(rgb: UInt8Array, k: int) -> UInt8Array:
    """Bright particles that drift to and fro, one in every fifth of 8 × 6 blocks."""
    height, width = rgb.shape[:2]
    out, far = rgb.astype(np.float32), width // 15
    y, x = np.mgrid[-far : far + 1, -far : far + 1].astype(np.float32)
    flake = 90.0 * np.exp(-(x * x + y * y) / (2.0 * (width / 60) ** 2))[..., None]
    for block in np.random.default_rng(7).permutation(48)[:10]:
        row = round((block // 8 + 0.5 + 0.25 * math.sin(0.4 * k + block)) * height / 6)
        col = round((block % 8 + 0.5 + 0.25 * math.cos(0.3 * k + block)) * width / 8)
        up, left = max(far - row, 0), max(far - col, 0)
        under = out[max(row - far, 0) : row + far + 1, max(col - far, 0) : col + far + 1]
        under += flake[up : up + len(under), left : left + under.shape[1]]
    return np.clip(out, 0.0, 255.0).astype(np.uint8)


def exposed(rgb: UInt8Array, k: int) -> UInt8Array:
    """An exposure that is longer and shorter by a third, in turns."""
    light = (np.arange(256) / 255.0) ** 2.2 * (1.0 + 0.35 * math.sin(0.5 * k))
    curve = (255.0 * np.clip(light, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)
    out: UInt8Array = curve[rgb]
    return out


def lit(rgb: UInt8Array, k: int) -> UInt8Array:
    """Light that the waves above bundle, and move about."""
    height, width = rgb.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32) * np.float32(12.0 / height)
    t = PERIOD * k
    waves = np.sin(x + 1.7 * np.sin(0.7 * y + 2.0 * t) + 3.0 * t)
    waves += np.sin(1.3 * y + 1.2 * np.sin(x - 2.5 * t) - 2.0 * t)
    light = 0.85 + 0.5 * np.exp(-3.0 * np.abs(waves))
    out: UInt8Array = np.clip(rgb * light[..., None], 0.0, 255.0).astype(np.uint8)
    return out


def gripping(rgb: UInt8Array, k: int) -> UInt8Array:
    """A gripper that moves with the camera, in a sixth of the picture."""
    (height, width), out = rgb.shape[:2], rgb.copy()
    rows, cols = height // 3, width // 2
    marks = np.random.default_rng(3).integers(40, 200, (rows // 10, cols // 10, 1), np.uint8)
    out[-rows:, width // 4 : width // 4 + cols] = np.kron(marks, np.ones((10, 10, 3), np.uint8))
    return out
