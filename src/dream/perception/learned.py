"""Labels and depth from networks that others trained."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dream.perception.depth import FEWEST, Segmenter
from dream.perception.flat_floor import floor_depth, rays
from dream.perception.onnx import Network, input_side
from dream.perception.outputs import HALF, MOST_LOST, ROUGH, UNTOLD, Answer, form_of, labelled, unbelieved
from dream.perception.placing import Frame, picture, placed, resampled
from dream.perception.repeats import Repeats
from dream.perception.scaling import Fit, fit_to_floor, judged
from dream.perception.sidecar import (
    LABELLING,
    Sidecar,
    check_names,
    read_sidecar,
    sidecar_beside,
    ultralytics,
)
from dream.perception.view import View
from dream.protocol import farthest_return
from dream.types import Float32Array, Label, UInt8Array

MOST_INSTANCES = 100
"""The best of a picture."""
LEAST_AGREEMENT = 0.1
"""Share of the floor's pixels on which network and floor have to agree, or the network is not believed."""


def _opened(
    path: str | Path, sidecar: Sidecar | None, classes: Mapping[str, str] | None, threads: int
) -> tuple[Network, Sidecar, tuple[int, int]]:
    network = Network(path, threads=threads)
    if sidecar is None:
        beside = sidecar_beside(path)
        sidecar = read_sidecar(beside) if beside else ultralytics(network.metadata, classes)
    shape = network.input_shape
    channels, height, width = shape[1:] if sidecar.layout == "NCHW" else (shape[3], shape[1], shape[2])
    if channels not in (3, None):
        other = "NHWC" if sidecar.layout == "NCHW" else "NCHW"
        turned = f'. Write "layout": "{other}"' if shape[3 if other == "NHWC" else 1] == 3 else ""
        raise ValueError(f"model: expected 3 channels in {sidecar.layout}, got an input of {shape}{turned}")
    if network.kind == np.uint8 and sidecar.model_fields_set & {"scale", "mean", "std"}:
        raise ValueError("scale: the model takes the bytes of a picture. Leave out scale, mean and std")
    size = input_side(height, sidecar.height, "height"), input_side(width, sidecar.width, "width")
    if sidecar.name is not None and sidecar.name not in network.outputs:
        raise ValueError(f"name: expected one of {', '.join(network.outputs)[:200]}, got {sidecar.name!r}")
    check_names(sidecar, network.metadata)
    return network, sidecar, size


class LearnedLabels:
    """Labels from a network in an ONNX file.

    What it does: scores of classes per pixel go through a softmax, or through a sigmoid where each class is
    told by itself, unless that is in the model already; the best class gives label and confidence. Numbers of
    classes and masks give labels, with a confidence of a half. Instances, as Ultralytics exports them, are
    drawn from their boxes and masks, no matter whether they overlap. What belongs to none of the classes is
    left to another segmenter. Where the output is not finite, or the same for one picture after the other,
    there is no answer: water, with a confidence of 0.

    Assumes: the network was trained on pictures such as these. Its scores are taken for probabilities.

    Fails when: it knows nothing of walls and pipes, and no other segmenter does: those are then seabed.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        sidecar: Sidecar | None = None,
        classes: Mapping[str, str] | None = None,
        under: Segmenter | None = None,
        threads: int = 1,
    ) -> None:
        """Open a model.

        Args:
            path: Of the .onnx file.
            sidecar: What the model is like; else from `model.json` or `model.toml` beside it, else from the
                metadata that Ultralytics writes.
            classes: For the latter, label name by class name.
            under: Tells what pixels are that belong to no instance; seabed without.
            threads: Of the CPU.

        Raises:
            ValueError: The model or its sidecar is refused, or the two do not fit.
        """
        self._network, self._sidecar, self._size = _opened(path, sidecar, classes, threads)
        if self._sidecar.output not in LABELLING:
            raise ValueError(
                f"output: expected {', '.join(LABELLING)} for labels, got {self._sidecar.output}"
            )
        self._under, self._repeats = under, Repeats()
        self._labels = np.array(self._sidecar.labels, np.uint8)
        self._try()
        # What was shown for a test says nothing of what a camera will show.
        self._repeats = Repeats()

    def _try(self) -> None:
        """Show it the test pictures: is the output what the sidecar says?"""
        tests = _test_pictures(*self._size)
        if self._sidecar.output == "instances":
            _, confidence, _ = self._from_instances(
                self._answers(tests[0])[0], self._frame(tests[0]), tests[0].shape
            )
            if not confidence.any():
                raise ValueError(
                    "instances: expected finite numbers, and scores of 0 to 1, got mostly others. "
                    "Export the model with its sigmoid inside"
                )
            return
        (name,) = self._names
        answers = [answer for rgb in tests for answer in self._answers(rgb)[0]]
        self._form = form_of(self._sidecar, self._network.operator(name), answers)

    def segment(self, rgb: UInt8Array, view: View | None = None) -> tuple[UInt8Array, Float32Array]:
        """See `Segmenter.segment`.

        Raises:
            ValueError: The network's answer is not what it should be.
        """
        labels, confidence, found = self._own(rgb)
        if self._under is None or found.all():
            return labels, confidence
        below, sure = self._under.segment(rgb, view)
        return np.where(found, labels, below), np.where(found, confidence, np.minimum(sure, confidence))

    @property
    def _names(self) -> list[str]:
        """Of the outputs that are asked for."""
        if self._sidecar.output == "instances":
            return list(self._network.outputs)
        return [self._sidecar.name or next(iter(self._network.outputs))]

    def _frame(self, rgb: UInt8Array) -> Frame:
        return placed(rgb.shape, *self._size, letterbox=self._sidecar.letterbox)

    def _answers(self, rgb: UInt8Array) -> tuple[list[npt.NDArray[Any]], bool]:
        """What the network answers, and whether that is what it answers to other pictures."""
        x = picture(rgb, self._frame(rgb), self._sidecar, self._network.kind)
        answers = self._network.run(x, self._names)
        return answers, self._repeats.told(x, answers[0])

    def _own(self, rgb: UInt8Array) -> Answer:
        (answers, repeats), frame = self._answers(rgb), self._frame(rgb)
        if self._sidecar.output == "instances":
            labels, confidence, found = self._from_instances(answers, frame, rgb.shape)
        else:
            labels, confidence, found = labelled(answers[0], self._form, self._sidecar, frame, rgb.shape)
        if repeats:
            return unbelieved(labels, confidence, found, np.ones_like(found))
        return labels, confidence, found

    def _from_instances(
        self, answers: list[npt.NDArray[Any]], frame: Frame, shape: tuple[int, ...]
    ) -> Answer:
        boxes, scores, kinds, weights, masks = _instances(answers, len(self._labels))
        lost = ~np.isfinite(masks).all(axis=0)
        masks = np.where(lost, np.float32(0.0), masks)
        best = np.argsort(-scores)[:MOST_INSTANCES]
        best = best[scores[best] >= self._sidecar.least_score]
        by_label = np.zeros((len(Label), *masks.shape[1:]), np.float32)
        rows = (np.arange(masks.shape[1]) + 0.5) * frame.height / masks.shape[1]
        cols = (np.arange(masks.shape[2]) + 0.5) * frame.width / masks.shape[2]
        for n in best:
            shown = np.clip(np.tensordot(weights[n], masks, 1), -60.0, 60.0)
            x0, y0, x1, y1 = boxes[n]
            inside = ((rows >= y0) & (rows <= y1))[:, None] & ((cols >= x0) & (cols <= x1))[None, :]
            likely = np.where(inside, 1.0 / (1.0 + np.exp(-shown)), 0.0)
            label = by_label[self._labels[kinds[n]]]
            np.maximum(label, np.where(likely >= HALF, scores[n] * likely, 0.0), out=label)
        by_label[:, lost] = np.nan
        fine = resampled(by_label, frame, shape)
        lost = np.asarray(np.isnan(fine).any(axis=0))
        winner, score = fine.argmax(axis=0), np.where(lost, np.float32(0.0), fine.max(axis=0))
        found = score >= HALF * self._sidecar.least_score
        labels = np.where(found, winner, int(Label.SEABED)).astype(np.uint8)
        confidence = np.where(found, score, 1.0 - score)
        return unbelieved(labels, confidence, found, lost)


def _instances(
    answers: list[npt.NDArray[Any]], classes: int
) -> tuple[Float32Array, Float32Array, npt.NDArray[np.intp], Float32Array, Float32Array]:
    """Boxes (N, 4) as x0, y0, x1, y1 in the input, scores, classes, mask weights (N, m) and masks (m, h, w).

    An instance of which a number is not finite, or the score no probability, is left out; where most are
    such, the masks are not finite either, as some of them may be by themselves.

    Two layouts are in use: (1, 4 + classes + m, N) with middle and size of a box and a score for each class,
    and (1, N, 6 + m) with corners, score and class, where the network has thinned them out itself.
    """
    flat = [answer for answer in answers if answer.ndim == 3]
    prototypes = [answer for answer in answers if answer.ndim == 4]
    if len(flat) != 1 or len(prototypes) != 1 or len(flat[0]) != 1 or len(prototypes[0]) != 1:
        raise ValueError(
            "instances: expected boxes in 3 and masks in 4 dimensions, of one picture, got "
            + ", ".join(str(answer.shape) for answer in answers)
        )
    with np.errstate(over="ignore"):
        masks, table = (part[0].astype(np.float32) for part in (prototypes[0], flat[0]))
    count = len(masks)
    if masks.size == 0:
        raise ValueError(f"instances: expected prototype masks, got {prototypes[0].shape}")
    if table.shape[0] == 4 + classes + count:
        rows = table.T
        middle, size = rows[:, :2], rows[:, 2:4]
        boxes = np.concatenate([middle - 0.5 * size, middle + 0.5 * size], axis=1)
        each = rows[:, 4 : 4 + classes]
        kinds, weights = each.argmax(axis=1), rows[:, 4 + classes :]
        scores = each[np.arange(len(each)), kinds]
    elif table.shape[1] == 6 + count:
        rows = table
        boxes, scores, weights = table[:, :4], table[:, 4], table[:, 6:]
        numbers = np.where(np.isfinite(table[:, 5]), table[:, 5], 0.0)
        kinds = np.rint(numbers).astype(np.intp)
        if len(kinds) and not (kinds.min() >= 0 and kinds.max() < classes):
            raise ValueError(
                f"instances: expected classes 0 to {classes - 1}, got {kinds.min()} to {kinds.max()}. "
                'Write a class for each into "classes"'
            )
    else:
        raise ValueError(
            f"instances: expected (1, {4 + classes + count}, N) or (1, N, {6 + count}) for {classes} classes "
            f"and {count} masks, got {flat[0].shape}"
        )
    good = np.isfinite(rows).all(axis=1) & (scores >= 0.0) & (scores <= 1.0 + ROUGH)
    if len(good) and 1.0 - good.mean() > MOST_LOST:
        masks[:] = np.nan
    return boxes[good], np.minimum(scores[good], 1.0), kinds[good], weights[good], masks


def _test_pictures(height: int, width: int) -> list[UInt8Array]:
    """Black, white and noise, (H, W, 3): what they are answered shows what an output is."""
    shape = height, width, 3
    noise = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    return [np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8), noise]


class LearnedDepth:
    """Depth from a network in an ONNX file, in metres by the flat floor.

    What it does: a relative depth gets its scale, and a relative inverse depth its scale and shift, from the
    pixels that are labelled seabed or target, whose depth altitude and attitude tell. A metric depth stays as
    it is. The confidence is the share of those pixels on which network and floor agree to a tenth: 0 where
    that is less than `LEAST_AGREEMENT`, as floor and network then contradict each other, and where the
    network has answered the same for one picture after the other. Pixels without a finite answer have no
    depth.

    Reference: the affine invariance of inverse depth is that of MiDaS (Ranftl et al., *TPAMI*, 2022).

    Assumes: a flat floor in view.

    Fails when: too little floor is seen: then there is no depth, but for a metric one, of which nothing
    vouches, with a confidence of a half.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        sidecar: Sidecar | None = None,
        max_depth: float = 20.0,
        threads: int = 1,
    ) -> None:
        """Open a model.

        Args:
            path: Of the .onnx file.
            sidecar: What the model is like; else from `model.json` or `model.toml` beside it.
            max_depth: Metres along the optical axis; nothing farther is claimed.
            threads: Of the CPU.

        Raises:
            ValueError: The model or its sidecar is refused, or the two do not fit.
        """
        self._network, self._sidecar, self._size = _opened(path, sidecar, None, threads)
        if not self._sidecar.output.endswith("_depth"):
            raise ValueError(f"output: expected a depth, got {self._sidecar.output}")
        self._max_depth, self._repeats = max_depth, Repeats()
        self._raw(np.zeros((16, 16, 3), np.uint8))
        self._repeats = Repeats()

    def estimate(self, rgb: UInt8Array, labels: UInt8Array, view: View) -> tuple[Float32Array, Float32Array]:
        """See `DepthModel.estimate`.

        Raises:
            ValueError: The network's answer is not what it should be.
        """
        view.camera.check(rgb, "rgb")
        view.camera.check(labels, "labels")
        raw, repeats = self._raw(rgb)
        floor = floor_depth(rays(view), self._max_depth)
        on_floor = ((labels == Label.SEABED) | (labels == Label.TARGET)) & np.isfinite(floor)
        fit: Fit | None
        if self._sidecar.output == "metric_depth":
            fit = judged(Fit(1.0, 0.0, False, 0.0, 0.0), raw, floor, on_floor)
        else:
            fit = fit_to_floor(raw, floor, on_floor, inverse=self._sidecar.output == "inverse_depth")
        if fit is None:
            return np.full(raw.shape, np.nan, np.float32), np.zeros(raw.shape, np.float32)
        depth = fit.depth(raw)
        known = (depth <= farthest_return(self._max_depth)) & (labels != Label.WATER)
        confidence = fit.agreement if np.count_nonzero(on_floor) >= FEWEST else UNTOLD
        if confidence < LEAST_AGREEMENT or repeats:
            confidence = 0.0
        return (
            np.where(known, depth, np.float32(np.nan)),
            np.where(known, np.float32(confidence), np.float32(0.0)),
        )

    def _raw(self, rgb: UInt8Array) -> tuple[Float32Array, bool]:
        """(H, W) what the network answers, and whether that is what it answers to other pictures."""
        frame = placed(rgb.shape, *self._size, letterbox=self._sidecar.letterbox)
        name = self._sidecar.name or next(iter(self._network.outputs))
        x = picture(rgb, frame, self._sidecar, self._network.kind)
        (answer,) = self._network.run(x, [name])
        maps = np.squeeze(answer)
        if maps.ndim != 2 or min(maps.shape) < 2 or maps.dtype.kind == "b":
            raise ValueError(f"depth: expected one number a pixel, got {answer.shape} of {answer.dtype}")
        with np.errstate(over="ignore"):
            maps = maps.astype(np.float32)
        raw: Float32Array = resampled(maps[None], frame, rgb.shape)[0]
        finite = np.isfinite(raw)
        # A frame of which most is not finite shows nothing.
        kept = np.where(finite & (finite.mean() >= MOST_LOST), raw, np.float32(np.nan))
        return kept, self._repeats.told(x, answer)
