"""Calibration files of a lens, as OpenCV, ROS and Kalibr write them.

References: `cv2.FileStorage` and the calibration example of OpenCV; ROS's `camera_info` (package
camera_calibration_parsers, REP 104) and the message `sensor_msgs/CameraInfo`; Kalibr's camchain and the ASL
data set format. A field that changes what the numbers mean is read, or the file is refused by its name; all
other fields are passed over.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream import extras

Float64Array = npt.NDArray[np.float64]
Fields = Mapping[str, Any]

PINHOLE_COUNTS = (4, 5, 8, 12, 14)
"""Coefficients that OpenCV's pinhole models have: k1 k2 p1 p2, k3, k4 k5 k6, s1 to s4, τx τy."""
FISHEYE_COUNTS = (4,)
_MOST_BYTES = 1 << 20
_MOST_YAML = 32 << 10
"""Characters that go through the reader of YAML, which takes up to a second for them."""
_LONG = 2 << 10
"""Characters of a field that is passed over before the file is read, unless a lens needs it."""
_MOST_OPEN = 64
"""Brackets that are open at once; the time that the reader takes grows with their square."""
_FIELD = re.compile(r"^([A-Za-z_][\w .\-]{0,63}):(?=\s|\Z)", re.MULTILINE)
_DEEPEST = 4
_MOST_NODES = 20_000
_EXPECTED = "expected YAML as OpenCV writes it"
_MOST_NUMBERS = 64
_OPENCV, _ROS, _MESSAGE, _KALIBR = (
    "OpenCV's calibration",
    "ROS's camera_info",
    "ROS's message CameraInfo",
    "Kalibr's camchain",
)
_NEEDED = ("image_width", "image_height", "camera_matrix", "distortion_coefficients")
_OWN = "Give the file that the calibration itself wrote"
_TO_OPENCV = "Calibrate as a pinhole (cv2.calibrateCamera) or a fisheye (cv2.fisheye.calibrate), see docs"

_MODELS: Mapping[str, tuple[bool, tuple[int, ...]] | None] = {
    "pinhole": None,
    "perspective": None,
    "plumb_bob": (False, (4, 5)),
    "radtan": (False, (4, 5)),
    "radial_tangential": (False, (4, 5)),
    "brown": (False, (4, 5)),
    "brown_conrady": (False, (4, 5)),
    "none": (False, (4,)),
    "opencv": (False, PINHOLE_COUNTS),
    "rational_polynomial": (False, (8, 12, 14)),
    "rational": (False, (8, 12, 14)),
    "equidistant": (True, FISHEYE_COUNTS),
    "equi": (True, FISHEYE_COUNTS),
    "fisheye": (True, FISHEYE_COUNTS),
    "opencv_fisheye": (True, FISHEYE_COUNTS),
    "kannala_brandt": (True, FISHEYE_COUNTS),
    "kannala_brandt4": (True, FISHEYE_COUNTS),
}
"""Names of models: fisheye, and how many coefficients; None where another field says which."""
_NAMING = (
    *("distortion_model", "distortion_type", "distortion", "dist_model", "camera_model", "camera_type"),
    *("lens_model", "lens_type", "projection_model", "projection_type", "projection", "model", "model_type"),
)
_FLAGS = ("fisheye_model", "fisheye", "is_fisheye")
_LOOSE = ("model", "model_type", "camera_type")
"""Fields that may name the camera, where another one names the lens."""
_OTHERS = (
    *(
        "omni",
        "omnidirectional",
        "mei",
        "ds",
        "double_sphere",
        "eucm",
        "ucm",
        "unified",
        "fov",
        "atan",
        "ftheta",
    ),
    *("thin_prism_fisheye", "scaramuzza", "ocam", "division", "spherical", "equirectangular", "orthographic"),
)
"""Models that no lens here has."""
_ONES = ("binning_x", "binning_y", "binning", "scale", "image_scale", "downsample", "downscale", "resize")
_ZEROS = ("xi", "skew", "rectified", "undistorted", "do_rectify")
_WINDOWS = ("roi", "region_of_interest", "crop")
_UNITS = ("units", "unit", "focal_unit", "focal_length_unit")
_SIZES = ("resolution", "image_size", "size")
_READ = (
    *(*_NEEDED, *_NAMING, *_FLAGS, *_ONES, *_ZEROS, *_WINDOWS, *_UNITS, *_SIZES, "calibrated_in", "k", "d"),
    *("width", "height", "camera_name", "rectification_matrix", "projection_matrix", "intrinsics"),
    "distortion_coeffs",
)
"""Fields that say something of a lens, or whose file it is."""


@dataclass(frozen=True, slots=True)
class Written:
    """What a file says of a lens."""

    kind: str
    """Whose file it is."""
    calibrated_in: Any
    """As it stands there; None where it does not."""
    width: int
    height: int
    matrix: Float64Array
    """(3, 3) camera matrix, pixels; pixel centres lie at whole numbers."""
    distortion: Float64Array
    """(n,) coefficients."""
    fisheye: bool


def parse(path: Path) -> Written:
    """What a calibration file says.

    Raises:
        ValueError: It is none, lacks something, or says of itself what no lens here has; in words.
    """
    size = path.stat().st_size
    if size > _MOST_BYTES:
        raise ValueError(f"expected at most {_MOST_BYTES} bytes, got {size}. {_OWN}")
    if not size:
        raise ValueError(f"{_EXPECTED}, got an empty file. {_OWN}")
    found = _tree(path.read_bytes())
    kind, fields = _known(found)
    if missing := [name for name in _NEEDED if fields.get(name) is None]:
        raise ValueError(
            f"expected calibrated_in, {', '.join(_NEEDED)}; {', '.join(missing)} is missing or of another "
            f"kind. It is read as {kind}, and holds {_listed(found)}. {_OWN}"
        )
    _check_meaning(fields)
    fisheye, counts, model = _model(fields)
    sides = fields["image_width"], fields["image_height"]
    if not all(isinstance(side, float) and side.is_integer() for side in sides):
        raise ValueError(
            f"image size: expected two whole numbers, got {_short(sides[0])} x {_short(sides[1])}. "
            "Write how many pixels the pictures of the calibration have"
        )
    for name in _SIZES:
        told = fields.get(name)
        if isinstance(told, list) and len(told) == 2 and tuple(told) != sides:
            raise ValueError(
                f"{name}: expected {sides[0]:g} x {sides[1]:g} as the file says, got {_short(told)}. "
                "Keep the size of the calibration's pictures, and delete the other"
            )
    matrix = _numbers(fields["camera_matrix"], "camera_matrix")
    if len(matrix) != 9:
        raise ValueError(
            f"camera_matrix: expected the 9 numbers fx 0 cx 0 fy cy 0 0 1, got {len(matrix)}. {_OWN}"
        )
    distortion = _numbers(fields["distortion_coefficients"], "distortion_coefficients")
    return Written(
        kind,
        fields.get("calibrated_in"),
        int(sides[0]),
        int(sides[1]),
        matrix.reshape(3, 3),
        _fitted(distortion, counts, model),
        fisheye,
    )


def _tree(content: bytes) -> Fields:
    """The fields by their names in lower case, as far down as a lens is described.

    OpenCV's own reader does not stand a damaged file: it writes where it must not.
    """
    if content.startswith(b"\x1f\x8b"):
        raise ValueError(f"{_EXPECTED}, got it compressed. Unpack it with gunzip")
    # Comments, and fields that are passed over, may be in any code.
    text = content.decode("utf-8-sig", errors="replace")
    if text.lstrip().startswith("# oST"):
        raise ValueError("this is ROS's ost.txt. Give the ost.yaml that lies beside it")
    reader = {"<": _of_xml, "{": _of_json}.get(text.lstrip()[:1], _of_yaml)
    try:
        fields = reader(text)
    except RecursionError as error:
        raise ValueError(f"{_EXPECTED}: it nests too deeply. {_OWN}") from error
    if not isinstance(fields, dict):
        raise ValueError(f"{_EXPECTED}, fields by their names such as image_width: 1920, got others. {_OWN}")
    return fields


def _fields(pairs: Iterable[tuple[str, Any]]) -> Fields:
    """Fields by their names in lower case, each of which stands there once."""
    fields: dict[str, Any] = {}
    written: set[str] = set()
    for name, value in pairs:
        called = name.strip().lower()
        if name in written or (called in fields and called in _READ):
            raise ValueError(f"{_short(name)}: expected once, got twice. Delete the wrong one")
        if "\ufffd" in name:
            raise ValueError(
                f"{_short(name)}: expected names of fields in UTF-8, got other bytes. Save it as UTF-8"
            )
        written.add(name)
        fields[called] = value
    return fields


def _of_json(text: str) -> Any:
    """What JSON says, or YAML that begins like it."""

    def plain(value: Any, depth: int = 0) -> Any:
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
        if isinstance(value, bool):
            return str(value).lower()
        if depth >= _DEEPEST or not isinstance(value, (dict, list)):
            return value if isinstance(value, str) else None
        if isinstance(value, dict):
            return {name: plain(one, depth + 1) for name, one in value.items()}
        return [plain(one, depth + 1) for one in value] if len(value) <= _MOST_NUMBERS else None

    try:
        content = json.loads(text, object_pairs_hook=_fields, parse_int=float)
    except json.JSONDecodeError:
        return _of_yaml(text)
    return plain(content)


def _without(text: str, needless: Callable[[str], bool]) -> str:
    """The text without those fields that no lens needs, and of which `needless` says so by what they say.

    A field begins with a name at the beginning of a line, and ends where the next one does.
    """
    begins = [*_FIELD.finditer(text)]
    if not begins:
        return text
    ends = [*(field.start() for field in begins[1:]), len(text)]
    kept = [text[: begins[0].start()]]
    for field, end in zip(begins, ends, strict=True):
        name = field[1].strip().lower()
        needed = name in _READ or re.fullmatch(r"cam\d+", name)
        if needed or not needless(text[field.end() : end]):
            kept.append(text[field.start() : end])
    return "".join(kept)


def _is_line(said: str) -> bool:
    """Is it a plain text on one line, such as `@left` or `camera: front`, which is none for YAML only?"""
    first, *more = said.strip().splitlines() or [""]
    return first[:1] not in tuple("\"'[{|>&") and all(
        not line.strip() or line.startswith("#") for line in more
    )


def _of_yaml(text: str) -> Any:
    """What YAML says; only its nodes are looked at, nothing is made of its tags.

    What OpenCV takes for a text and YAML does not is passed over, unless a lens needs it.

    Raises:
        ValueError: It is none, or what reads it is not installed.
    """
    # OpenCV's head is none of YAML's.
    body = re.sub(r"\A\s*%YAML[^\n]*\n", "", text)
    if len(body) > _MOST_YAML:
        body = _without(body, lambda said: len(said) > _LONG)
        if len(body) > _MOST_YAML:
            raise ValueError(
                f"expected at most {_MOST_YAML} characters beside the long fields that no lens needs, got "
                f"{len(body)}. Take out what is not of the lens"
            )
    try:
        return _read_yaml(body)
    except _NoYamlError:
        fewer = _without(body, _is_line)
        if fewer == body:
            raise
        return _read_yaml(fewer)


class _NoYamlError(ValueError):
    """It is none."""


def _read_yaml(body: str) -> Any:
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError
    except ImportError as error:
        raise ValueError(extras.missing("rov", "ruamel.yaml", "calibration")) from error
    if _most_open(body) > _MOST_OPEN:
        raise ValueError(f"{_EXPECTED}: it nests too deeply. {_OWN}")
    try:
        node = next(iter(YAML(typ="safe", pure=True).compose_all(body)), None)
    except (YAMLError, ValueError, AttributeError, TypeError) as error:
        where = getattr(error, "problem_mark", None)
        why = getattr(error, "problem", None) or str(error)
        line = "" if where is None else f" in line {where.line + 1}"
        raise _NoYamlError(f"{_EXPECTED}: {_short(' '.join(str(why).split()))}{line}") from error
    left = [_MOST_NODES]
    return _of_node(node, left)


def _most_open(body: str) -> int:
    """How many more brackets open than close, up to where that is most; in texts and comments as well."""
    steps = [1 if bracket in "[{" else -1 for bracket in re.findall(r"[\[\]{}]", body)]
    return max(accumulate(steps, lambda opened, step: max(opened + step, 0)), default=0)


def _of_node(node: Any, left: list[int], depth: int = 0) -> Any:
    """Texts, numbers, lists of at most so many, and fields by name; None where it is none of these.

    Args:
        node: As it is composed.
        left: How many may still be looked at: one that is named twice is looked at twice.
        depth: Below the file's own.
    """
    left[0] -= 1
    if left[0] < 0:
        raise ValueError(f"expected at most {_MOST_NODES} fields and numbers, got more. {_OWN}")
    value = getattr(node, "value", None)
    if isinstance(value, str):
        return _scalar(value) if node.style is None else value
    if depth >= _DEEPEST or not isinstance(value, list):
        return None
    if node.id == "mapping":
        return _fields((str(name.value), _of_node(one, left, depth + 1)) for name, one in value)
    return [_of_node(one, left, depth + 1) for one in value] if len(value) <= _MOST_NUMBERS else None


def _of_xml(text: str) -> Any:
    """What OpenCV's XML says."""
    from xml.etree import ElementTree

    # Each comment ends where the next begins: a search for its end that fails is not made again.
    first, *comments = text.split("<!--")
    if "<!" in first or any("-->" not in one or "<!" in one.split("-->", 1)[1] for one in comments):
        raise ValueError(f"{_EXPECTED}: it holds declarations (<!...>). Take them out, or write it as YAML")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise ValueError(f"{_EXPECTED}: {error}") from error
    return _fields((child.tag, _of_element(child)) for child in root)


def _of_element(element: Any, depth: int = 1) -> Any:
    """The same of an element: fields where there are elements in it, a list where there are several words."""
    if len(element):
        if depth >= _DEEPEST:
            return None
        return _fields((child.tag, _of_element(child, depth + 1)) for child in element)
    words = [word.strip('"') for word in (element.text or "").split()]
    if len(words) > 1 or element.tag == "data":
        return [_scalar(word) for word in words] if len(words) <= _MOST_NUMBERS else None
    return _scalar(words[0]) if words else ""


def _scalar(text: str) -> Any:
    """A number where it is written as one, else the text; None where nothing stands there."""
    if text in ("", "~", "null"):
        return None
    if re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text):
        return float(text)
    named = re.fullmatch(r"([-+]?)\.(inf|nan)", text, re.IGNORECASE)
    return text if named is None else float(named[1] + named[2])


def _known(found: Fields) -> tuple[str, Fields]:
    """Whose file it is, and its fields under OpenCV's names."""
    cameras = [
        name for name, value in found.items() if re.fullmatch(r"cam\d+", name) and isinstance(value, dict)
    ]
    if len(cameras) > 1:
        raise ValueError(
            f"{_KALIBR}: expected one camera, got {', '.join(cameras[:8])}. Keep the one that looks ahead"
        )
    if cameras:
        return _KALIBR, _of_kalibr({**found, **found[cameras[0]]})
    if "intrinsics" in found and "camera_matrix" not in found:
        return _KALIBR, _of_kalibr(found)
    if {"k", "d", "width", "height"} <= set(found):
        names = {"k": "camera_matrix", "d": "distortion_coefficients"}
        names |= {"width": "image_width", "height": "image_height"}
        return _MESSAGE, {names.get(name, name): value for name, value in found.items()}
    ros = {"camera_name", "distortion_model", "rectification_matrix", "projection_matrix"}
    return _ROS if len(ros & set(found)) >= 2 else _OPENCV, found


def _of_kalibr(camera: Fields) -> Fields:
    """Kalibr's fields under OpenCV's names."""
    model = _word(camera.get("camera_model", "pinhole"))
    if model != "pinhole":
        raise ValueError(
            f"{_KALIBR}: camera_model: expected pinhole, got {_short(camera['camera_model'])}. "
            "Run Kalibr with --models pinhole-radtan or pinhole-equi"
        )
    fields = dict(camera)
    values = camera.get("intrinsics")
    if isinstance(values, list) and len(values) == 4:
        fx, fy, cx, cy = values
        fields["camera_matrix"] = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    if "distortion_coeffs" in camera:
        fields["distortion_coefficients"] = camera["distortion_coeffs"]
    size = camera.get("resolution")
    if isinstance(size, list) and len(size) == 2:
        fields["image_width"], fields["image_height"] = size
    return fields


def _check_meaning(fields: Fields) -> None:
    """Refuse what makes other numbers of those that are read."""
    for name in _ONES:
        if fields.get(name) not in (None, 0.0, 1.0):
            raise ValueError(
                f"{name}: expected 1 (the picture as it was calibrated), got {_short(fields[name])}. "
                "Calibrate at the size of the stream"
            )
    for name in _ZEROS:
        if fields.get(name) is not None and _flag(fields[name]) is not False:
            raise ValueError(f"{name}: expected 0, got {_short(fields[name])}. {_TO_OPENCV}")
    for name in _UNITS:
        if fields.get(name) is not None and _word(fields[name]) not in ("px", "pixel", "pixels"):
            raise ValueError(
                f"{name}: expected pixels, got {_short(fields[name])}. Give the lengths in pixels"
            )
    whole = [0.0, 0.0, fields["image_width"], fields["image_height"]]
    for name in _WINDOWS:
        window = fields.get(name)
        if isinstance(window, dict):
            window = [window.get(key, 0.0) for key in ("x_offset", "y_offset", "width", "height")]
        if window is not None and window not in ([0.0] * 4, whole):
            raise ValueError(
                f"{name}: expected the whole picture, got {_short(fields[name])}. "
                "Calibrate the picture as it is streamed"
            )


def _model(fields: Fields) -> tuple[bool, tuple[int, ...], str]:
    """Is it a fisheye, how many coefficients it may have, and what the file calls it."""
    said: dict[str, tuple[bool, tuple[int, ...]]] = {}
    named = any(fields.get(name) is not None for name in (*_NAMING, *_FLAGS) if name not in _LOOSE)
    for name in _NAMING:
        value = fields.get(name)
        if value is None or (isinstance(value, str) and not value.strip()):
            continue
        if not isinstance(value, str) or _word(value) not in _MODELS:
            if name in _LOOSE and named and _word(value) not in _OTHERS:
                continue
            raise ValueError(
                f"{name}: expected {', '.join(_MODELS)}, got {_short(value)}. {_TO_OPENCV}. "
                "A name of the camera goes under camera_name"
            )
        known = _MODELS[_word(value)]
        if known is not None:
            said[f"{name} {value.strip()}"] = known
    for name in _FLAGS:
        value = fields.get(name)
        if value is not None:
            flag = _flag(value)
            if flag is None:
                raise ValueError(
                    f"{name}: expected 1 for a fisheye or 0 for another lens, got {_short(value)}"
                )
            said[f"{name} {int(flag)}"] = (flag, FISHEYE_COUNTS if flag else PINHOLE_COUNTS)
    if len({fisheye for fisheye, _ in said.values()}) > 1:
        raise ValueError(f"expected one lens model, got {' and '.join(said)}. Which of them is it?")
    if not said:
        return False, PINHOLE_COUNTS, ""
    narrowest = min(said, key=lambda name: len(said[name][1]))
    return *said[narrowest], narrowest


def _fitted(values: Float64Array, counts: tuple[int, ...], model: str) -> Float64Array:
    """As many coefficients as the model has; zeros behind them say nothing, nor do fewer zeros."""
    if len(values) in counts:
        return values
    if not values.any() and len(values) < counts[0]:
        return np.zeros(counts[0])
    fewer = [count for count in counts if count < len(values)]
    if fewer and not values[fewer[-1] :].any():
        return values[: fewer[-1]]
    of = f" of {model}" if model else ""
    many = " or ".join(map(str, counts))
    raise ValueError(
        f"distortion_coefficients: expected {many} finite numbers{of}, got {values.tolist()[:16]}. "
        f"{_TO_OPENCV}"
    )


def _numbers(value: Any, name: str) -> Float64Array:
    """A list of numbers, be it in rows, or in a matrix as OpenCV and ROS write it."""
    rows = cols = None
    if isinstance(value, dict):
        rows, cols, value = value.get("rows"), value.get("cols"), value.get("data")
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        value = [entry for row in value for entry in row]
    if not isinstance(value, list) or not all(isinstance(entry, float) for entry in value):
        raise ValueError(f"{name}: expected at most {_MOST_NUMBERS} numbers, got {_short(value)}. {_OWN}")
    counted = isinstance(rows, float) and isinstance(cols, float) and rows * cols == len(value)
    if not counted and (rows, cols) != (None, None):
        raise ValueError(
            f"{name}: expected {_short(rows)} x {_short(cols)} numbers as it says, got {len(value)}. {_OWN}"
        )
    array = np.array(value, np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers, got {_short(value)}. Calibrate again")
    return array


def _word(value: Any) -> str:
    """A name as it is compared."""
    return re.sub(r"[\s-]+", "_", str(value).strip().lower())


def _flag(value: Any) -> bool | None:
    """Yes or no, however it is written; None where it is neither."""
    if isinstance(value, float):
        return None if not math.isfinite(value) else bool(value)
    return {"true": True, "yes": True, "false": False, "no": False}.get(_word(value))


def _short(value: Any) -> str:
    """What stands there, in a few characters that print."""
    return repr(value)[:60]


def _listed(found: Fields) -> str:
    """The first of its fields."""
    names = [name[:30] if name.isprintable() else repr(name)[:30] for name in found]
    return ", ".join(names[:12]) + (" and more" if len(names) > 12 else "") or "nothing"
