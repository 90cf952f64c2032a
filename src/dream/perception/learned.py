"""Labels and depth from networks that others trained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dream.geometry import SE3, Camera
from dream.perception.depth import Segmenter
from dream.perception.flat_floor import floor_depth, rays
from dream.perception.onnx import Network, input_side
from dream.perception.scaling import Fit, fit_to_floor, judged
from dream.perception.sidecar import Sidecar, read_sidecar, sidecar_beside, ultralytics
from dream.types import Float32Array, Label, UInt8Array

GREY = 114
"""Around a picture that keeps its proportions; what Ultralytics trains with."""
MOST_INSTANCES = 100
"""The best of a picture."""
HALF = 0.5
"""Probability from which a pixel belongs to an instance."""


@dataclass(frozen=True, slots=True)
class Frame:
    """Where a picture lies in a network's input."""

    height: int
    width: int
    rows: tuple[float, float]
    """First row and number of rows, in pixels of the input."""
    cols: tuple[float, float]


def placed(shape: tuple[int, ...], height: int, width: int, *, letterbox: bool) -> Frame:
    """A picture of (H, W) in an input of that size: stretched, or in its middle with its proportions."""
    if not letterbox:
        return Frame(height, width, (0.0, float(height)), (0.0, float(width)))
    factor = min(height / shape[0], width / shape[1])
    rows, cols = round(shape[0] * factor), round(shape[1] * factor)
    return Frame(height, width, (float((height - rows) // 2), rows), (float((width - cols) // 2), cols))


def picture(rgb: UInt8Array, frame: Frame, sidecar: Sidecar) -> Float32Array:
    """(1, 3, h, w), or (1, h, w, 3): a picture as the network wants it."""
    from PIL import Image

    size = (round(frame.cols[1]), round(frame.rows[1]))
    small = np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BILINEAR))
    whole = np.full((frame.height, frame.width, 3), GREY, np.uint8)
    row, col = int(frame.rows[0]), int(frame.cols[0])
    whole[row : row + size[1], col : col + size[0]] = small
    if sidecar.colours == "BGR":
        whole = whole[..., ::-1]
    x = (whole * np.float32(sidecar.scale) - np.array(sidecar.mean, np.float32)) / np.array(
        sidecar.std, np.float32
    )
    if sidecar.layout == "NCHW":
        x = x.transpose(2, 0, 1)
    return np.ascontiguousarray(x[None], np.float32)


def resampled(maps: Float32Array, frame: Frame, shape: tuple[int, ...]) -> Float32Array:
    """(C, H, W): maps (C, h, w) over the whole input, bilinear at the picture's own pixels."""
    out = maps
    for axis, (side, (first, length), count) in enumerate(
        zip((frame.height, frame.width), (frame.rows, frame.cols), shape[:2], strict=True), 1
    ):
        cells = maps.shape[axis]
        at = (first + (np.arange(count) + 0.5) * length / count) * cells / side - 0.5
        at = np.clip(at, 0.0, cells - 1.0)
        low = np.minimum(at.astype(np.intp), max(cells - 2, 0))
        share = (at - low).astype(np.float32).reshape((-1, 1) if axis == 1 else (1, -1))
        upper = np.minimum(low + 1, cells - 1)
        out = out.take(low, axis) * (1.0 - share) + out.take(upper, axis) * share
    return out


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
        raise ValueError(f"model: expected 3 channels in {sidecar.layout}, got an input of {shape}")
    size = input_side(height, sidecar.height, "height"), input_side(width, sidecar.width, "width")
    if sidecar.name is not None and sidecar.name not in network.outputs:
        raise ValueError(f"name: expected one of {', '.join(network.outputs)}, got {sidecar.name!r}")
    return network, sidecar, size


class LearnedLabels:
    """Labels from a network in an ONNX file.

    What it does: class scores per pixel go through a softmax, and the best class gives label and confidence.
    Instances, as Ultralytics exports them, are drawn from their boxes and masks, no matter whether they
    overlap; what belongs to none is left to another segmenter.

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
        if self._sidecar.output not in ("logits", "instances"):
            raise ValueError(f"output: expected logits or instances for labels, got {self._sidecar.output}")
        self._under = under
        self._labels = np.array(self._sidecar.labels, np.uint8)
        self._own(np.zeros((16, 16, 3), np.uint8))

    def segment(self, rgb: UInt8Array) -> tuple[UInt8Array, Float32Array]:
        """See `Segmenter.segment`.

        Raises:
            ValueError: The network's answer is not what it should be.
        """
        labels, confidence, found = self._own(rgb)
        if self._under is None or found.all():
            return labels, confidence
        below, sure = self._under.segment(rgb)
        return np.where(found, labels, below), np.where(found, confidence, np.minimum(sure, confidence))

    def _own(self, rgb: UInt8Array) -> tuple[UInt8Array, Float32Array, npt.NDArray[np.bool_]]:
        frame = placed(rgb.shape, *self._size, letterbox=self._sidecar.letterbox)
        x = picture(rgb, frame, self._sidecar)
        if self._sidecar.output == "logits":
            name = self._sidecar.name or next(iter(self._network.outputs))
            (scores,) = self._network.run(x, [name])
            return self._from_logits(scores, frame, rgb.shape)
        answers = self._network.run(x, list(self._network.outputs))
        return self._from_instances(answers, frame, rgb.shape)

    def _from_logits(
        self, scores: Float32Array, frame: Frame, shape: tuple[int, ...]
    ) -> tuple[UInt8Array, Float32Array, npt.NDArray[np.bool_]]:
        count, classes = len(self._labels), 1 if self._sidecar.layout == "NCHW" else 3
        if scores.ndim != 4 or scores.shape[0] != 1 or scores.shape[classes] != count or scores.size == 0:
            expected = f"(1, {count}, h, w)" if classes == 1 else f"(1, h, w, {count})"
            raise ValueError(f"logits: expected {expected}, a score for each class, got {scores.shape}")
        maps = scores[0] if classes == 1 else scores[0].transpose(2, 0, 1)
        fine = resampled(maps, frame, shape)
        share = np.exp(fine - fine.max(axis=0))
        share /= share.sum(axis=0)
        # Classes with the same label stand together.
        by_label = np.stack([share[self._labels == label].sum(axis=0) for label in Label])
        best = by_label.argmax(axis=0)
        confidence = np.take_along_axis(by_label, best[None], axis=0)[0]
        found = np.ones(best.shape, np.bool_)
        return best.astype(np.uint8), np.clip(confidence, 0.0, 1.0).astype(np.float32), found

    def _from_instances(
        self, answers: list[Float32Array], frame: Frame, shape: tuple[int, ...]
    ) -> tuple[UInt8Array, Float32Array, npt.NDArray[np.bool_]]:
        boxes, scores, kinds, weights, masks = _instances(answers, len(self._labels))
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
        fine = resampled(by_label, frame, shape)
        winner, score = fine.argmax(axis=0), fine.max(axis=0)
        found = score >= HALF * self._sidecar.least_score
        labels = np.where(found, winner, int(Label.SEABED)).astype(np.uint8)
        confidence = np.where(found, score, 1.0 - score)
        return labels, np.clip(confidence, 0.0, 1.0).astype(np.float32), found


def _instances(
    answers: list[Float32Array], classes: int
) -> tuple[Float32Array, Float32Array, npt.NDArray[np.intp], Float32Array, Float32Array]:
    """Boxes (N, 4) as x0, y0, x1, y1 in the input, scores, classes, mask weights (N, m) and masks (m, h, w).

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
    masks, table = prototypes[0][0], flat[0][0]
    count = len(masks)
    if masks.size == 0:
        raise ValueError(f"instances: expected prototype masks, got {prototypes[0].shape}")
    if table.shape[0] == 4 + classes + count:
        rows = table.T
        middle, size = rows[:, :2], rows[:, 2:4]
        boxes = np.concatenate([middle - 0.5 * size, middle + 0.5 * size], axis=1)
        each = rows[:, 4 : 4 + classes]
        kinds = each.argmax(axis=1)
        return boxes, each[np.arange(len(each)), kinds], kinds, rows[:, 4 + classes :], masks
    if table.shape[1] == 6 + count:
        kinds = np.rint(table[:, 5]).astype(np.intp)
        if len(kinds) and not (kinds.min() >= 0 and kinds.max() < classes):
            raise ValueError(
                f"instances: expected classes 0 to {classes - 1}, got {kinds.min()} to {kinds.max()}"
            )
        return table[:, :4], table[:, 4], kinds, table[:, 6:], masks
    raise ValueError(
        f"instances: expected (1, {4 + classes + count}, N) or (1, N, {6 + count}) for {classes} classes and "
        f"{count} masks, got {flat[0].shape}"
    )


class LearnedDepth:
    """Depth from a network in an ONNX file, in metres by the flat floor.

    What it does: a relative depth gets its scale, and a relative inverse depth its scale and shift, from the
    pixels that are labelled seabed or target, whose depth altitude and attitude tell. A metric depth stays as
    it is. The confidence is the share of those pixels on which network and floor agree to a tenth.

    Reference: the affine invariance of inverse depth is that of MiDaS (Ranftl et al., *TPAMI*, 2022).

    Assumes: a flat floor in view.

    Fails when: too little floor is seen: then there is no depth, but for a metric one, of which nothing
    vouches.
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
        self._max_depth = max_depth
        self._raw(np.zeros((16, 16, 3), np.uint8))

    def estimate(
        self,
        rgb: UInt8Array,
        labels: UInt8Array,
        camera: Camera,
        altitude: float,
        T_world_base: SE3,
        T_base_camera: SE3,
    ) -> tuple[Float32Array, Float32Array]:
        """See `DepthModel.estimate`.

        Raises:
            ValueError: The network's answer is not what it should be.
        """
        camera.check(rgb, "rgb")
        camera.check(labels, "labels")
        raw = self._raw(rgb)
        floor = floor_depth(rays(camera, altitude, T_world_base, T_base_camera), self._max_depth)
        on_floor = ((labels == Label.SEABED) | (labels == Label.TARGET)) & np.isfinite(floor)
        fit: Fit | None
        if self._sidecar.output == "metric_depth":
            fit = judged(Fit(1.0, 0.0, False, 0.0, 0.0), raw, floor, on_floor)
        else:
            fit = fit_to_floor(raw, floor, on_floor, inverse=self._sidecar.output == "inverse_depth")
        if fit is None:
            return np.full(raw.shape, np.nan, np.float32), np.zeros(raw.shape, np.float32)
        depth = fit.depth(raw)
        known = (depth <= self._max_depth) & (labels != Label.WATER)
        return (
            np.where(known, depth, np.float32(np.nan)),
            np.where(known, np.float32(fit.agreement), np.float32(0.0)),
        )

    def _raw(self, rgb: UInt8Array) -> Float32Array:
        frame = placed(rgb.shape, *self._size, letterbox=self._sidecar.letterbox)
        name = self._sidecar.name or next(iter(self._network.outputs))
        (answer,) = self._network.run(picture(rgb, frame, self._sidecar), [name])
        maps = np.squeeze(answer)
        if maps.ndim != 2 or min(maps.shape) < 2:
            raise ValueError(f"depth: expected one number a pixel, got {answer.shape}")
        raw: Float32Array = resampled(maps[None], frame, rgb.shape)[0]
        return raw
