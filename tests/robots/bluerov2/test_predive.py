"""The pre-dive list believes no picture that its own models do not."""

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dream.commands.dive.predive import _floor, _in_time, _looked, _pointed
from dream.geometry import SE2, SE3, Camera, FloatArray
from dream.perception import FlatFloor, LearnedDepth, Parallax, Perception, Shells, View
from dream.perception.flat_floor import floor_depth, rays
from dream.protocol import DREAM_V2, POOL_V1, SurveyProtocol
from dream.robots.bluerov2.check import Finding
from dream.robots.bluerov2.lens import Calibrated, Lens
from dream.robots.bluerov2.navigation import Fix, NotReady
from dream.sim.render import Renderer
from dream.sim.worlds import make_world
from dream.types import BoolArray, Float32Array, Label, UInt8Array
from tests.perception.models import constant
from tests.robots.bluerov2.test_bridge import fix_at

MOUNT = POOL_V1.T_base_camera
CAMERA = Camera.from_fov(32, 24, POOL_V1.camera.horizontal_fov)
"""Of the models: they answer for 24 × 32 pixels."""


@dataclass
class Tank:
    """A vehicle in it, as the list sees it."""

    rgb: UInt8Array
    fix: Fix | None = field(default_factory=fix_at)
    unseen: bool = False
    beams: FloatArray | None = None

    def looked(self, perception: Perception) -> Finding:
        ready: Any = SimpleNamespace(
            sight=SimpleNamespace(lens=None, perception=perception),
            tank=object(),
            eye=self,
            devices=SimpleNamespace(camera=self, navigator=self, beams=self.beams),
            protocol=POOL_V1,
            start=SE2(0.0, 0.0, 0.0),
            mount=MOUNT,
        )
        return _looked(ready)

    def newest(self, max_age: float) -> object:
        return SimpleNamespace(rgb=self.rgb)

    def view(self, picture: object, camera: Camera) -> tuple[UInt8Array, BoolArray]:
        return self.rgb, np.full((camera.height, camera.width), not self.unseen)

    def update(self) -> Fix:
        if self.fix is None:
            raise NotReady("it does not lie still")
        return self.fix


def metric(path: Path, times: float, height: float) -> LearnedDepth:
    """A network that says of every picture what a flat floor so far below looks like, times a factor."""
    level = SE3.level(0.0, 0.0, 0.0, 0.0)
    floor = floor_depth(rays(View(CAMERA, level, MOUNT, height)), 200.0)
    path.with_suffix(".json").write_text(json.dumps({"output": "metric_depth"}))
    return LearnedDepth(constant(path, times * np.nan_to_num(floor, nan=100.0)))


@pytest.fixture(scope="module")
def rgb() -> UInt8Array:
    """What the camera sees in the tank."""
    T_world_base = SE3.level(-0.25, -0.75, -0.92, 1.05)
    return Renderer(make_world("pool/arc", 1)).render(POOL_V1.camera, T_world_base @ MOUNT).rgb


def test_a_lens_file_of_another_ratio_is_told_as_that(rgb: UInt8Array) -> None:
    matrix = np.array([[1000.0, 0.0, 960.0], [0.0, 1000.0, 540.0], [0.0, 0.0, 1.0]])
    lens = Lens(1920, 1080, matrix, np.zeros(4), fisheye=False, calibrated=Calibrated.WATER)

    class Seen(Tank):
        def view(self, picture: object, camera: Camera) -> tuple[UInt8Array, BoolArray]:
            lens.at(rgb.shape[1], rgb.shape[0])
            raise AssertionError

    found = Seen(rgb).looked(Perception(Shells(), FlatFloor()))
    assert not found.ok
    assert "width to height as in the lens file, 1920 x 1080 (ratio 1.78), got" in found.said
    assert "(ratio 1.33)" in found.said
    assert found.wanted == "no --calibration: the camera of the stand-in has no lens to correct"


def test_depth_and_labels_that_need_no_model_are_ok(rgb: UInt8Array) -> None:
    found = Tank(rgb).looked(Perception(Shells(), FlatFloor()))
    assert found.ok
    assert "with a confidence of " in found.said
    assert "confidence of 0%" not in found.said


def test_metres_that_are_three_times_too_far_are_no_go(rgb: UInt8Array, tmp_path: Path) -> None:
    wrong = Tank(rgb).looked(Perception(Shells(), metric(tmp_path / "m.onnx", 3.0, 0.6)))
    assert not wrong.ok
    assert "with a confidence of 0%" in wrong.said
    assert "sidecar" in wrong.wanted
    right = Tank(rgb).looked(Perception(Shells(), metric(tmp_path / "n.onnx", 1.0, 0.6)))
    assert right.ok
    assert "with a confidence of 0%" not in right.said


def test_beams_in_view_are_told(rgb: UInt8Array, tmp_path: Path) -> None:
    """Two points ahead, where the camera sees the floor."""
    floor = 0.6 / math.cos(math.radians(22.5))
    beams = np.array([[1.2, 0.3, -0.6], [1.2, -0.3, -0.6], [-0.2, 0.2, -floor], [-0.2, -0.2, -floor]])
    for times, against in ((1.0, 0), (3.0, 2)):
        depth = metric(tmp_path / f"{times}.onnx", times, 0.6)
        found = Tank(rgb, beams=beams).looked(Perception(Shells(), depth, Parallax()))
        assert f"; {against} of 2 beams of the DVL in view contradict it" in found.said
        assert found.ok is (against == 0)
    assert "beams" not in Tank(rgb, beams=beams).looked(Perception(Shells(), FlatFloor())).said


def test_the_list_leaves_nothing_in_the_memory_of_the_check(rgb: UInt8Array) -> None:
    perception = Perception(Shells(), FlatFloor(), Parallax())
    Tank(rgb).looked(perception)
    assert perception.check is not None
    assert not perception.check._shots


def test_labels_that_call_seabed_what_is_above_the_horizon_are_told(rgb: UInt8Array) -> None:
    """A network that knows nothing but shells is well over sand, and sees no wall."""
    found = Tank(rgb).looked(Perception(Says(Label.SEABED), FlatFloor()))
    assert found.ok
    assert "100% of what is above the horizon is seabed" in found.said
    assert "above the horizon" not in Tank(rgb).looked(Perception(Shells(), FlatFloor())).said


@pytest.mark.parametrize("times", [2.0, 0.4, 1.2])
def test_depth_that_the_height_contradicts_is_no_go_with_how_far_it_is_off(
    rgb: UInt8Array, tmp_path: Path, times: float
) -> None:
    found = Tank(rgb).looked(Perception(Shells(), metric(tmp_path / "m.onnx", times, 0.6)))
    assert not found.ok
    assert f"depth {times:.2f} times the floor's, 0% of it agrees" in found.said
    assert 'With "output": "relative_depth" the floor gives the scale' in found.wanted


@dataclass
class Says:
    """The same of every pixel; the first rows have no label."""

    label: Label
    sure: float = 0.9
    lost: float = 0.0

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        labels = np.full(rgb.shape[:2], self.label, np.uint8)
        sure = np.full(labels.shape, self.sure, np.float32)
        rows = round(self.lost * len(labels))
        labels[:rows], sure[:rows] = Label.WATER, 0.0
        return labels, sure


@pytest.mark.parametrize(
    ("says", "said"),
    [
        (Says(Label.TARGET), "labels: every pixel is target"),
        (Says(Label.OBSTACLE, lost=0.2), "20% without a label"),
        (Says(Label.OBSTACLE, lost=1.0), "labels: the network gives none that can be believed"),
        (Says(Label.OBSTACLE, sure=0.05), "with a confidence of 5%: 100% obstacle"),
    ],
)
def test_labels_that_cannot_be_believed_are_no_go(rgb: UInt8Array, says: Says, said: str) -> None:
    found = Tank(rgb).looked(Perception(says, FlatFloor()))
    assert not found.ok
    assert said in found.said


def test_metres_are_judged_at_the_height_that_the_vehicle_lies_at(rgb: UInt8Array, tmp_path: Path) -> None:
    """Before a dive it floats at the surface, and not as high above the floor as it will dive."""
    perception = Perception(Shells(), metric(tmp_path / "m.onnx", 1.0, 1.4))
    afloat = replace(fix_at(), T_world_base=SE3.level(0.0, 0.0, -0.1, 0.0))
    assert Tank(rgb, afloat).looked(perception).ok
    # Where nobody knows the height, it is that of the dive.
    for unknown in (None, replace(afloat, seabed=np.nan)):
        assert not Tank(rgb, unknown).looked(perception).ok


def test_a_view_without_any_depth_is_no_go(rgb: UInt8Array) -> None:
    found = Tank(rgb, unseen=True).looked(Perception(Shells(), FlatFloor()))
    assert not found.ok
    assert "0% of the view" in found.said


@pytest.mark.parametrize(
    ("seabed", "ok", "said"),
    [
        (-1.5, True, "0.6 m above it is 0.9 m deep, 2 m are allowed"),
        (-2.7, False, "0.6 m above it is 2.1 m deep"),
        # Under water, but so near the surface that the way home would disarm it there at once.
        (-0.9, False, "0.6 m above it is 0.3 m deep"),
        (-0.6, False, "0.6 m above it is out of the water"),
        (0.3, False, "0.6 m above it is out of the water"),
    ],
)
def test_a_floor_is_well_where_the_dive_is_neither_at_the_surface_nor_too_deep(
    seabed: float, ok: bool, said: str
) -> None:
    ready: Any = SimpleNamespace(
        protocol=POOL_V1,
        limits=SimpleNamespace(depth=2.0),
        devices=SimpleNamespace(
            now=lambda: 0.0,
            threads=SimpleNamespace(sleep=lambda _: None),
            navigator=SimpleNamespace(update=lambda: replace(fix_at(), seabed=seabed)),
        ),
    )
    found = _floor(ready)
    assert found.ok is ok
    assert said in found.said
    assert found.wanted == "0.4 to 2 m: a deeper floor, or another --max-depth"


@pytest.mark.parametrize(
    ("protocol", "most", "ok", "looked"),
    [
        (POOL_V1, 45.0, True, [20.0]),
        (DREAM_V2, 45.0, True, [45.0, -25.0, 20.0]),
        # A camera that is fixed.
        (DREAM_V2, 20.0, False, [45.0]),
    ],
)
def test_in_space_a_mount_has_to_look_everywhere_and_ends_as_at_the_launch(
    protocol: SurveyProtocol, most: float, ok: bool, looked: list[float]
) -> None:
    asked = []

    def tilt_camera(up: float) -> float:
        asked.append(round(-math.degrees(up), 3))
        if abs(math.degrees(up)) > most + 1e-6:
            raise TimeoutError("camera tilt: expected -45° within 4 s, got -20°")
        return up

    ready: Any = SimpleNamespace(
        told=SimpleNamespace(tilt=20.0, lights=None),
        protocol=protocol,
        devices=SimpleNamespace(link=SimpleNamespace(tilt_camera=tilt_camera)),
    )
    found = _pointed(ready)
    assert (found.ok, asked) == (ok, looked)
    assert (
        "looks 20° down" if protocol is POOL_V1 else "45° and -25° and 20° down"
    ) in found.wanted + found.said


@dataclass
class Slow:
    """A computer on a clock of its own, which a picture and a late beat advance by so many seconds."""

    picture: float = 0.0
    beat: float = 0.0
    time: float = 0.0
    over: bool = False

    def now(self) -> float:
        return self.time

    def sleep(self, seconds: float) -> None:
        self.time += seconds

    def event(self) -> Any:
        self.over = False
        return SimpleNamespace(is_set=lambda: self.over, set=lambda: None, wait=self.wait)

    def wait(self, seconds: float) -> None:
        self.time += seconds + self.beat
        self.over = True

    def start(self, run: Any, name: str) -> Any:
        run()
        return SimpleNamespace(join=lambda seconds: None)

    @property
    def anew(self) -> Any:
        return self

    def perceive(self, *arguments: Any) -> None:
        self.time += self.picture

    def judged(self, *, tank: object = None) -> Finding:
        eye = SimpleNamespace(
            newest=lambda max_age: None,
            view=lambda picture, camera: (None, None),
            operator_alive=lambda: None,
        )
        ready: Any = SimpleNamespace(
            devices=SimpleNamespace(
                now=self.now,
                threads=self,
                camera=eye,
                link=eye,
                navigator=SimpleNamespace(update=lambda: None),
            ),
            eye=eye,
            sight=SimpleNamespace(perception=self),
            tank=tank,
            protocol=POOL_V1,
            start=SE2(0.0, 0.0, 0.0),
            mount=MOUNT,
        )
        return _in_time(ready)


def test_a_computer_that_beats_and_labels_in_time_is_well() -> None:
    found = Slow(picture=1.4).judged()
    assert found.ok
    assert found.said == "0% of its beats late, the latest by 0.00 s; a picture labelled in 1.40 s at most"


@pytest.mark.parametrize(
    ("slow", "said"),
    [
        (Slow(picture=1.6), "a picture labelled in 1.60 s at most"),
        (Slow(beat=0.35), "100% of its beats late, the latest by 0.35 s"),
    ],
)
def test_a_computer_that_is_too_slow_is_no_go_but_beside_a_tank_that_takes_a_core(
    slow: Slow, said: str
) -> None:
    found = slow.judged()
    assert not found.ok
    assert said in found.said
    assert "depth and labels of a picture within 1.5 s: smaller models" in found.wanted
    assert slow.judged(tank=object()).ok
