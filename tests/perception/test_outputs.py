"""Outputs of label networks in all forms that exporters write, and sidecars that do not fit them."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from dream.perception import LearnedLabels, Sidecar, View, read_sidecar
from dream.perception.sidecar import check_names
from dream.types import Float32Array, Label, UInt8Array
from tests.perception.models import ending, instances

node = helper.make_node
RED_NOT_BLUE = np.array([[20.0, 0.0, -20.0, -5.0]])
"""A class that is red: 15 of red, −25 of blue, −5 of black and white."""
RED_OR_NOT = np.concatenate([RED_NOT_BLUE, -RED_NOT_BLUE])
BOTH_RED = np.concatenate([RED_NOT_BLUE, RED_NOT_BLUE])
FOUR = np.array([[0.0, 0.0, 0.0, 0.0], [9.0, 0.0, 0.0, 0.0], [0.0, 9.0, 0.0, 0.0], [-9.0, -9.0, 0.0, 1.0]])
"""The last is black."""
OYSTER: dict[str, Any] = {"output": "logits", "classes": {"oyster": "target"}}
TWO: dict[str, Any] = {"output": "logits", "classes": {"oyster": "target", "sand": "seabed"}}


def halves() -> UInt8Array:
    """Red on the left, blue on the right."""
    rgb = np.zeros((24, 32, 3), np.uint8)
    rgb[:, :16, 0], rgb[:, 16:, 2] = 255, 255
    return rgb


def seen(path: Path, sidecar: Mapping[str, Any], **options: Any) -> tuple[UInt8Array, Float32Array]:
    labels, confidence = LearnedLabels(path, sidecar=Sidecar.model_validate(sidecar), **options).segment(
        halves()
    )
    assert labels.dtype == np.uint8
    assert confidence.dtype == np.float32
    assert ((confidence >= 0.0) & (confidence <= 1.0)).all()
    return labels, confidence


def is_right(labels: UInt8Array) -> bool:
    """Target where it is red, and seabed elsewhere."""
    return bool((labels[:, :16] == Label.TARGET).all() and (labels[:, 16:] == Label.SEABED).all())


SIGMOID = node("Sigmoid", ["scores"], ["out"])
SOFTMAX = node("Softmax", ["scores"], ["out"], axis=1)
LAST = node("Transpose", ["scores"], ["out"], perm=[0, 2, 3, 1])
FLAT = node("Squeeze", ["scores", "axes"], ["out"])
BY_HAND = (
    node("Neg", ["scores"], ["minus"]),
    node("Exp", ["minus"], ["e"]),
    node("Add", ["e", "one"], ["more"]),
    node("Reciprocal", ["more"], ["out"]),
)
SOFTMAX_BY_HAND = (
    node("Exp", ["scores"], ["e"]),
    node("ReduceSum", ["e", "axis"], ["sum"], keepdims=1),
    node("Div", ["e", "sum"], ["out"]),
)
WEIGHTS = {"one": np.ones(1), "axis": np.array([1]), "axes": np.array([0, 1])}


# ------------------------------------------------------------------------------------------- one channel


@pytest.mark.parametrize(
    ("ends", "change"),
    [
        ((), {}),
        ((SIGMOID,), {}),
        ((SIGMOID,), {"output": "probabilities"}),
        (BY_HAND, {"output": "probabilities"}),
        ((LAST,), {}),
        ((FLAT,), {}),
    ],
    ids=["scores", "sigmoid", "sigmoid told", "sigmoid by hand", "last", "flat"],
)
def test_one_map_is_one_class_and_what_is_not_it(
    tmp_path: Path, ends: tuple[onnx.NodeProto, ...], change: dict[str, Any]
) -> None:
    path = ending(tmp_path / "m.onnx", RED_NOT_BLUE, *ends, weights=WEIGHTS)
    labels, confidence = seen(path, {**OYSTER, **change})
    assert is_right(labels)
    assert confidence.min() > 0.99
    # Half sure of both: a score of 0 is a probability of a half.
    even = ending(tmp_path / "n.onnx", 0.2 * RED_NOT_BLUE + [[0.0, 0.0, 0.0, 1.0]], *ends, weights=WEIGHTS)
    black = np.zeros((24, 32, 3), np.uint8)
    _, unsure = LearnedLabels(even, sidecar=Sidecar.model_validate({**OYSTER, **change})).segment(black)
    np.testing.assert_allclose(unsure, 0.5, atol=1e-6)


def test_what_is_not_the_class_is_left_to_another_segmenter(tmp_path: Path) -> None:
    class Walls:
        def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
            return np.full(rgb.shape[:2], Label.OBSTACLE, np.uint8), np.full(rgb.shape[:2], 0.7, np.float32)

    labels, confidence = seen(ending(tmp_path / "m.onnx", RED_NOT_BLUE), OYSTER, under=Walls())
    assert (labels[:, :16] == Label.TARGET).all()
    assert (labels[:, 16:] == Label.OBSTACLE).all()
    np.testing.assert_allclose(confidence[:, 16:], 0.7)


# ----------------------------------------------------------------------------------- softmax is inside


def many(count: int) -> tuple[np.ndarray, dict[str, Any]]:
    """Scores of an oyster and of many kinds of sand; all kinds but the first are the same."""
    scores = np.concatenate([RED_NOT_BLUE, np.repeat(-RED_NOT_BLUE, count - 1, axis=0)])
    return scores, {"oyster": "target", **{f"sand {n}": "seabed" for n in range(1, count)}}


@pytest.mark.parametrize("output", ["logits", "probabilities"])
@pytest.mark.parametrize(
    ("count", "ends", "out"),
    [
        (20, (SOFTMAX,), TensorProto.FLOAT),
        (40, SOFTMAX_BY_HAND, TensorProto.FLOAT),
        (
            9,
            (
                node("Softmax", ["scores"], ["soft"], axis=1),
                node("Transpose", ["soft"], ["out"], perm=[0, 2, 3, 1]),
            ),
            1,
        ),
        (
            30,
            (
                node("Softmax", ["scores"], ["soft"], axis=1),
                node("Cast", ["soft"], ["out"], to=TensorProto.FLOAT16),
            ),
            TensorProto.FLOAT16,
        ),
    ],
    ids=["softmax", "by hand", "last", "half"],
)
def test_a_softmax_that_is_inside_is_not_taken_again(
    tmp_path: Path, output: str, count: int, ends: tuple[onnx.NodeProto, ...], out: int
) -> None:
    scores, classes = many(count)
    path = ending(tmp_path / "m.onnx", scores, *ends, weights=WEIGHTS, out=out)
    labels, confidence = seen(path, {"output": output, "classes": classes})
    assert is_right(labels)
    assert confidence.min() > 0.99


def test_classes_of_one_label_add_up_after_one_softmax(tmp_path: Path) -> None:
    # e^1 of each of three kinds of sand is more than e^2 of the oyster.
    scores = np.zeros((4, 4))
    scores[:, 3] = 2.0, 1.0, 1.0, 1.0
    classes = {"oyster": "target", "a": "seabed", "b": "seabed", "c": "seabed"}
    e = np.exp([2.0, 1.0, 1.0, 1.0])
    for ends in ((), (SOFTMAX,)):
        labels, confidence = seen(
            ending(tmp_path / "m.onnx", scores, *ends), {"output": "logits", "classes": classes}
        )
        assert (labels == Label.SEABED).all()
        np.testing.assert_allclose(confidence, e[1:].sum() / e.sum(), rtol=1e-5)


# ------------------------------------------------------------------------------------ each class by itself


@pytest.mark.parametrize(
    ("ends", "output"),
    [((), "logits"), ((SIGMOID,), "probabilities"), ((SIGMOID,), "logits"), (BY_HAND, "probabilities")],
)
def test_classes_that_are_told_each_by_itself_leave_pixels_of_none(
    tmp_path: Path, ends: tuple[onnx.NodeProto, ...], output: str
) -> None:
    scores = np.array([[20.0, 0.0, -20.0, -5.0], [0.0, 20.0, -20.0, -5.0]])
    sidecar = {"output": output, "exclusive": False, "classes": {"oyster": "target", "rock": "obstacle"}}
    path = ending(tmp_path / "m.onnx", scores, *ends, weights=WEIGHTS)
    labels, confidence = seen(path, sidecar)
    assert is_right(labels)
    assert confidence.min() > 0.99
    # Red and green at once are both.
    yellow = np.full((24, 32, 3), (255, 255, 0), np.uint8)
    _, both = LearnedLabels(path, sidecar=Sidecar.model_validate(sidecar)).segment(yellow)
    np.testing.assert_allclose(both, 0.5, atol=0.01)


# -------------------------------------------------------------------------------------- numbers and masks

ARGMAX = node("ArgMax", ["scores"], ["out"], axis=1, keepdims=0)
BEST = node("ArgMax", ["scores"], ["best"], axis=1, keepdims=1)


@pytest.mark.parametrize(
    ("ends", "out"),
    [
        ((ARGMAX,), TensorProto.INT64),
        ((BEST, node("Cast", ["best"], ["out"], to=TensorProto.UINT8)), TensorProto.UINT8),
        ((BEST, node("Squeeze", ["best", "axes"], ["out"])), TensorProto.INT64),
        ((BEST, node("Cast", ["best"], ["out"], to=TensorProto.FLOAT)), TensorProto.FLOAT),
    ],
    ids=["1hw", "11hw bytes", "hw", "floats"],
)
def test_numbers_of_classes_are_labels_that_say_nothing_of_how_sure_they_are(
    tmp_path: Path, ends: tuple[onnx.NodeProto, ...], out: int
) -> None:
    path = ending(tmp_path / "m.onnx", RED_OR_NOT, *ends, weights=WEIGHTS, out=out)
    labels, confidence = seen(path, {**TWO, "output": "classes"})
    assert is_right(labels)
    np.testing.assert_allclose(confidence, 0.5)
    with pytest.raises(ValueError, match=r'whole numbers of .*Write "output": "classes"'):
        seen(path, TWO)


def test_numbers_are_not_averaged_where_the_picture_is_finer(tmp_path: Path) -> None:
    """Between class 0 and class 2 there is no class 1."""
    scores = np.concatenate([RED_NOT_BLUE, [[0.0, 30.0, 0.0, -15.0]], -RED_NOT_BLUE])
    path = ending(tmp_path / "m.onnx", scores, ARGMAX, out=TensorProto.INT64)
    classes = {"oyster": "target", "rock": "obstacle", "sand": "seabed"}
    model = LearnedLabels(path, sidecar=Sidecar.model_validate({"output": "classes", "classes": classes}))
    labels, _ = model.segment(np.kron(halves(), np.ones((3, 3, 1), np.uint8)))
    assert set(np.unique(labels)) == {Label.TARGET, Label.SEABED}


@pytest.mark.parametrize("count", [1, 2])
def test_masks_are_labels(tmp_path: Path, count: int) -> None:
    ends = node("Greater", ["scores", "nought"], ["out"])
    path = ending(
        tmp_path / "m.onnx", RED_OR_NOT[:count], ends, weights={"nought": np.zeros(1)}, out=TensorProto.BOOL
    )
    classes = dict(list(TWO["classes"].items())[:count])
    labels, confidence = seen(path, {"output": "classes", "classes": classes})
    assert is_right(labels)
    assert confidence.max() <= 0.5


def test_a_mask_of_0_and_255_is_one_class(tmp_path: Path) -> None:
    ends = (
        node("Greater", ["scores", "nought"], ["more"]),
        node("Where", ["more", "white", "nought"], ["picture"]),
        node("Cast", ["picture"], ["out"], to=TensorProto.UINT8),
    )
    weights = {"nought": np.zeros(1), "white": np.full(1, 255.0)}
    path = ending(tmp_path / "m.onnx", RED_NOT_BLUE, *ends, weights=weights, out=TensorProto.UINT8)
    assert is_right(seen(path, {**OYSTER, "output": "classes"})[0])


# ------------------------------------------------------------------------------- kinds of numbers


@pytest.mark.parametrize("kind", [TensorProto.FLOAT16, TensorProto.DOUBLE, TensorProto.UINT8])
@pytest.mark.parametrize("out", [TensorProto.FLOAT16, TensorProto.DOUBLE])
def test_other_kinds_of_numbers_go_in_and_come_out(tmp_path: Path, kind: int, out: int) -> None:
    scores = RED_OR_NOT.copy()
    if kind == TensorProto.UINT8:
        scores[:, :3] /= 255.0
    cast = node("Cast", ["scores"], ["out"], to=out)
    path = ending(tmp_path / "m.onnx", scores, cast, kind=kind, out=out)
    labels, confidence = seen(path, TWO)
    assert is_right(labels)
    assert confidence.min() > 0.99
    if kind == TensorProto.UINT8:
        with pytest.raises(ValueError, match="Leave out scale, mean and std"):
            seen(path, {**TWO, "scale": 0.5})


# --------------------------------------------------------------------- refused, with what to write


@pytest.mark.parametrize(
    ("scores", "ends", "sidecar", "write"),
    [
        (BOTH_RED, (SIGMOID,), TWO, 'Write "output": "probabilities", "exclusive": false'),
        (RED_OR_NOT, BY_HAND, {**TWO, "exclusive": False}, 'Write "output": "probabilities"'),
        (RED_NOT_BLUE, BY_HAND, OYSTER, 'Write "output": "probabilities"'),
        (RED_OR_NOT, (), {**TWO, "output": "probabilities"}, 'Write "output": "logits"'),
        (RED_NOT_BLUE, (), {**OYSTER, "output": "probabilities"}, 'Write "output": "logits"'),
        (BOTH_RED, (SIGMOID,), {**TWO, "output": "probabilities"}, 'Write "exclusive": false'),
        (RED_OR_NOT, (SOFTMAX,), {**TWO, "exclusive": False}, 'Write "exclusive": true'),
        (RED_NOT_BLUE, (SOFTMAX,), OYSTER, "a softmax over a single class says 1 of every pixel"),
        (RED_OR_NOT, (), {**TWO, "output": "classes"}, 'Write "output": "logits", or "probabilities"'),
        (RED_NOT_BLUE, (), TWO, "Write one class for each map"),
        (RED_OR_NOT, (), OYSTER, "Write one class for each map"),
        (FOUR, (ARGMAX,), {**TWO, "output": "classes"}, "Write a class for each number"),
    ],
)  # fmt: skip
def test_an_output_that_is_not_what_was_said_is_refused_with_what_to_write(
    tmp_path: Path, scores: np.ndarray, ends: tuple[onnx.NodeProto, ...], sidecar: dict[str, Any], write: str
) -> None:
    out = TensorProto.INT64 if ends == (ARGMAX,) else TensorProto.FLOAT
    path = ending(tmp_path / "m.onnx", scores, *ends, weights=WEIGHTS, out=out)
    with pytest.raises(ValueError, match=write) as refused:
        LearnedLabels(path, sidecar=Sidecar.model_validate(sidecar))
    assert len(str(refused.value)) < 400


# ---------------------------------------------------------------------------- what is not finite


def holed(path: Path, spoilt: np.ndarray, *ends: onnx.NodeProto, out: int = TensorProto.FLOAT) -> Path:
    """`RED_OR_NOT`, plus what is spoilt, (24, 32)."""
    both = (node("Add", ["scores", "spoilt"], ["out" if not ends else "sum"]), *ends)
    return ending(path, RED_OR_NOT, *both, weights={"spoilt": spoilt[None, None]}, out=out)


@pytest.mark.parametrize("number", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize(
    "ends", [(), (node("Softmax", ["sum"], ["out"], axis=1),)], ids=["scores", "softmax"]
)
def test_what_is_not_finite_costs_its_pixel(
    tmp_path: Path, number: float, ends: tuple[onnx.NodeProto, ...]
) -> None:
    spoilt = np.zeros((24, 32))
    spoilt[3, 4] = spoilt[20, 31] = number
    labels, confidence = seen(holed(tmp_path / "m.onnx", spoilt, *ends), TWO)
    lost = spoilt != 0.0
    assert (labels[lost] == Label.WATER).all()
    assert (confidence[lost] == 0.0).all()
    assert is_right(np.where(lost, seen(holed(tmp_path / "n.onnx", 0.0 * lost), TWO)[0], labels))
    assert confidence[~lost].min() > 0.99


def test_a_frame_of_which_most_is_not_finite_is_not_used(tmp_path: Path) -> None:
    spoilt = np.zeros((24, 32))
    spoilt[:13] = np.nan
    labels, confidence = seen(holed(tmp_path / "m.onnx", spoilt), TWO)
    assert (labels == Label.WATER).all()
    assert (confidence == 0.0).all()
    spoilt[10:13] = 0.0
    assert (seen(holed(tmp_path / "n.onnx", spoilt), TWO)[1][10:] > 0.99).all()


def test_an_instance_or_a_mask_that_is_not_finite_costs_what_it_covers(tmp_path: Path) -> None:
    masks = np.full((1, 16, 16), 8.0)
    masks[0, 2, 3] = np.inf
    there, holed_box, no_score = (16.0, 24.0, 0.9), (8.0, np.nan, 0.9), (8.0, 8.0, 7.0)
    rows = [(16.0, 32.0, *there, 1.0)] * 3 + [(48.0, 32.0, *holed_box, 1.0), (40.0, 32.0, *no_score, 1.0)]
    table = np.array(rows).T
    path = instances(tmp_path / "m.onnx", table, masks, {})
    sidecar = Sidecar.model_validate({"output": "instances", "classes": {"oyster": "target"}})
    labels, confidence = LearnedLabels(path, sidecar=sidecar).segment(np.zeros((64, 64, 3), np.uint8))
    assert labels[32, 16] == Label.TARGET
    assert (labels[:, 28:] == Label.SEABED).all()
    assert confidence[10, 14] == 0.0
    assert 16 <= (confidence == 0.0).sum() <= 64


@pytest.mark.parametrize("spoil", [lambda row: row * np.nan, lambda row: row + np.inf, lambda row: row - 3.0])
@pytest.mark.parametrize("masks_of", ["usual", "thinned"])
def test_instances_of_which_most_are_none_do_not_make_all_of_it_seabed(
    tmp_path: Path, spoil: Callable[[np.ndarray], np.ndarray], masks_of: str
) -> None:
    """A network without its sigmoid, or that overflows."""
    rows = np.array([[16.0, 32.0, 16.0, 24.0, 0.9, 1.0]] * 5)
    if masks_of == "thinned":
        rows = np.insert(rows, 5, 0.0, axis=1)
    rows[:4, 4] = spoil(rows[:4, 4])
    table = rows if masks_of == "thinned" else rows.T
    path = instances(tmp_path / "m.onnx", table, np.full((1, 16, 16), 8.0), {})
    sidecar = Sidecar.model_validate({"output": "instances", "classes": {"oyster": "target"}})
    with pytest.raises(ValueError, match="scores of 0 to 1, got mostly others"):
        LearnedLabels(path, sidecar=sidecar)


def test_the_same_answer_to_other_pictures_is_none(tmp_path: Path) -> None:
    """A network whose input is not what it is taken for, or that hangs on one result."""
    weights = {"nought": np.zeros(1), "value": np.random.default_rng(1).normal(size=(1, 2, 24, 32))}
    still = (node("Mul", ["scores", "nought"], ["nothing"]), node("Add", ["nothing", "value"], ["out"]))
    sidecar = Sidecar.model_validate(TWO)
    model = LearnedLabels(ending(tmp_path / "m.onnx", RED_OR_NOT, *still, weights=weights), sidecar=sidecar)
    pictures = [np.full((24, 32, 3), level, np.uint8) for level in range(5)]
    sure = [float(model.segment(rgb)[1].max()) for rgb in pictures]
    assert min(sure[:3]) > 0.5
    assert sure[3:] == [0.0, 0.0]
    # The same picture, and a view of nothing but one thing, may be answered the same for ever.
    well = LearnedLabels(ending(tmp_path / "n.onnx", RED_OR_NOT), sidecar=sidecar)
    assert all(well.segment(halves())[1].min() > 0.99 for _ in range(6))
    plain = LearnedLabels(ending(tmp_path / "o.onnx", 0.0 * RED_OR_NOT + [1, 0, 0, 0]), sidecar=sidecar)
    assert all(plain.segment(rgb)[1].min() >= 0.5 for rgb in pictures)


# ----------------------------------------------------------------------------------- names in the model

SWAPPED = {**OYSTER, "classes": {"fish": "water", "oyster": "target"}}


@pytest.mark.parametrize(
    "metadata",
    [
        {"names": "{0: 'oyster', 1: 'fish'}"},
        {"id2label": '{"0": "oyster", "1": "fish"}'},
        {"classes": '["oyster", "fish"]'},
        {"class_names": "oyster, fish"},
        {"labels": "oyster\nfish\n"},
    ],
)
def test_names_in_another_order_than_the_models_own_are_refused(
    tmp_path: Path, metadata: dict[str, str]
) -> None:
    path = ending(tmp_path / "m.onnx", RED_OR_NOT, metadata=metadata)
    with pytest.raises(ValueError, match=r"says \[fish, oyster\], .* say \[oyster, fish\]") as refused:
        seen(path, SWAPPED)
    assert 'write "classes": {"oyster": "target", "fish": "water"}' in str(refused.value)
    mended = {"oyster": "target", "fish": "water"}
    assert (seen(path, {**SWAPPED, "classes": mended})[0][:, :16] == Label.TARGET).all()
    # Who knows better says so.
    assert (seen(path, {**SWAPPED, "names_from": "sidecar"})[0][:, :16] == Label.WATER).all()


@pytest.mark.parametrize(
    "names",
    ["{0: 'shell', 1: 'fish'}", "['oyster', 'fish', 'net']", "{0: 'oyster'}", "fish, oyster", "oyster\nnet"],
)
def test_other_names_than_the_models_own_are_refused(names: str) -> None:
    sidecar = Sidecar.model_validate({**TWO, "classes": {"oyster": "target", "fish": "water"}})
    with pytest.raises(ValueError, match="the model's own 'names' say"):
        check_names(sidecar, {"names": names})


@pytest.mark.parametrize(
    "metadata",
    [
        {},
        {"names": "{0: 'Oyster', 1: 'open-water'}"},
        {"id2label": '{"0": "LABEL_0", "1": "LABEL_1"}'},
        {"names": "{0: 'class0', 1: 'class1'}"},
        {"names": "__import__('os').getcwd()"},
        {"labels": "what a reef shows"},
        {"labels": "see the paper, table 3"},
        {"classes": "two, in the order of the paper"},
        {"names": "[" * 10_000},
        {"names": "{0: 'oyster', 0: 'fish', 7: 'net'}"},
    ],
)
def test_names_that_say_the_same_or_nothing_are_no_reason(metadata: dict[str, str]) -> None:
    check_names(
        Sidecar.model_validate({**TWO, "classes": {"oyster": "target", "open_water": "water"}}), metadata
    )


def test_long_lists_of_names_make_short_messages() -> None:
    names = [f"species {n} " + "x" * 80 for n in range(900)]
    sidecar = Sidecar.model_validate({**TWO, "classes": dict.fromkeys(names, "seabed")})
    with pytest.raises(ValueError, match="900 in all") as refused:
        check_names(sidecar, {"names": json.dumps(names[::-1])})
    assert len(str(refused.value)) < 2000


def test_a_sidecar_that_names_a_class_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "m.json").write_text('{"output": "logits", "classes": {"a": "target", "a": "seabed"}}')
    with pytest.raises(ValueError, match="each name once, got 'a' twice"):
        read_sidecar(tmp_path / "m.json")


# ----------------------------------------------------------------------------------------------- fuzz


def test_whatever_comes_out_becomes_labels_or_is_refused_in_a_line(tmp_path: Path) -> None:
    rng = np.random.default_rng(39)
    shapes = ["", "LAST", "FLAT", "ARGMAX", "SIGMOID", "SOFTMAX", "GREATER", "HALF"]
    ends = {
        "LAST": LAST,
        "FLAT": node("Squeeze", ["scores"], ["out"]),
        "ARGMAX": ARGMAX,
        "SIGMOID": SIGMOID,
        "SOFTMAX": SOFTMAX,
        "GREATER": node("Greater", ["scores", "one"], ["out"]),
        "HALF": node("Cast", ["scores"], ["out"], to=TensorProto.FLOAT16),
    }
    outs = {"ARGMAX": TensorProto.INT64, "GREATER": TensorProto.BOOL, "HALF": TensorProto.FLOAT16}
    outputs = ["logits", "probabilities", "classes", "instances"]
    fits = {"SIGMOID": "probabilities", "ARGMAX": "classes", "GREATER": "classes"}
    names = ["oyster", "sand", "rock", "fish", "net"]
    words = ["target", "seabed", "obstacle", "water"]
    written = ["", "{0: 'oyster', 1: 'sand'}", '["sand", "oyster"]', "{", "0", "oyster,sand,rock", "\x00{}"]
    taken = 0
    for _ in range(80):
        shape = shapes[rng.integers(len(shapes))]
        scores = rng.normal(0.0, 10.0 ** rng.integers(-2, 6), (int(rng.integers(1, 5)), 4))
        if rng.random() < 0.3:
            scores[rng.integers(len(scores)), rng.integers(4)] = rng.choice([np.nan, np.inf, -np.inf])
        count = len(scores) if rng.random() < 0.8 else int(rng.integers(1, 6))
        said: dict[str, Any] = {
            "output": fits.get(shape, "logits") if rng.random() < 0.6 else outputs[rng.integers(4)],
            "classes": {name: words[rng.integers(4)] for name in names[:count]},
        }
        if rng.random() < 0.3:
            said["exclusive"] = False
        if rng.random() < 0.2:
            said["layout"] = "NHWC"
        text = json.dumps(said)
        if rng.random() < 0.1:
            text = text[: rng.integers(len(text))]
        (tmp_path / "m.json").write_text(text)
        path = ending(
            tmp_path / "m.onnx",
            scores,
            *([ends[shape]] if shape else []),
            weights={"one": np.ones(1)},
            out=outs.get(shape, TensorProto.FLOAT),
            metadata={"names": written[max(int(rng.integers(-20, len(written))), 0)]},
        )
        try:
            labels, confidence = LearnedLabels(path).segment(rng.integers(0, 256, (12, 16, 3), np.uint8))
        except ValueError as error:
            assert len(str(error)) < 1000 and "\n" not in str(error)  # noqa: PT017, PT018 - either is right
            continue
        taken += 1
        assert labels.shape == confidence.shape == (12, 16)
        assert labels.max() <= max(Label)
        assert ((confidence >= 0.0) & (confidence <= 1.0)).all()
        assert (labels[confidence == 0.0] == Label.WATER).all()
    assert 20 <= taken <= 60
