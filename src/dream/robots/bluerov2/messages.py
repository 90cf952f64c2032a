"""Measurements, states, pictures and text ↔ ROS 2 messages.

Frames are those of REP-103 and REP-105: `map` is our `world`, `base_link` our `base`; so nothing is turned.
Stamps are nanoseconds of UTC. What a number needs to be the very same again does not fit a message of ROS:
its times have nanoseconds, and a sigma is squared. So each measurement is also written as text, whose
numbers are exact.
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image
from pydantic_core import from_json

from dream import extras
from dream.geometry import SE3
from dream.measurements import Depth, Dvl, Heading, Imu, Measurement

WORLD, BASE = "map", "base_link"
JPEG_QUALITY = 90
UNKNOWN = 1e6
"""Variance of what a message has a place for and nobody knows."""

VIDEO = "foxglove_msgs/msg/CompressedVideo"
VIDEO_TEXT = "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n"
"""ROS 2 has no message for compressed video; this one (foxglove/foxglove-sdk, schemas) others read."""

_KINDS: Mapping[str, type[Imu | Dvl | Depth | Heading]] = {
    "imu": Imu,
    "dvl": Dvl,
    "depth": Depth,
    "heading": Heading,
}
_SHAPES = {"angular_velocity": (3,), "specific_force": (3,), "velocity": (3,), "covariance": (3, 3)}


class Typed(NamedTuple):
    """A message for a topic."""

    topic: str
    type: str
    message: Any


@lru_cache(maxsize=1)
def typestore() -> Any:
    """The messages of ROS 2 Jazzy, which `rosbags` holds, and that of a video.

    Raises:
        ValueError: `rosbags` is missing.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError as error:
        raise ValueError(extras.missing("rov", "rosbags", "log")) from error
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(VIDEO_TEXT, VIDEO))
    return store


def _new(kind: str, **values: Any) -> Any:
    return typestore().types[kind](**values)


def header(stamp_ns: int, frame: str) -> Any:
    """When and in which frame."""
    return _new("std_msgs/msg/Header", stamp=_time(stamp_ns), frame_id=frame)


def _time(stamp_ns: int) -> Any:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    return _new("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)


def _vector(values: npt.ArrayLike) -> Any:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return _new("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _point(values: npt.ArrayLike) -> Any:
    x, y, z = np.asarray(values, dtype=np.float64).tolist()
    return _new("geometry_msgs/msg/Point", x=x, y=y, z=z)


def quaternion(rotation: npt.NDArray[np.floating[Any]]) -> tuple[float, float, float, float]:
    """w, x, y, z of a rotation (3, 3), w not negative."""
    trace = float(np.trace(rotation))
    squares = [trace, *(2.0 * float(rotation[axis, axis]) - trace for axis in range(3))]
    # Four times the square of the greatest component is at least 1: dividing by it is always safe.
    greatest = int(np.argmax(squares))
    r = rotation
    rows = [
        [1.0 + squares[0], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
        [r[2, 1] - r[1, 2], 1.0 + squares[1], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
        [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], 1.0 + squares[2], r[1, 2] + r[2, 1]],
        [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1.0 + squares[3]],
    ]
    row = np.array(rows[greatest])
    w, x, y, z = (row / math.copysign(float(np.linalg.norm(row)), row[0] if row[0] != 0.0 else 1.0)).tolist()
    return w, x, y, z


def _quaternion(rotation: npt.NDArray[np.floating[Any]]) -> Any:
    w, x, y, z = quaternion(rotation)
    return _new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _pose(T: SE3) -> Any:
    return _new("geometry_msgs/msg/Pose", position=_point(T.translation), orientation=_quaternion(T.rotation))


def _pose_stamped(stamp_ns: int, T: SE3, variances: list[float]) -> Any:
    """With the variances of x, y, z, roll, pitch, yaw."""
    pose = _new("geometry_msgs/msg/PoseWithCovariance", pose=_pose(T), covariance=np.diag(variances).ravel())
    return _new("geometry_msgs/msg/PoseWithCovarianceStamped", header=header(stamp_ns, WORLD), pose=pose)


def of_measurement(said: Imu | Measurement, stamp_ns: int) -> Iterator[Typed]:
    """What others read of a measurement: its ROS messages."""
    if isinstance(said, Imu):
        unknown = np.zeros(9)
        no_attitude = np.array([-1.0, *np.zeros(8)])
        kind = "sensor_msgs/msg/Imu"
        message = _new(
            kind,
            header=header(stamp_ns, BASE),
            orientation=_quaternion(np.eye(3)),
            orientation_covariance=no_attitude,
            angular_velocity=_vector(said.angular_velocity),
            angular_velocity_covariance=unknown,
            linear_acceleration=_vector(said.specific_force),
            linear_acceleration_covariance=unknown,
        )
        yield Typed("/imu", kind, message)
    elif isinstance(said, Dvl):
        yield from _of_dvl(said, stamp_ns)
    elif isinstance(said, Depth):
        pose = SE3(np.eye(3), np.array([0.0, 0.0, said.z]))
        variances = [UNKNOWN, UNKNOWN, said.sigma**2, UNKNOWN, UNKNOWN, UNKNOWN]
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        yield Typed("/depth", kind, _pose_stamped(stamp_ns, pose, variances))
    else:
        pose = SE3.level(0.0, 0.0, 0.0, said.yaw)
        variances = [UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, UNKNOWN, said.sigma**2]
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        yield Typed("/heading", kind, _pose_stamped(stamp_ns, pose, variances))


def _of_dvl(said: Dvl, stamp_ns: int) -> Iterator[Typed]:
    covariance = np.diag([UNKNOWN] * 6)
    velocity: npt.ArrayLike = (math.nan,) * 3
    if said.valid:
        velocity, covariance[:3, :3] = said.velocity, said.covariance
    twist = _new("geometry_msgs/msg/Twist", linear=_vector(velocity), angular=_vector((0.0, 0.0, 0.0)))
    kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
    message = _new(
        kind,
        header=header(stamp_ns, "dvl"),
        twist=_new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=covariance.ravel()),
    )
    yield Typed("/dvl/velocity", kind, message)
    kind = "sensor_msgs/msg/Range"
    message = _new(
        kind,
        header=header(stamp_ns, "dvl"),
        radiation_type=0,
        field_of_view=math.radians(4.4),
        min_range=0.05,
        max_range=50.0,
        range=said.altitude,
        variance=0.0,
    )
    yield Typed("/dvl/altitude", kind, message)


def of_state(state: Any, stamp_ns: int) -> Iterator[Typed]:
    """Where a vehicle believes to be: `pose` or `T_world_base`, `velocity` over ground in the world,
    `angular_velocity` in base; and how certain it is, as `position_covariance` (3, 3) or `position_sigma`."""
    pose: SE3 = state.pose if hasattr(state, "pose") else state.T_world_base
    covariance, speeds = np.diag([UNKNOWN] * 6), np.diag([UNKNOWN] * 6)
    if hasattr(state, "position_covariance"):
        covariance[:3, :3] = state.position_covariance
    elif hasattr(state, "position_sigma"):
        covariance[:3, :3] = np.eye(3) * state.position_sigma**2
    twist = _new(
        "geometry_msgs/msg/Twist",
        linear=_vector(pose.rotation.T @ np.asarray(state.velocity)),
        angular=_vector(state.angular_velocity),
    )
    message = _new(
        "nav_msgs/msg/Odometry",
        header=header(stamp_ns, WORLD),
        child_frame_id=BASE,
        pose=_new("geometry_msgs/msg/PoseWithCovariance", pose=_pose(pose), covariance=covariance.ravel()),
        twist=_new("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=speeds.ravel()),
    )
    yield Typed("/estimate", "nav_msgs/msg/Odometry", message)
    transform = _new(
        "geometry_msgs/msg/TransformStamped",
        header=header(stamp_ns, WORLD),
        child_frame_id=BASE,
        transform=_new(
            "geometry_msgs/msg/Transform",
            translation=_vector(pose.translation),
            rotation=_quaternion(pose.rotation),
        ),
    )
    yield Typed("/tf", "tf2_msgs/msg/TFMessage", _new("tf2_msgs/msg/TFMessage", transforms=[transform]))


def of_picture(picture: npt.NDArray[np.uint8] | bytes, topic: str, stamp_ns: int) -> Typed:
    """(H, W, 3) rgb, which becomes a JPEG; or the bytes of a JPEG or PNG."""
    if not isinstance(picture, bytes):
        buffer = io.BytesIO()
        Image.fromarray(picture).save(buffer, "JPEG", quality=JPEG_QUALITY)
        picture = buffer.getvalue()
    kind = "sensor_msgs/msg/CompressedImage"
    message = _new(
        kind,
        header=header(stamp_ns, "camera"),
        format="png" if is_png(picture) else "jpeg",
        data=np.frombuffer(picture, np.uint8),
    )
    return Typed(topic, kind, message)


def of_video(unit: Any, topic: str, stamp_ns: int) -> Typed:
    """H.264 as it came, one picture: `data`, and before one that builds on no other its `parameters`."""
    raw = unit.parameters + unit.data if unit.whole else unit.data
    data = np.frombuffer(raw, np.uint8)
    message = _new(VIDEO, timestamp=_time(stamp_ns), frame_id="camera", data=data, format="h264")
    return Typed(topic, VIDEO, message)


def is_png(data: bytes) -> bool:
    """Are they the bytes of a PNG?"""
    return data.startswith(b"\x89PNG\r\n")


def is_jpeg(data: bytes) -> bool:
    """Are they the bytes of a JPEG?"""
    return data.startswith(b"\xff\xd8\xff")


def of_bytes(data: bytes, topic: str, name: str) -> Typed:
    """As they came or went; `name` says what they are."""
    dimension = _new("std_msgs/msg/MultiArrayDimension", label=name, size=len(data), stride=len(data))
    layout = _new("std_msgs/msg/MultiArrayLayout", dim=[dimension], data_offset=0)
    kind = "std_msgs/msg/UInt8MultiArray"
    return Typed(topic, kind, _new(kind, layout=layout, data=np.frombuffer(data, np.uint8)))


def of_text(text: str, topic: str) -> Typed:
    """Plain text or JSON."""
    return Typed(topic, "std_msgs/msg/String", _new("std_msgs/msg/String", data=text))


def measurement_text(said: Imu | Measurement) -> str:
    """A measurement as JSON whose numbers are exact."""
    return json.dumps({"kind": type(said).__name__.lower(), **plain(said)}, separators=(",", ":"))


def read_measurement(text: str) -> Imu | Measurement:
    """The very measurement that `measurement_text` was given.

    Raises:
        ValueError: It is something else.
    """
    try:
        said = from_json(text)
        kind = _KINDS[said.pop("kind")]
        values = {name: _value(name, value) for name, value in said.items()}
        return kind(**values)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"measurement: expected one as it is logged, got {text[:80]!r} ({error})") from error


def _value(name: str, value: Any) -> Any:
    if name in _SHAPES:
        array = np.array(value, dtype=np.float64)
        if array.shape != _SHAPES[name]:
            raise ValueError(f"{name}: expected {_SHAPES[name]}, got {array.shape}")
        return array
    return value if isinstance(value, bool) else float(value)


def plain(value: Any) -> Any:
    """What JSON can hold of a value, whatever it is; numbers stay as they are, also NaN."""
    if isinstance(value, str | bool | int | float | None):
        return value
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if isinstance(value, bytes | bytearray):
        return f"{len(value)} bytes"
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    return str(value)
