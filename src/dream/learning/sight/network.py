"""The network that sees: one encoder, a top-down path, labels and depth.

It is a table of layers, which PyTorch runs here and `export` writes as an ONNX file. Only what is called here
needs PyTorch; importing this module does not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from dream.learning.network import import_torch
from dream.perception.sight import DEPTH, FEATURES, LABELS, PICTURE, VIEW
from dream.types import Label

if TYPE_CHECKING:
    from torch import Tensor
    from torch.nn import Module, ModuleDict


CELLS = 15, 20
"""Rows and columns of the grid on which means around a pixel are taken, whatever the picture's size."""
FAINT = 0.01
"""Added to a spread: noise of so much is not made larger than what is seen."""
COARSE = "coarse_labels"
"""Scores of labels at a quarter of the picture, which are learned beside the others and not written."""


class LayerKind(StrEnum):
    """What a layer does."""

    CONTRAST = "differences from the mean around, over the spread around"
    CONV = "convolution"
    GREY = "mean over the channels"
    JOIN = "channels side by side"
    MEAN = "mean over the picture"
    REPEAT = "as fine as another, by repeating"
    SHUFFLE = "twice as fine, from four channels each"


@dataclass(frozen=True, slots=True)
class Layer:
    """One line of the table; what comes out has its name."""

    name: str
    operator: LayerKind
    inputs: tuple[str, ...]
    channels: int = 0
    """That come out of a convolution, or of repeating."""
    kernel: int = 3
    """Of a convolution in pixels, of a contrast in cells."""
    stride: int = 1
    normed: bool = True
    """Whether a batch norm follows the convolution."""
    plus: tuple[str, ...] = ()
    """What is added before the rectifier."""
    rectified: bool = True
    like: str = ""
    """What is repeated gets as fine as this."""


@dataclass(frozen=True, slots=True)
class Shape:
    """How large the network is.

    What it does: beside the picture stands the contrast with what is around, of colours near and of grey wide
    (local contrast normalization: Jarrett et al., ICCV 2009), which water and light change little. An encoder
    halves the picture five times, with a residual block (He et al., CVPR 2016) at each of the last three
    sizes; a top-down path with lateral connections (feature pyramid: Lin et al., CVPR 2017) brings what is
    seen at large back to a quarter of the picture, where the depth is told; labels are told at full size,
    from half of it by pixel shuffle (Shi et al., CVPR 2016), and while it learns at a quarter too. The mean
    over the coarsest layer tells the path what water and light are like.
    """

    encoder: tuple[int, int, int, int, int] = (16, 32, 56, 88, 112)
    """Channels at a half, a quarter and so on."""
    path: int = 40
    """Channels of the top-down path."""
    fine: int = 14
    """Channels at half size from which labels are told."""

    @property
    def features(self) -> int:
        """Channels of what comes out as features."""
        return self.path + self.encoder[1]

    def layers(self) -> list[Layer]:
        """The table, in an order in which it can be run."""
        contrast, conv, join = LayerKind.CONTRAST, LayerKind.CONV, LayerKind.JOIN
        half, quarter, *deeper = self.encoder
        table = [
            Layer("near", contrast, (PICTURE,), kernel=3),
            Layer("grey", LayerKind.GREY, (PICTURE,)),
            Layer("wide", contrast, ("grey",), kernel=9),
            Layer("input", join, (PICTURE, "near", "wide", VIEW)),
            Layer("e1", conv, ("input",), half, stride=2),
            Layer("e2a", conv, ("e1",), quarter, stride=2),
            Layer("e2", conv, ("e2a",), quarter),
        ]
        for number, channels in enumerate(deeper, start=3):
            at = f"e{number}"
            table += [
                Layer(f"{at}a", conv, (f"e{number - 1}",), channels, stride=2),
                Layer(f"{at}b", conv, (f"{at}a",), channels),
                Layer(at, conv, (f"{at}b",), channels, plus=(f"{at}a",)),
            ]
        plain: dict[str, Any] = {"kernel": 1, "normed": False, "rectified": False}
        table += [
            Layer("mean", LayerKind.MEAN, ("e5",)),
            Layer("whole", conv, ("mean",), self.path, **plain),
            Layer("p5", conv, ("e5",), self.path, kernel=1, normed=False, plus=("whole",)),
        ]
        for number in (4, 3, 2):
            table += [
                Layer(
                    f"p{number + 1}up", LayerKind.REPEAT, (f"p{number + 1}",), self.path, like=f"e{number}"
                ),
                Layer(
                    f"l{number}",
                    conv,
                    (f"e{number}",),
                    self.path,
                    kernel=1,
                    normed=False,
                    plus=(f"p{number + 1}up",),
                ),
                Layer(f"p{number}", conv, (f"l{number}",), self.path),
            ]
        return [
            *table,
            Layer(DEPTH, conv, ("p2",), 2, normed=False, rectified=False),
            Layer(COARSE, conv, ("p2",), len(Label), **plain),
            Layer(FEATURES, join, ("p2", "e2")),
            Layer("thin", conv, ("p2",), self.fine, **plain),
            Layer("p2up", LayerKind.REPEAT, ("thin",), self.fine, like="e1"),
            Layer("beside", join, ("e1", "p2up")),
            Layer("p1", conv, ("beside",), self.fine),
            Layer("fours", conv, ("p1",), 4 * len(Label), normed=False, rectified=False),
            Layer(LABELS, LayerKind.SHUFFLE, ("fours",)),
        ]

    def build(self, seed: int) -> Module:
        """A network that has learned nothing: (picture, view) → outputs by name."""
        torch = import_torch()
        table, widths = self.layers(), {PICTURE: 3, VIEW: 3}
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            parts = torch.nn.ModuleDict()
            for layer in table:
                taken = sum(widths[name] for name in layer.inputs)
                widths[layer.name] = taken
                if layer.operator is LayerKind.SHUFFLE:
                    widths[layer.name] = taken // 4
                if layer.operator is LayerKind.GREY:
                    widths[layer.name] = 1
                if layer.operator is not LayerKind.CONV:
                    continue
                widths[layer.name] = layer.channels
                conv = torch.nn.Conv2d(
                    taken,
                    layer.channels,
                    layer.kernel,
                    layer.stride,
                    layer.kernel // 2,
                    bias=not layer.normed,
                )
                norm = [torch.nn.BatchNorm2d(layer.channels)] if layer.normed else []
                parts[layer.name] = torch.nn.Sequential(conv, *norm)
        return _module(table, parts)


def _module(table: list[Layer], parts: ModuleDict) -> Module:
    """What runs the table; a class of PyTorch can only be made where PyTorch is there."""
    torch = import_torch()

    class Table(torch.nn.Module):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__()
            self.parts = parts

        def forward(self, picture: Tensor, view: Tensor) -> Mapping[str, Tensor]:
            found = {PICTURE: picture, VIEW: view}
            for layer in table:
                found[layer.name] = _run(layer, [found[name] for name in layer.inputs], found, self.parts)
            return {name: found[name] for name in (LABELS, COARSE, DEPTH, FEATURES)}

    return Table()


def _run(layer: Layer, inputs: list[Tensor], found: Mapping[str, Tensor], parts: ModuleDict) -> Tensor:
    torch = import_torch()
    functional = torch.nn.functional
    out: Tensor
    if layer.operator is LayerKind.CONTRAST:
        out = contrast(inputs[0], layer.kernel)
    elif layer.operator is LayerKind.GREY:
        out = inputs[0].mean(1, keepdim=True)
    elif layer.operator is LayerKind.JOIN:
        out = torch.cat(inputs, 1)
    elif layer.operator is LayerKind.MEAN:
        out = inputs[0].mean((2, 3), keepdim=True)
    elif layer.operator is LayerKind.REPEAT:
        out = functional.interpolate(inputs[0], size=found[layer.like].shape[2:], mode="nearest")
    elif layer.operator is LayerKind.SHUFFLE:
        out = functional.pixel_shuffle(inputs[0], 2)
    else:
        out = parts[layer.name](inputs[0])
        for name in layer.plus:
            out = out + found[name]
        if layer.rectified:
            out = functional.relu(out)
    return out


def contrast(picture: Tensor, cells: int) -> Tensor:
    """Differences of each pixel from the mean of so many cells around, over the spread in them.

    Args:
        picture: (n, k, H, W) as of `CELLS`, whole pixels to a cell.
        cells: Odd, along each side of what is around.
    """
    functional = import_torch().nn.functional
    rows, cols = picture.shape[2] // CELLS[0], picture.shape[3] // CELLS[1]

    def around(values: Tensor) -> Tensor:
        within = functional.avg_pool2d(values, (rows, cols))
        averaged: Tensor = functional.avg_pool2d(within, cells, 1, cells // 2, count_include_pad=False)
        return averaged

    def fine(grid: Tensor) -> Tensor:
        resized: Tensor = functional.interpolate(grid, size=picture.shape[2:], mode="bilinear")
        return resized

    mean = around(picture)
    spread = (around(picture * picture) - mean * mean).clamp(min=FAINT**2).sqrt()
    return (picture - fine(mean)) * fine(1.0 / (spread + FAINT))
