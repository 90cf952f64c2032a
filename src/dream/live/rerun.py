"""Run folder → `run.rrd`, which the Rerun viewer shows: pictures, map, way, reasoning and measures over time.

What the run says is logged as plain text. Writing the file sends nothing anywhere; the viewer itself reports
its use until `rerun analytics disable` is said once.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from dream import extras
from dream.files import whole_or_nothing
from dream.recording import LABEL_COLORS, RecordedStep, read_config, read_steps
from dream.report import asked_at, label_levels, open_picture
from dream.types import Label

if TYPE_CHECKING:
    import rerun

NAME = "run.rrd"


def write_rerun(folder: Path) -> Path:
    """Make `run.rrd` in a run folder, from what lies in that folder alone.

    Its times are `step`, and `mission`, the seconds on the mission's clock without the waiting.

    Raises:
        ValueError: rerun-sdk is not installed, or a file of the run is damaged.
        FileNotFoundError: It is no run folder.
        OSError: The file cannot be written.
    """
    extras.check_installed("rerun", "--rerun", "rerun")
    import rerun as rr

    config, steps = read_config(folder), read_steps(folder)
    path = folder / NAME
    with whole_or_nothing(path) as unfinished:
        # The same run is the same recording, however often it is written.
        recording = rr.RecordingStream("dream", recording_id=folder.resolve().name)
        recording.save(unfinished, default_blueprint=_layout(coverage=any(step.coverage for step in steps)))
        classes = [
            rr.AnnotationInfo(id=int(label), label=label.name.lower(), color=LABEL_COLORS[label])
            for label in Label
        ]
        recording.log("camera/labels", rr.AnnotationContext(classes), static=True)
        recording.log("config", rr.TextDocument(config.model_dump_json(indent=2)), static=True)
        way, true_way, travelled = [], [], 0.0
        for step in steps:
            recording.set_time("step", sequence=step.step)
            recording.set_time("mission", duration=step.time)
            way.append((step.pose.x, step.pose.y, step.pose.z or 0.0))
            travelled += step.distance_m
            _log_pictures(recording, folder, step.step)
            _log_pose(recording, step.pose.yaw, way)
            if step.truth is not None:
                true_way.append((step.truth.x, step.truth.y, step.truth.z or 0.0))
                recording.log("world/true_way", rr.LineStrips3D([true_way], colors=[(120, 120, 120)]))
            _log_words(recording, folder, step)
            for name, value in _measures(step, travelled).items():
                recording.log(f"measures/{name}", rr.Scalars(value))
        recording.flush()
        recording.disconnect()
    return path


def _log_pictures(recording: rerun.RecordingStream, folder: Path, step: int) -> None:
    import rerun as rr

    png = "image/png"

    def whole(path: Path, image: Image.Image) -> bytes:
        image.load()
        return path.read_bytes()

    pictures: dict[str, tuple[str, Callable[[Path, Image.Image], Any]]] = {
        "camera/rgb": (
            f"frames/{step:04d}_rgb.png",
            lambda *of: rr.EncodedImage(contents=whole(*of), media_type=png),
        ),
        "camera/depth": (
            f"frames/{step:04d}_depth.png",
            lambda *of: rr.EncodedDepthImage(blob=whole(*of), media_type=png, meter=1000.0),
        ),
        "camera/labels": (
            f"frames/{step:04d}_labels.png",
            lambda _, image: rr.SegmentationImage(np.asarray(label_levels(image))),
        ),
        "map": (f"maps/{step:04d}.png", lambda *of: rr.EncodedImage(contents=whole(*of), media_type=png)),
    }
    for entity, (name, convert) in pictures.items():
        path = folder / name
        picture = open_picture(path, partial(convert, path))
        # Where there is none, that of the step before must not stay.
        recording.log(entity, rr.Clear(recursive=False) if picture is None else picture)


def _log_pose(recording: rerun.RecordingStream, yaw: float, way: list[tuple[float, float, float]]) -> None:
    import rerun as rr

    ahead = [(np.cos(yaw), np.sin(yaw), 0.0)]
    recording.log("world/way", rr.LineStrips3D([way], colors=[(30, 140, 230)]))
    recording.log("world/vehicle", rr.Arrows3D(vectors=ahead, origins=[way[-1]], colors=[(20, 90, 220)]))


def _log_words(recording: rerun.RecordingStream, folder: Path, step: RecordedStep) -> None:
    import rerun as rr

    said = [text for text in step.reasoning.model_dump().values() if text]
    recording.log("reasoning", rr.TextDocument("\n\n".join(said) or "Nothing was said at this step."))
    happened = {
        "on the way": step.arrival_note,
        "guard": step.guarded.note,
        "not complete": step.open_region,
        "contact": "touched something and stopped" if step.collided else "",
        "ended": step.ended,
        "no usable reply": "" if step.asked is None else step.asked.fallback,
    }
    for what, text in happened.items():
        if text:
            level = "INFO" if what == "ended" else "WARN"
            recording.log("events", rr.TextLog(f"{what}: {text}", level=level))
    if step.asked is not None:
        replies = [reply for exchange in asked_at(folder, step.step) for reply in exchange["replies"]]
        recording.log("reply", rr.TextDocument("\n\n".join(replies) or "Nothing came back."))


def _measures(step: RecordedStep, travelled: float) -> dict[str, float]:
    def named(group: str, values: Mapping[str, object]) -> dict[str, float]:
        # Names come from the file too; one that would be a path of its own is none of ours.
        return {
            f"{group}/{name}": value
            for name, value in values.items()
            if isinstance(value, float) and re.fullmatch(r"\w+", name)
        }

    return {
        **named("coverage", {} if step.coverage is None else step.coverage.model_dump()),
        **named("area", step.map),
        **({} if step.clearance_m is None else {"health/clearance_m": step.clearance_m}),
        "health/position_sigma_m": step.position_sigma_m,
        "travelled_m": travelled,
        "decision_ms": step.planner_ms,
        "waited_s": step.waited_s,
    }


def _layout(*, coverage: bool) -> Any:
    """Map and way, what the camera saw, what was said, and the curves."""
    from rerun import blueprint as rrb

    curve = "coverage" if coverage else "area"
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(origin="map", name="Map"),
                rrb.Spatial3DView(origin="world", name="Way"),
                row_shares=[3, 2],
            ),
            rrb.Vertical(
                rrb.Spatial2DView(origin="camera/rgb", name="Camera"),
                rrb.Spatial2DView(origin="camera/depth", name="Depth"),
                rrb.Spatial2DView(origin="camera/labels", name="Labels"),
            ),
            rrb.Vertical(
                rrb.TextDocumentView(origin="reasoning", name="What it thinks"),
                rrb.TimeSeriesView(origin=f"measures/{curve}", name=curve.capitalize()),
                rrb.TimeSeriesView(origin="measures/health", name="Health"),
                rrb.TextLogView(origin="events", name="What happened"),
            ),
        ),
        collapse_panels=True,
    )
