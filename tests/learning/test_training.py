"""The student: it learns, the same again for the same seed, and its file says what it says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from dream.learning.export import INPUT, OUTPUT, answers_in, as_onnx, check  # noqa: E402
from dream.learning.network import MOST_PARAMETERS, Network  # noqa: E402
from dream.learning.training import Training, answers_of, device_named, fit  # noqa: E402
from dream.planning.baselines.uivnav import opened  # noqa: E402
from dream.types import Float32Array, UInt8Array  # noqa: E402

SMALL = Network(channels=(4, 8, 8, 8), hidden=16, dropout=0.1)
LEFT_60, RIGHT_60 = 5, 1


def stripes(count: int, seed: int = 0) -> tuple[UInt8Array, Float32Array]:
    """Pictures with a bright stripe in their left half only, and the turn towards it."""
    rng = np.random.default_rng(seed)
    images = rng.integers(0, 60, (count, 2, 72, 96), np.uint8)
    for k, at in enumerate(rng.integers(4, 36, count)):
        images[k, 1, :, at : at + 8] = 250
    odds = np.zeros((count, 7), np.float32)
    odds[:, LEFT_60] = 1.0
    return images, odds


@pytest.fixture(scope="module")
def student() -> Any:
    made = SMALL.build(0)
    images, odds = stripes(128)
    for _ in fit(made, images, odds, Training(epochs=5, batch=16, rate=5e-3)):
        pass
    return made


def weights(student: Any) -> list[Any]:
    return [tensor.numpy().copy() for tensor in student.state_dict().values()]


def test_it_has_as_many_parameters_as_it_says() -> None:
    for network in (SMALL, Network()):
        assert sum(p.numel() for p in network.build(0).parameters()) == network.parameters < MOST_PARAMETERS


def test_it_learns_a_trivial_world_and_its_mirror_image(student: Any) -> None:
    images, _ = stripes(32, seed=1)
    assert (answers_of(student, images).argmax(axis=1) == LEFT_60).all()
    # No stripe was ever on the right but in a mirrored picture.
    assert (answers_of(student, images[..., ::-1].copy()).argmax(axis=1) == RIGHT_60).all()


def test_the_same_seed_gives_the_same_student_and_another_one_another() -> None:
    images, odds = stripes(32)

    def taught(seed: int) -> list[Any]:
        made = SMALL.build(seed)
        list(fit(made, images, odds, Training(epochs=1, batch=16, seed=seed)))
        return weights(made)

    first, again, other = taught(0), taught(0), taught(1)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(first, other, strict=True))


def test_training_that_is_broken_off_ends_as_if_it_never_was(tmp_path: Path) -> None:
    images, odds = stripes(48)
    training = Training(epochs=3, batch=16)
    whole = SMALL.build(0)
    list(fit(whole, images, odds, training))

    kept = tmp_path / "student.pt"
    begun = SMALL.build(0)
    assert next(fit(begun, images, odds, training, kept=kept)).number == 1
    resumed = SMALL.build(7)
    assert [epoch.number for epoch in fit(resumed, images, odds, training, kept=kept)] == [2, 3]
    for a, b in zip(weights(whole), weights(resumed), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-7)


def test_a_damaged_state_is_told_of_and_not_gone_on_from(tmp_path: Path) -> None:
    images, odds = stripes(32)
    kept = tmp_path / "student.pt"
    next(fit(SMALL.build(0), images, odds, Training(batch=16), kept=kept))
    whole = kept.read_bytes()
    for damaged in (b"", whole[:1000], b"nonsense"):
        kept.write_bytes(damaged)
        with pytest.raises(ValueError, match=r"student\.pt: expected the state .* Delete it"):
            next(fit(SMALL.build(0), images, odds, Training(batch=16), kept=kept))


def test_training_leaves_the_dice_of_others_alone() -> None:
    images, odds = stripes(32)
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    list(fit(SMALL.build(0), images, odds, Training(epochs=1, batch=16)))
    assert torch.equal(torch.rand(3), expected)


def test_the_file_says_what_pytorch_says(student: Any) -> None:
    model = as_onnx(student)
    assert check(model, student) <= 1e-5
    images = np.random.default_rng(3).random((5, 2, 72, 96), np.float32)
    with torch.inference_mode():
        x = torch.from_numpy(images)
        expected = 0.5 * (student(x) + student(x.flip(3)).flip(1)).numpy()
    np.testing.assert_allclose(answers_in(model, images), expected, atol=1e-5)
    np.testing.assert_allclose(answers_in(model, images[:1]), expected[:1], atol=1e-5)


def test_the_mirror_image_gets_the_mirrored_answer_from_the_file(student: Any) -> None:
    model = as_onnx(student)
    images = np.random.default_rng(4).random((4, 2, 72, 96), np.float32)
    crossed = answers_in(model, np.ascontiguousarray(images[..., ::-1]))
    np.testing.assert_allclose(crossed[:, ::-1], answers_in(model, images), atol=1e-6)


def test_the_file_is_the_same_again_and_names_no_place(student: Any) -> None:
    model = as_onnx(student)
    assert as_onnx(student) == model
    assert not any(word in model for word in (b"/home", b"/usr", b"site-packages", b".py"))
    graph = onnx.load_from_string(model).graph
    assert [value.name for value in graph.input] == [INPUT]
    assert [value.name for value in graph.output] == [OUTPUT]


def test_the_planner_takes_the_file(student: Any, tmp_path: Path) -> None:
    path = tmp_path / "own.onnx"
    path.write_bytes(as_onnx(student))
    picture = stripes(1, seed=9)[0][0]
    assert opened(str(path)).logits(picture).argmax() == LEFT_60


def test_a_file_that_says_otherwise_is_refused(student: Any) -> None:
    other = SMALL.build(1).eval()
    with pytest.raises(ValueError, match="expected the answers of PyTorch"):
        check(as_onnx(other), student)


def test_what_cannot_be_exported_is_refused() -> None:
    with pytest.raises(ValueError, match=r"Network\.build, got Tanh"):
        as_onnx(torch.nn.Sequential(torch.nn.Tanh()))


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: Network(channels=()),
        lambda: Network(hidden=0),
        lambda: Network(channels=(64, 128, 256, 256)),
        lambda: Network(dropout=1.0),
        lambda: Training(epochs=0),
        lambda: Training(rate=0.0),
        lambda: Training(seed=-1),
        lambda: Training(smoothing=1.0),
        lambda: next(fit(SMALL.build(0), *stripes(1), Training())),
        lambda: device_named("abacus"),
    ],
)
def test_wrong_parameters_are_refused(wrong: Any) -> None:
    with pytest.raises(ValueError, match="expected"):
        wrong()
