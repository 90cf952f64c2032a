"""Networks as segmenters and depth models."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from dream.geometry import SE3, Camera, camera_mount
from dream.perception import FlatFloor, LearnedDepth, LearnedLabels, Perception, Sidecar, View, read_sidecar
from dream.perception.flat_floor import floor_depth, rays
from dream.perception.placing import placed, resampled
from dream.perception.scaling import fit_to_floor
from dream.types import Float32Array, Label, UInt8Array
from tests.perception.models import constant, instances, redness, redness_last

CLASSES = {"floor": "seabed", "shell": "target", "pipe": "obstacle"}
LOGITS = {"output": "logits", "classes": CLASSES}
CAMERA = Camera.from_fov(64, 48, math.radians(90.0))
VIEW = View(CAMERA, SE3.level(0.0, 0.0, 0.0, 0.4), camera_mount(math.radians(20.0)), 0.6)


def scene() -> UInt8Array:
    rgb = np.full((48, 64, 3), 100, np.uint8)
    rgb[20:30, 10:20] = (220, 100, 40)
    rgb[20:40, 40:46] = (20, 200, 200)
    return rgb


def expected() -> UInt8Array:
    labels = np.full((48, 64), Label.SEABED, np.uint8)
    labels[20:30, 10:20] = Label.TARGET
    labels[20:40, 40:46] = Label.OBSTACLE
    return labels


# ------------------------------------------------------------------------------------- scores per pixel


def test_scores_become_labels_and_probabilities(tmp_path: Path) -> None:
    path = redness(tmp_path / "m.onnx")
    (tmp_path / "m.json").write_text(json.dumps(LOGITS))
    labels, confidence = LearnedLabels(path).segment(scene())
    assert (labels == expected()).mean() > 0.98
    assert labels.dtype == np.uint8
    assert confidence.dtype == np.float32
    assert confidence[25, 15] > 0.99
    # Softmax by hand: on grey of 100 / 255 the scores are 0, −17.5 and −25.6.
    soft = LearnedLabels(redness(tmp_path / "n.onnx", gain=2.0), sidecar=Sidecar.model_validate(LOGITS))
    others = math.exp(-0.7) + math.exp(2.0 * (-100 / 255 - 0.12))
    assert soft.segment(scene())[1][5, 5] == pytest.approx(1.0 / (1.0 + others), abs=1e-4)


def test_a_sidecar_in_toml_says_the_same(tmp_path: Path) -> None:
    lines = ['output = "logits"', "width = 32", "height = 24", "[classes]"]
    lines += [f'{name} = "{label}"' for name, label in CLASSES.items()]
    (tmp_path / "m.toml").write_text("\n".join(lines))
    path = redness(tmp_path / "m.onnx", open_size=True)
    labels, _ = LearnedLabels(path).segment(scene())
    assert (labels == expected()).mean() > 0.98


def test_channels_may_come_last(tmp_path: Path) -> None:
    usual = LearnedLabels(redness(tmp_path / "m.onnx"), sidecar=Sidecar.model_validate(LOGITS))
    last = Sidecar.model_validate({**LOGITS, "layout": "NHWC"})
    other = LearnedLabels(redness_last(tmp_path / "n.onnx"), sidecar=last)
    (labels, confidence), (same, sure) = usual.segment(scene()), other.segment(scene())
    np.testing.assert_array_equal(labels, same)
    np.testing.assert_allclose(confidence, sure, atol=1e-6)


def test_colours_may_be_the_other_way_round_and_normalised(tmp_path: Path) -> None:
    path, rgb = redness(tmp_path / "m.onnx"), scene()
    usual = LearnedLabels(path, sidecar=Sidecar.model_validate(LOGITS)).segment(rgb)
    turned = Sidecar.model_validate({**LOGITS, "colours": "BGR"})
    other = LearnedLabels(path, sidecar=turned).segment(np.ascontiguousarray(rgb[..., ::-1]))
    np.testing.assert_array_equal(usual[0], other[0])
    # x = (rgb / 255 - mean) / std: a mean that only red has moves what counts as red.
    shifted = Sidecar.model_validate({**LOGITS, "mean": (0.9, 0.0, 0.0)})
    assert not (LearnedLabels(path, sidecar=shifted).segment(rgb)[0] == Label.TARGET).any()


def test_a_letterbox_puts_labels_where_the_picture_shows_them(tmp_path: Path) -> None:
    wide = np.full((24, 96, 3), 100, np.uint8)
    wide[8:16, 30:60] = (220, 100, 40)
    boxed = Sidecar.model_validate({**LOGITS, "letterbox": True})
    labels, _ = LearnedLabels(redness(tmp_path / "m.onnx"), sidecar=boxed).segment(wide)
    truth = np.zeros((24, 96), np.bool_)
    truth[8:16, 30:60] = True
    found = labels == Label.TARGET
    assert (found & truth).sum() / (found | truth).sum() > 0.7


def test_maps_are_resampled_at_the_middles_of_pixels() -> None:
    maps = np.arange(4.0, dtype=np.float32).reshape(1, 1, 4).repeat(3, axis=1)
    frame = placed((6, 8), 3, 4, letterbox=False)
    fine = resampled(maps, frame, (6, 8))
    np.testing.assert_allclose(fine[0, 2], [0.0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3.0], atol=1e-6)


# ------------------------------------------------------------------------------------------- instances

METADATA = {"task": "segment", "names": "{0: 'oyster', 1: 'pipe'}", "imgsz": "[64, 64]", "stride": "32"}


def table_and_masks() -> tuple[np.ndarray, np.ndarray]:
    """Two prototypes, the left and the right half; an oyster at the left, a pipe at the right."""
    masks = np.full((2, 16, 16), -8.0)
    masks[0, :, :8], masks[1, :, 8:] = 8.0, 8.0
    rows = [
        [16.0, 32.0, 16.0, 24.0, 0.9, 0.05, 1.0, 0.0],
        [48.0, 32.0, 8.0, 48.0, 0.1, 0.8, 0.0, 1.0],
        [32.0, 32.0, 60.0, 60.0, 0.1, 0.1, 1.0, 0.0],  # Below the least score.
    ]
    return np.array(rows).T, masks


def drawn() -> UInt8Array:
    labels = np.full((64, 64), Label.SEABED, np.uint8)
    labels[20:44, 8:24] = Label.TARGET
    labels[8:56, 44:52] = Label.OBSTACLE
    return labels


def test_an_ultralytics_model_needs_no_sidecar(tmp_path: Path) -> None:
    model = LearnedLabels(instances(tmp_path / "m.onnx", *table_and_masks(), METADATA))
    labels, confidence = model.segment(np.zeros((64, 64, 3), np.uint8))
    found, truth = labels != Label.SEABED, drawn() != Label.SEABED
    assert (found & truth).sum() / (found | truth).sum() > 0.75
    assert labels[32, 16] == Label.TARGET
    assert labels[32, 48] == Label.OBSTACLE
    assert confidence[32, 16] == pytest.approx(0.9, abs=0.01)
    assert confidence[2, 2] == pytest.approx(1.0)


def test_a_model_that_thins_out_its_boxes_itself_says_the_same(tmp_path: Path) -> None:
    table, masks = table_and_masks()
    thinned = np.array(
        [[8.0, 20.0, 24.0, 44.0, 0.9, 0.0, 1.0, 0.0], [44.0, 8.0, 52.0, 56.0, 0.8, 1.0, 0.0, 1.0]]
    )
    rgb = np.zeros((64, 64, 3), np.uint8)
    usual, _ = LearnedLabels(instances(tmp_path / "a.onnx", table, masks, METADATA)).segment(rgb)
    other, _ = LearnedLabels(instances(tmp_path / "b.onnx", thinned, masks, METADATA)).segment(rgb)
    np.testing.assert_array_equal(usual, other)


def test_what_belongs_to_no_instance_is_left_to_another_segmenter(tmp_path: Path) -> None:
    class Walls:
        def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
            return np.full(rgb.shape[:2], Label.OBSTACLE, np.uint8), np.full(rgb.shape[:2], 0.7, np.float32)

    path = instances(tmp_path / "m.onnx", *table_and_masks(), METADATA)
    labels, confidence = LearnedLabels(path, under=Walls()).segment(np.zeros((64, 64, 3), np.uint8))
    assert labels[32, 16] == Label.TARGET
    assert labels[2, 2] == Label.OBSTACLE
    assert confidence[2, 2] == pytest.approx(0.7)


def test_a_class_whose_label_nobody_knows_is_refused_until_told(tmp_path: Path) -> None:
    strange = {**METADATA, "names": "{0: 'Crassostrea', 1: 'pipes'}"}
    path = instances(tmp_path / "m.onnx", *table_and_masks(), strange)
    with pytest.raises(ValueError, match="class 'Crassostrea': expected to know whether it is water, seabed"):
        LearnedLabels(path)
    with pytest.raises(
        ValueError, match=r'"output": "instances", .*"classes": {"Crassostrea": "\?", "pipes"'
    ):
        LearnedLabels(path)
    labels, _ = LearnedLabels(path, classes={"Crassostrea": "target"}).segment(
        np.zeros((64, 64, 3), np.uint8)
    )
    assert labels[32, 16] == Label.TARGET
    assert labels[32, 48] == Label.OBSTACLE


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"task": "detect"}, "task 'segment', got 'detect'"),
        ({"names": "__import__('os').getcwd()"}, "names: expected a Python literal"),
        ({"names": "{0: 'oyster', 2: 'pipe'}"}, "a name for each class from 0"),
        ({"names": ""}, "names: expected it in the model's metadata"),
        ({"imgsz": "[64, 64, 64]"}, "imgsz: expected height and width"),
        ({"imgsz": "[1000000, 64]"}, "height: Input should be less"),
        ({"imgsz": "[32, 64]"}, "height: the model takes 64, but its sidecar says 32"),
        ({"names": "{0: 'oyster', 1: 'pipe', 2: 'wall'}"}, r"expected \(1, 9, N\)"),
    ],
)
def test_metadata_that_do_not_fit_are_refused(tmp_path: Path, change: dict[str, str], reason: str) -> None:
    path = instances(tmp_path / "m.onnx", *table_and_masks(), {**METADATA, **change})
    with pytest.raises(ValueError, match=reason):
        LearnedLabels(path)


# ---------------------------------------------------------------------------------------------- sidecars


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "expected JSON or TOML"),
        ("[" * 100_000, "sidecar"),
        ('{"output": "logits"}', "classes: expected names and labels"),
        ('{"output": "boxes"}', "output: Input should be"),
        ('{"output": "metric_depth", "std": [0, 1, 1]}', "std.0: Input should be greater than 0"),
        ('{"output": "metric_depth", "mean": [NaN, 1, 1]}', "mean.0: Input should be a finite number"),
        ('{"output": "metric_depth", "widht": 64}', "widht: Extra inputs are not permitted"),
        ('{"output": "logits", "classes": {"shell": "food"}}', "classes.shell: Input should be"),
    ],
)
def test_a_sidecar_that_says_nothing_sound_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "m.json").write_text(text)
    with pytest.raises(ValueError, match=reason):
        read_sidecar(tmp_path / "m.json")


def test_a_sidecar_for_another_model_is_refused(tmp_path: Path) -> None:
    path = redness(tmp_path / "m.onnx")
    for change, reason in (
        ({"classes": {"shell": "target"}}, r"logits: expected \(1, 1, h, w\), a score for each class"),
        ({"layout": "NHWC"}, "expected 3 channels in NHWC"),
        ({"width": 640}, "width: the model takes 32, but its sidecar says 640"),
        ({"name": "depth"}, "name: expected one of scores, got 'depth'"),
        ({"output": "metric_depth"}, "output: expected logits, probabilities, classes, instances for labels"),
        ({"output": "instances"}, "instances: expected boxes in 3"),
    ):
        with pytest.raises(ValueError, match=reason):
            LearnedLabels(path, sidecar=Sidecar.model_validate({**LOGITS, **change}))
    with pytest.raises(ValueError, match="expected a sidecar beside it"):
        LearnedLabels(path)
    with pytest.raises(ValueError, match="height: the model takes any"):
        LearnedLabels(redness(tmp_path / "n.onnx", open_size=True), sidecar=Sidecar.model_validate(LOGITS))


# ------------------------------------------------------------------------------------------------- depth


def flat() -> np.ndarray:
    return floor_depth(rays(VIEW), 20.0)


def depth_of(path: Path, output: str, labels: UInt8Array) -> tuple[Float32Array, Float32Array]:
    model = LearnedDepth(path, sidecar=Sidecar.model_validate({"output": output}))
    rgb = np.zeros((48, 64, 3), np.uint8)
    return model.estimate(rgb, labels, VIEW)


def seen() -> tuple[np.ndarray, UInt8Array]:
    """A floor on which a wall stands; true depth and labels."""
    labels = np.full((48, 64), Label.SEABED, np.uint8)
    labels[:24] = Label.OBSTACLE
    truth = FlatFloor().estimate(np.zeros((48, 64, 3), np.uint8), labels, VIEW)[0]
    return truth, labels


@pytest.mark.parametrize(
    ("output", "raw"), [("relative_depth", lambda z: 7.0 * z), ("inverse_depth", lambda z: 40.0 / z - 9.0)]
)
def test_a_relative_depth_gets_its_metres_from_the_floor(tmp_path: Path, output: str, raw: object) -> None:
    assert callable(raw)
    truth, labels = seen()
    depth, confidence = depth_of(constant(tmp_path / "m.onnx", raw(truth)), output, labels)
    np.testing.assert_allclose(depth, truth, rtol=1e-3)
    np.testing.assert_allclose(confidence, 1.0)


def test_water_has_no_depth_whatever_the_network_says(tmp_path: Path) -> None:
    truth, labels = seen()
    labels[:10] = Label.WATER
    depth, confidence = depth_of(constant(tmp_path / "m.onnx", truth), "metric_depth", labels)
    assert np.isnan(depth[:10]).all()
    assert (confidence[:10] == 0.0).all()
    assert np.isfinite(depth[10:]).all()


def test_metric_depth_stays_and_is_doubted_as_far_as_it_leaves_the_floor(tmp_path: Path) -> None:
    truth, labels = seen()
    depth, confidence = depth_of(constant(tmp_path / "a.onnx", truth), "metric_depth", labels)
    np.testing.assert_allclose(depth, truth, rtol=1e-5)
    np.testing.assert_allclose(confidence, 1.0)
    depth, confidence = depth_of(constant(tmp_path / "b.onnx", 1.5 * truth), "metric_depth", labels)
    np.testing.assert_allclose(depth, 1.5 * truth, rtol=1e-5)
    assert (confidence == 0.0).all()


@pytest.mark.parametrize("wrong", [lambda z: 3.0 * z, lambda z: 0.3 * z, lambda z: 1.5 * z - 0.2])
def test_metres_that_the_floor_contradicts_are_not_believed(tmp_path: Path, wrong: object) -> None:
    """Also where they agree by chance on a few pixels."""
    assert callable(wrong)
    truth, labels = seen()
    by_chance = np.random.default_rng(2).random(truth.shape) < 0.05
    raw = np.where(by_chance, truth, wrong(truth))
    depth, confidence = depth_of(constant(tmp_path / "m.onnx", raw), "metric_depth", labels)
    assert np.isfinite(depth[24:]).any()
    assert (confidence == 0.0).all()


def test_metres_of_which_no_floor_tells_are_half_believed(tmp_path: Path) -> None:
    truth, labels = seen()
    labels[:] = Label.OBSTACLE
    _, confidence = depth_of(constant(tmp_path / "m.onnx", truth), "metric_depth", labels)
    np.testing.assert_allclose(confidence, 0.5)


@pytest.mark.parametrize("number", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize(
    ("output", "raw"),
    [
        ("metric_depth", lambda z: z),
        ("relative_depth", lambda z: 7.0 * z),
        ("inverse_depth", lambda z: 40.0 / z - 9.0),
    ],
)
def test_a_depth_that_is_not_finite_costs_its_pixel(
    tmp_path: Path, number: float, output: str, raw: object
) -> None:
    assert callable(raw)
    truth, labels = seen()
    spoilt = np.array(raw(truth))
    spoilt[30, 40] = number
    depth, confidence = depth_of(constant(tmp_path / "m.onnx", spoilt), output, labels)
    lost = np.isnan(depth)
    assert lost[30, 40]
    assert lost.sum() == 1
    np.testing.assert_allclose(depth[~lost], truth[~lost], rtol=1e-3)
    assert confidence[~lost].min() > 0.99


def test_a_depth_of_which_most_is_not_finite_is_not_used(tmp_path: Path) -> None:
    truth, labels = seen()
    spoilt = truth.copy()
    spoilt[:25] = np.inf
    depth, confidence = depth_of(constant(tmp_path / "m.onnx", spoilt), "metric_depth", labels)
    assert np.isnan(depth).all()
    assert (confidence == 0.0).all()


def test_a_depth_that_is_the_same_for_other_pictures_is_not_believed(tmp_path: Path) -> None:
    """Even where it is that of the floor, which looks the same everywhere from one height."""
    truth, labels = seen()
    sidecar = Sidecar.model_validate({"output": "metric_depth"})
    model = LearnedDepth(constant(tmp_path / "m.onnx", truth), sidecar=sidecar)
    rgb = np.zeros((48, 64, 3), np.uint8)
    sure = [float(model.estimate(rgb + np.uint8(n), labels, VIEW)[1].max()) for n in range(5)]
    np.testing.assert_allclose(sure, [1.0, 1.0, 1.0, 0.0, 0.0])


def test_a_third_of_wrong_pixels_does_not_move_the_scale() -> None:
    rng, floor = np.random.default_rng(3), flat()
    truth = floor.copy()
    wrong = rng.random(floor.shape) < 0.3
    truth[wrong] *= rng.uniform(0.2, 0.7, int(wrong.sum()))
    truth *= rng.normal(1.0, 0.01, floor.shape)
    fit = fit_to_floor(5.0 / truth + 1.0, floor, np.isfinite(floor), inverse=True)
    assert fit is not None
    assert fit.scale == pytest.approx(0.2, rel=0.03)
    assert fit.shift == pytest.approx(-0.2, abs=0.03)
    assert fit.agreement == pytest.approx(0.7, abs=0.05)


def test_a_depth_that_says_nothing_of_the_floor_has_no_scale(tmp_path: Path) -> None:
    truth, labels = seen()
    for raw in (np.full((48, 64), 3.0), np.zeros((48, 64)), truth):
        depth, confidence = depth_of(constant(tmp_path / "m.onnx", raw), "inverse_depth", labels)
        assert np.isnan(depth).all()
        assert (confidence == 0.0).all()
    only_wall = np.full((48, 64), Label.OBSTACLE, np.uint8)
    depth, _ = depth_of(constant(tmp_path / "n.onnx", truth), "relative_depth", only_wall)
    assert np.isnan(depth).all()


def test_whatever_a_network_says_of_depth_is_metres_or_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(39)
    truth, labels = seen()
    believed = 0
    for n in range(40):
        raw = truth * 10.0 ** rng.integers(-1, 3) * rng.choice([1.0, -1.0], p=[0.9, 0.1])
        raw += rng.normal(0.0, 0.02, raw.shape) * raw
        output = ("metric_depth", "relative_depth", "inverse_depth")[n % 3]
        raw = 1.0 / raw if output == "inverse_depth" else raw
        spoilt = rng.random(raw.shape) < rng.choice([0.0, 0.01, 0.4, 0.9])
        raw[spoilt] = rng.choice([np.nan, np.inf, -np.inf, 0.0, 3e38, -1.0], int(spoilt.sum()))
        path = constant(tmp_path / "m.onnx", raw)
        depth, confidence = depth_of(path, output, np.where(rng.random(raw.shape) < 0.1, 0, labels))
        known = np.isfinite(depth)
        assert np.isnan(depth[~known]).all()
        assert ((depth[known] > 0.0) & (depth[known] <= 20.0)).all()
        assert ((confidence >= 0.0) & (confidence <= 1.0)).all()
        assert (confidence[~known] == 0.0).all()
        believed += bool((confidence > 0.5).any())
    assert 10 <= believed < 40


def test_an_output_that_is_no_map_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="depth: expected one number a pixel"):
        LearnedDepth(redness(tmp_path / "m.onnx"), sidecar=Sidecar.model_validate({"output": "metric_depth"}))


def test_networks_make_a_perception(tmp_path: Path) -> None:
    truth, _ = seen()
    segmenter = LearnedLabels(redness(tmp_path / "l.onnx"), sidecar=Sidecar.model_validate(LOGITS))
    depth_model = LearnedDepth(
        constant(tmp_path / "d.onnx", truth), sidecar=Sidecar.model_validate({"output": "metric_depth"})
    )
    perception = Perception(segmenter, depth_model)
    shows = perception.perceive(scene(), VIEW)
    assert (shows.labels == expected()).mean() > 0.98
    assert np.isfinite(shows.depth).all()
    assert ((shows.confidence >= 0.0) & (shows.confidence <= 1.0)).all()
