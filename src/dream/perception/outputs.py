"""What a label network's output means: scores, probabilities, numbers of classes or masks, to labels.

Exporters write all of these, in several shapes. Which one a model has is found out once, when it is opened,
from what its sidecar says, which operator comes last, and what it answers to a few test pictures. Where these
disagree, it is refused with what to write.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.perception.placing import Frame, nearest, resampled
from dream.perception.sidecar import Sidecar
from dream.types import BoolArray, Float32Array, Label, UInt8Array

HALF = 0.5
"""Probability from which a pixel belongs to a class that is told by itself."""
UNTOLD = 0.5
"""Confidence in an answer that does not say how sure it is."""
MOST_LOST = 0.5
"""Share of the pixels without a finite answer up to which the others are used."""
ROUGH = 0.02
"""By how much probabilities, and their sum, may be off: half precision, and resizing inside a model."""
IGNORED = 255
"""What many tools write for a pixel of no class."""
SIGMOIDS = ("Sigmoid", "HardSigmoid")
LINEAR = ("Conv", "ConvTranspose", "Gemm", "MatMul", "Add", "BatchNormalization")
"""Operators whose results are scores even where those of all test pictures lie between 0 and 1."""

Numbers = npt.NDArray[Any]
Answer = tuple[UInt8Array, Float32Array, BoolArray]
"""(H, W) labels; (H, W) confidence, 0 where there is no answer; (H, W) whether it is of a class at all."""


class Form(enum.Enum):
    """Of an output."""

    SCORES = enum.auto()
    """Of classes that exclude each other: they need a softmax."""
    SHARES = enum.auto()
    """The same after it."""
    SINGLE_SCORES = enum.auto()
    """Of classes each by itself: they need a sigmoid."""
    SINGLE_SHARES = enum.auto()
    """The same after it."""
    NUMBERS = enum.auto()
    """(H, W) of the likeliest classes; of a single class, anything but 0."""
    MASKS = enum.auto()
    """A map for each class, anything but 0 where a pixel is of it."""


def form_of(sidecar: Sidecar, operator: str, answers: Sequence[Numbers]) -> Form:
    """What a model puts out.

    Args:
        sidecar: What is said of it.
        operator: The one that comes last; see `Network.operator`.
        answers: To some test pictures.

    Raises:
        ValueError: It is not what the sidecar says; the message has what to write.
    """
    count, whole = len(sidecar.classes), answers[0].dtype.kind in "biu"
    if sidecar.output == "classes":
        return _form_of_classes(sidecar, answers)
    if whole or operator == "ArgMax":
        raise ValueError(
            f"output: expected {sidecar.output}, got whole numbers of {answers[0].dtype}. "
            'Write "output": "classes"'
        )
    maps = [class_maps(answer, sidecar) for answer in answers]
    finite = np.concatenate([one[:, np.isfinite(one).all(axis=0)] for one in maps], axis=1)
    if finite.size == 0:
        raise ValueError("output: expected finite numbers, got none for any of the test pictures")
    low, high = float(finite.min()), float(finite.max())
    sums = finite.sum(axis=0)
    shares = low >= -ROUGH and high <= 1.0 + ROUGH
    add_up = shares and bool((np.abs(sums - 1.0) <= ROUGH).all())
    exclusive = sidecar.exclusive and count > 1
    if operator == "Softmax" and not exclusive:
        if count == 1:
            raise ValueError(
                "output: a softmax over a single class says 1 of every pixel. Export the model with a "
                "sigmoid in its place, or with none"
            )
        raise ValueError(
            "exclusive: the model ends in a softmax, so that its classes exclude each other. "
            'Write "exclusive": true'
        )
    if sidecar.output == "probabilities":
        if not shares:
            raise ValueError(
                f'output: expected probabilities, got {low:.3g} to {high:.3g}. Write "output": "logits"'
            )
        if exclusive and not add_up:
            raise ValueError(
                f"output: expected probabilities that add up to 1, got sums of {sums.min():.3g} to "
                f'{sums.max():.3g}. Write "exclusive": false where each class has a sigmoid of its own'
            )
        return Form.SHARES if exclusive else Form.SINGLE_SHARES
    if exclusive and (operator == "Softmax" or add_up):
        # A second softmax would let the number of classes decide.
        return Form.SHARES
    if not exclusive and operator in SIGMOIDS:
        return Form.SINGLE_SHARES
    if operator in SIGMOIDS or (shares and operator not in LINEAR):
        also = ', "exclusive": false' if exclusive else ""
        raise ValueError(
            f"output: expected logits, got {low:.3g} to {high:.3g} from {operator or 'the model'}, as of "
            f'sigmoids. Write "output": "probabilities"{also}'
        )
    return Form.SCORES if exclusive else Form.SINGLE_SCORES


def _form_of_classes(sidecar: Sidecar, answers: Sequence[Numbers]) -> Form:
    count = len(sidecar.classes)
    for answer in answers:
        finite = answer[np.isfinite(answer)] if answer.dtype.kind == "f" else answer
        if answer.dtype.kind == "f" and not (finite == np.rint(finite)).all():
            raise ValueError(
                f'output: expected whole numbers of classes, got others in {answer.shape}. Write "output": '
                '"logits", or "probabilities" where softmax or sigmoid is inside'
            )
    squeezed = [side for side in answers[0].shape if side != 1]
    if len(squeezed) != 2:
        for answer in answers:
            class_maps(answer, sidecar)
        return Form.MASKS
    if count > 1:
        known = np.unique(np.concatenate([np.unique(answer[np.isfinite(answer)]) for answer in answers]))
        wrong = known[((known < 0) | (known >= count)) & (known != IGNORED)]
        if len(wrong):
            raise ValueError(
                f"classes: expected numbers 0 to {count - 1}, for {count} classes, got {wrong[0]:g}. Write a "
                "class for each number that the model has"
            )
    return Form.NUMBERS


def class_maps(answer: Numbers, sidecar: Sidecar) -> Float32Array:
    """(C, h, w) float32: an output with a map for each class, whichever way round it comes.

    Raises:
        ValueError: It has no such shape.
    """
    count, maps = len(sidecar.classes), answer
    if maps.ndim == 4 and len(maps) == 1:
        maps = maps[0]
    elif maps.ndim == 2 and count == 1:
        maps = maps[None]
    first = sidecar.layout == "NCHW"
    if maps.ndim == 3 and maps.size:
        for axis in (0, 2) if first else (2, 0):
            if maps.shape[axis] == count:
                with np.errstate(over="ignore"):
                    return np.ascontiguousarray(np.moveaxis(maps, axis, 0), np.float32)
    expected = f"(1, {count}, h, w)" if first else f"(1, h, w, {count})"
    raise ValueError(
        f"{sidecar.output}: expected {expected}, a score for each class, got {answer.shape}. "
        'Write one class for each map into "classes", in the model\'s order; what is of none needs no class'
    )


def labelled(answer: Numbers, form: Form, sidecar: Sidecar, frame: Frame, shape: tuple[int, ...]) -> Answer:
    """Labels of a picture's pixels.

    Classes with the same label stand together: their probabilities add up where they exclude each other, and
    the greatest counts where they do not. A pixel without finite numbers is water, with a confidence of 0; so
    are all where most of them are such.

    Args:
        answer: Of the network.
        form: See `form_of`.
        sidecar: Names the classes.
        frame: Where the picture lies in the network's input.
        shape: (H, W, ...) of the picture.

    Raises:
        ValueError: The output has another shape than before.
    """
    of_class = np.array(sidecar.labels, np.uint8)
    if form is Form.NUMBERS:
        labels, confidence, found, lost = _from_numbers(answer, of_class, frame, shape)
    elif form is Form.MASKS:
        maps = class_maps(answer, sidecar)
        maps = np.where(np.isfinite(maps), maps != 0.0, np.nan).astype(np.float32)
        labels, confidence, found, lost = _from_shares(nearest(maps, frame, shape), of_class)
        confidence = np.minimum(confidence, np.float32(UNTOLD))
    else:
        fine = resampled(class_maps(answer, sidecar), frame, shape)
        labels, confidence, found, lost = _from_fine(fine, form, of_class)
    return unbelieved(labels, confidence, found, lost)


def unbelieved(
    labels: npt.NDArray[Any], confidence: Float32Array, found: BoolArray, lost: BoolArray
) -> Answer:
    """An answer without its lost pixels; without any where most are lost."""
    if lost.mean() > MOST_LOST:
        lost = np.ones_like(lost)
    return (
        np.where(lost, int(Label.WATER), labels).astype(np.uint8),
        np.where(lost, 0.0, np.clip(confidence, 0.0, 1.0)).astype(np.float32),
        # Nobody else is asked what a lost pixel shows.
        found | lost,
    )


def _from_fine(
    fine: Float32Array, form: Form, of_class: UInt8Array
) -> tuple[UInt8Array, Float32Array, BoolArray, BoolArray]:
    lost: BoolArray = np.asarray(~np.isfinite(fine).all(axis=0))
    fine = np.where(lost, np.float32(0.0), fine)
    if form in (Form.SHARES, Form.SINGLE_SHARES):
        lost |= (fine < -ROUGH).any(axis=0) | (fine > 1.0 + ROUGH).any(axis=0)
        fine = np.clip(fine, 0.0, 1.0)
    if form is Form.SCORES:
        odds = np.exp(fine - fine.max(axis=0))
        fine = odds / odds.sum(axis=0)
    elif form is Form.SINGLE_SCORES:
        fine = (1.0 / (1.0 + np.exp(-np.clip(fine, -60.0, 60.0)))).astype(np.float32)
    if form in (Form.SINGLE_SCORES, Form.SINGLE_SHARES):
        fine[:, lost] = np.nan
        return _from_shares(fine, of_class)
    by_label = np.stack([fine[of_class == label].sum(axis=0) for label in Label])
    best = by_label.argmax(axis=0).astype(np.uint8)
    confidence: Float32Array = by_label.max(axis=0)
    return best, confidence, np.ones(best.shape, np.bool_), lost


def _from_shares(
    fine: Float32Array, of_class: UInt8Array
) -> tuple[UInt8Array, Float32Array, BoolArray, BoolArray]:
    """From probabilities of classes each by itself, NaN where they are lost."""
    lost: BoolArray = np.asarray(np.isnan(fine).any(axis=0))
    fine = np.where(lost, np.float32(0.0), fine)
    by_label = np.stack([fine[of_class == label].max(axis=0, initial=0.0) for label in Label])
    score: Float32Array = by_label.max(axis=0)
    found: BoolArray = np.asarray(score >= HALF)
    labels = np.where(found, by_label.argmax(axis=0), int(Label.SEABED)).astype(np.uint8)
    # Labels that are both likely leave it open which of them is right.
    confidence = np.where(found, score / np.maximum(by_label.sum(axis=0), 1.0), 1.0 - score)
    return labels, confidence.astype(np.float32), found, lost


def _from_numbers(
    answer: Numbers, of_class: UInt8Array, frame: Frame, shape: tuple[int, ...]
) -> tuple[UInt8Array, Float32Array, BoolArray, BoolArray]:
    sides = [side for side in answer.shape if side != 1]
    if len(sides) != 2:
        raise ValueError(f"classes: expected a number a pixel, (h, w), got {answer.shape}")
    with np.errstate(over="ignore"):
        numbers = nearest(answer.reshape(1, *sides).astype(np.float32), frame, shape)[0]
    count = len(of_class)
    lost = ~np.isfinite(numbers)
    if count == 1:
        found = ~lost & (numbers != 0.0)
        labels = np.where(found, of_class[0], int(Label.SEABED)).astype(np.uint8)
    else:
        lost |= (numbers < 0.0) | (numbers >= count)
        found = ~lost
        labels = of_class[np.where(lost, 0.0, numbers).astype(np.intp)]
    return labels, np.full(numbers.shape, UNTOLD, np.float32), found, lost
