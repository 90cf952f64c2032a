"""Run folder → one self-contained HTML file: no network, opens anywhere.

Whatever stands in the run folder is treated as text from a stranger: it enters the page as JSON that
cannot close its element, is shown as text only, and the page's policy forbids it to load anything.
"""

from __future__ import annotations

import base64
import hashlib
import html
import io
import json
import logging
import math
import re
import shlex
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from PIL import Image

from dream.files import whole_or_nothing
from dream.homeward import read_budget
from dream.planning import PLANNERS
from dream.recording import (
    LABEL_COLORS,
    RecordedStep,
    RunConfig,
    read_config,
    read_exchanges,
    read_steps,
    read_summary,
)
from dream.scene import SPACE, view
from dream.types import Label, UInt8Array

logger = logging.getLogger(__name__)

DEPTH_LEVEL = 0.1
"""Metres per grey level of the depth pictures in the page; level 0 is none."""

T = TypeVar("T")

SHARED_SCRIPTS = ("words.js", "pictures.js", "asked.js", "chart.js", "step.js", "player.js")
"""What the page of a mission under way is made of, too; in this order."""

_JPEG_QUALITY = 80
_MAX_SIDE = 4096
_MOST_DRAWN = 1 << 16
"""Colours: the map of a step has some hundreds."""
# What Pillow says of a header that promises too much; the warning counts where warnings are errors.
_BOMBS = (Image.DecompressionBombError, Image.DecompressionBombWarning)


def write_report(folder: Path) -> Path:
    """Make `report.html` in a run folder, from what lies in that folder alone.

    An aborted run, which may have no summary, is shown as far as it went. A run with `space.npz` is shown in
    three dimensions, too; where that file is damaged, the page says so.

    Raises:
        FileNotFoundError: It is no run folder.
        ValueError: One of its files is damaged; the message names it.
        OSError: The page cannot be written.
    """
    config, summary, steps = read_config(folder), read_summary(folder), read_steps(folder)
    farthest = 0
    blocks = []
    with ThreadPoolExecutor() as pool:
        for level, of_step in pool.map(lambda step: _blocks(folder, step), steps):
            farthest = max(farthest, level)
            blocks += of_step
    run = {
        "config": config.model_dump(mode="json"),
        "summary": summary.model_dump() if summary else None,
        "steps": [step.model_dump() for step in steps],
        "labels": [{"name": label.name.lower(), "color": LABEL_COLORS[label]} for label in Label],
        "depth_level": DEPTH_LEVEL,
        "depth_max": max(5, 5 * math.ceil(farthest * DEPTH_LEVEL / 5)),
        "command": repeating_command(config),
        **of_protocol(config),
    }
    style, script, space = part("page.css"), "".join(map(part, SHARED_SCRIPTS)), ""
    if (folder / SPACE).exists():
        style += view.part("space.css")
        script += view.part("space.js") + view.part("space_report.js")
        space = view.part("space.html")
        blocks.append(_block("space-data", view.shown(folder / SPACE)))
    script += part("page.js")
    policy = (
        "default-src 'none'; img-src data:; base-uri 'none'; form-action 'none'; "
        f"style-src {digest(style)}; script-src {digest(script)}"
    )
    page = fill(
        part("page.html"),
        {
            "policy": policy,
            "title": html.escape(f"{_place(config)}, {config.planner} · DREAM"),
            "style": style,
            "stage": part("stage.html"),
            "space": space,
            "player": part("player.html"),
            "run": _json(run),
            "pictures": "\n".join(blocks),
            "script": script,
        },
    )
    path = folder / "report.html"
    with whole_or_nothing(path) as partial:
        partial.write_text(page, encoding="utf-8")
    return path


def of_protocol(config: RunConfig) -> dict[str, Any]:
    """What a page needs of a run's protocol: where the map lies on its pictures, and the lattice of moves.

    Returns:
        `inset`: Fields of `mapping.drawing.Inset`, and the legend; None where the run tells no bounds.
        `lattice`: Metres between the places where moves end; None where the vehicle ends them where it can.
    """
    from dream.mapping.drawing import FOR_PEOPLE, OUTLINE, WAY_HOME, grid_spacing, inset

    try:
        protocol = config.rules
    except ValueError:
        return {"inset": None, "lattice": None}
    lattice = None if config.swimming or config.dive else protocol.lattice
    if config.bounds is None:
        return {"inset": None, "lattice": lattice}
    legend = [*FOR_PEOPLE.legend(protocol), *([(OUTLINE, "to be seen")] if config.orders else [])]
    if config.budget:
        legend.append((WAY_HOME, "way home"))
    told = {
        **asdict(inset(config.bounds, protocol)),
        "grid": grid_spacing(config.bounds),
        "legend": [{"color": color, "name": name} for color, name in legend],
    }
    return {"inset": told, "lattice": lattice}


def repeating_command(config: RunConfig) -> str:
    """The command line that runs it again.

    Parameters of the planner stand in it where they are not the default; the protocol always, since which
    one the world is made for is not known here.
    """
    if config.command:
        return config.command
    words = ["dream", "run", config.planner_file or config.planner]
    words += ["--world", config.world_from or config.world, "--seed", str(config.seed)]
    words += ["--protocol", config.protocol]
    if config.start:
        words += ["--start", str(config.start)]
    if config.max_steps is not None:
        words += ["--max-steps", str(config.max_steps)]
    if config.budget is not None:
        words += read_budget(config.budget).options
    if config.orders is not None:
        words += ["--mission", json.dumps(config.orders)]
    defaults = asdict(PLANNERS[config.planner]) if config.planner in PLANNERS else {}
    for name, value in config.planner_parameters.items():
        if name not in defaults or value != defaults[name]:
            words += ["--" + name.replace("_", "-"), str(value)]
    return shlex.join(words)


def _place(config: RunConfig) -> str:
    """Where it was; a real place has no seed."""
    return config.world if config.real else f"{config.world} seed {config.seed}"


def _blocks(folder: Path, step: RecordedStep) -> tuple[int, list[str]]:
    """The highest level of a step's depth, and what the page holds of the step beside its line."""
    pictures, level = _pictures(folder, step.step)
    blocks = [_block(f"pictures-{step.step}", pictures)]
    if step.asked is not None:
        blocks.append(_block(f"asked-{step.step}", asked_at(folder, step.step)))
    return level, blocks


def _pictures(folder: Path, step: int) -> tuple[dict[str, str | None], int]:
    """Data URLs of a step's pictures, None where one cannot be read, and the highest level of its depth."""
    depth = open_picture(folder / f"frames/{step:04d}_depth.png", depth_levels)
    rgb = open_picture(folder / f"frames/{step:04d}_rgb.png", lambda image: image.convert("RGB"))
    pictures = {
        "map": _url("png", open_picture(folder / f"maps/{step:04d}.png", _few_colors)),
        "rgb": _url("jpeg", rgb),
        "depth": _url("png", Image.fromarray(depth) if depth is not None else None),
        "labels": _url("png", open_picture(folder / f"frames/{step:04d}_labels.png", label_levels)),
    }
    return pictures, 0 if depth is None else int(depth.max(initial=0))


def asked_at(folder: Path, step: int) -> list[dict[str, Any]]:
    """What a model was shown at a step, byte by byte, and answered; None for pictures that cannot be read."""
    return [
        {
            "prompt": exchange.prompt,
            "model": exchange.model,
            "answered_by": exchange.answered_by,
            "question": exchange.question,
            "pictures": {
                name: _exact_url(png, f"the picture {name} of step {step}")
                for name, png in exchange.pictures.items()
            },
            "replies": exchange.replies,
            "fallback": exchange.fallback,
            "requests": exchange.requests,
            "tokens_in": exchange.tokens_in,
            "tokens_out": exchange.tokens_out,
            "cost_usd": exchange.cost_usd,
            "seconds": exchange.seconds,
            "outcome": exchange.outcome,
            "lacks": exchange.lacks,
            "expected": json.dumps(exchange.expected, indent=1) if exchange.expected else "",
        }
        for exchange in read_exchanges(folder, step)
    ]


def _exact_url(png: bytes, what: str) -> str | None:
    whole = open_picture(io.BytesIO(png), lambda image: image.load() is not None, what)
    return f"data:image/png;base64,{base64.b64encode(png).decode()}" if whole else None


def open_picture(file: Path | io.BytesIO, convert: Callable[[Image.Image], T], what: str = "") -> T | None:
    """What `convert` makes of a PNG; None, with a warning, where it is missing, damaged or too large."""
    try:
        with Image.open(file, formats=["PNG"]) as image:
            if max(image.size) > _MAX_SIDE:
                raise ValueError(f"expected at most {_MAX_SIDE} pixels a side, got {image.size}")
            return convert(image)
    except (OSError, ValueError, SyntaxError, *_BOMBS) as error:
        logger.warning("%s is left out: %s", what or file, error)
        return None


def _few_colors(image: Image.Image) -> Image.Image:
    """A drawing in its 256 commonest colours, which takes a third of the space.

    These stay exact; the rarer ones, along smooth lines, take the nearest of them. A picture of more colours
    than any drawing has is Pillow's to reduce.
    """
    drawing = image.convert("RGB")
    counted: Any = drawing.getcolors(_MOST_DRAWN)
    if counted is None:
        return drawing.quantize(256)
    colors = np.array([color for _, color in sorted(counted, reverse=True)], np.int32)
    palette, rare = colors[:256], colors[256:]
    nearest = [*range(len(palette)), *(np.square(palette - color).sum(axis=1).argmin() for color in rare)]
    # One entry for each possible colour: memory that is not touched costs nothing.
    index_of = np.zeros(1 << 24, np.uint8)
    index_of[colors @ np.array([1, 1 << 8, 1 << 16])] = nearest
    # Four bytes a pixel, read as one little-endian number; the uppermost is opacity.
    codes = np.asarray(drawing.convert("RGBA")).view("<u4")[..., 0] & 0xFFFFFF
    few = Image.fromarray(index_of[codes]).convert("P")
    few.putpalette(palette.astype(np.uint8).tobytes())
    return few


def depth_levels(image: Image.Image) -> UInt8Array:
    """(H, W) of a recorded depth picture, in units of `DEPTH_LEVEL`; 0 where there is none."""
    levels = np.rint(np.asarray(image, np.float64) / (1000.0 * DEPTH_LEVEL))
    return np.clip(levels, 0, 255).astype(np.uint8)


def label_levels(image: Image.Image) -> Image.Image:
    """A recorded label picture with the label itself in each pixel, as grey, instead of its colour."""
    if image.mode != "P":
        raise ValueError(f"expected a palette image, got mode {image.mode}")
    return Image.fromarray(np.asarray(image, np.uint8))


def _url(kind: str, image: Image.Image | None) -> str | None:
    if image is None:
        return None
    buffer = io.BytesIO()
    image.save(buffer, kind, quality=_JPEG_QUALITY)
    return f"data:image/{kind};base64,{base64.b64encode(buffer.getvalue()).decode()}"


def _block(name: str, value: Any) -> str:
    return f'<script type="application/json" id="{name}">{_json(value)}</script>'


def _json(value: Any) -> str:
    """JSON that may stand inside a script element: it holds no character that HTML gives a meaning."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def digest(text: str) -> str:
    """A source expression of a content security policy that allows exactly `text`."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def fill(template: str, parts: Mapping[str, str]) -> str:
    """`template` with each {{name}} replaced, in one pass, so that no part can name another."""
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], template)


def part(name: str) -> str:
    """A file of the page."""
    return resources.files("dream").joinpath("report_page", name).read_text(encoding="utf-8")
