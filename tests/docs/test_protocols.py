"""`docs/protocols.md` says what `src/dream/protocol.py` does."""

from __future__ import annotations

import math
import re
from dataclasses import fields, replace

import pytest

from dream.cli import run_command
from dream.evaluation.metrics import COMPLETE, VISIBLE_PIXELS, Coverage
from dream.geometry import Camera
from dream.protocol import (
    DREAM_V1,
    DREAM_V1_NAV,
    DREAM_V1_NOISY,
    DREAM_V2,
    ORDERED,
    POOL_V1,
    PROTOCOLS,
    SHOWN,
    LastingErrors,
    SensorNoise,
    Space,
    SurveyProtocol,
)
from dream.sim.visual_range import UNTOLD
from dream.sim.water import LUMINANCE, WATERS
from dream.sim.worlds import SIDES
from dream.types import LOOK_AROUND, Label
from tests.docs.reading import ROOT, tables

PAGE = (ROOT / "docs" / "protocols.md").read_text(encoding="utf-8")
WORDS = " ".join(PAGE.split())
TABLES = {heading: (head, rows) for heading, head, rows in tables(PAGE)}


def tables_under(heading: str) -> list[tuple[list[str], list[list[str]]]]:
    """Head and rows of each table under a heading."""
    return [(head, rows) for under, head, rows in tables(PAGE) if under == heading]


METRES = ("altitude", "body_radius", "body_height", "min_depth", "max_depth", "reach", "cell", "lattice")


def told(protocol: SurveyProtocol, field: str) -> str:
    """A value as the page writes it."""
    value = getattr(protocol, field)
    if field == "turns":
        degrees = [round(math.degrees(turn * protocol.heading_step)) for turn in value]
        return ", ".join("0" if d == 0 else "180" if d == 180 else f"±{d}" for d in degrees if d >= 0) + "°"
    if field == "advances":
        return ", ".join(f"{advance:g}" for advance in value) + " m"
    if isinstance(value, Camera):
        return f"{value.width} × {value.height}, {math.degrees(value.horizontal_fov):.0f}°"
    if isinstance(value, tuple):
        return f"{value[0]:g} to {value[1]:g} m"
    if field == "camera_pitch":
        return f"{math.degrees(value):.0f}°"
    if value is None:
        return "–"
    return f"{value:g} m" if isinstance(value, float) else f"{value}"


def test_every_value_of_both_protocols_is_told() -> None:
    head, rows = TABLES["Vehicle, camera, map and moves"]
    assert head == ["field", "means", "`dream-v1`", "`pool-v1`"]
    found = {row[0].strip("`"): row[2:] for row in rows}
    named = [one.name for one in fields(SurveyProtocol) if one.name not in ("name", "noise", "swims")]
    assert found == {name: [told(DREAM_V1, name), told(POOL_V1, name)] for name in named}


def test_all_protocols_are_listed_and_differ_as_it_says() -> None:
    _, rows = next((head, rows) for heading, head, rows in tables(PAGE) if head[0] == "protocol")
    assert {name.strip("` ") for row in rows for name in row[0].split(",")} == set(PROTOCOLS)
    assert replace(DREAM_V1_NOISY, name="dream-v1", noise=None) == DREAM_V1
    assert replace(DREAM_V1_NAV, name="dream-v1-noisy", swims=False) == DREAM_V1_NOISY
    for name, protocol in PROTOCOLS.items():
        if "reach" in name:
            assert replace(protocol, name="dream-v1", reach=DREAM_V1.reach) == DREAM_V1


def test_the_noise_is_told() -> None:
    _, rows = TABLES["The sensor that errs"]
    noise = DREAM_V1_NOISY.noise
    assert noise is not None
    low, high = noise.false_size
    assert {row[0].strip("`"): row[2] for row in rows} == {
        "depth": f"{noise.depth:g} / m",
        "missed": f"{noise.missed:g}",
        "false_targets": f"{noise.false_targets:g}",
        "false_size": f"{low:g} to {high:g} m",
    }
    assert {row[0].strip("`") for row in rows} == {one.name for one in fields(SensorNoise)}


def test_what_moves_in_space_is_told_with_reasons() -> None:
    space = DREAM_V2.space
    assert space is not None
    assert replace(DREAM_V2, name="dream-v1-noisy", cap=200, space=None, lasting=None) == DREAM_V1_NOISY
    _, rows = tables_under("In three dimensions")[0]
    assert {row[0].strip("`"): row[2] for row in rows} == {
        "climbs": ", ".join(f"±{climb:g}" for climb in space.climbs if climb > 0.0) + " m",
        "tilts": ", ".join(f"{math.degrees(tilt):.0f}°" for tilt in space.tilts).replace("-", "−"),
        "lowest": f"{space.lowest:g} m",
        "highest": f"{space.highest:g} m",
        "surface": f"{space.surface:g} m",
        "incidence": f"{math.degrees(space.incidence):.0f}°",
        "label_lengths": f"{space.label_lengths:g}",
        "depth_lengths": f"{space.depth_lengths:g}",
    }
    assert {row[0].strip("`") for row in rows} == {one.name for one in fields(Space)}
    assert all(row[3] for row in rows)
    assert set(space.climbs) == {-climb for climb in space.climbs}
    assert f"the reach of {DREAM_V2.reach:g} m is straight through the water" in WORDS


def test_what_goes_by_the_site_is_told() -> None:
    _, rows = tables_under("In three dimensions")[1]
    assert {row[0].strip("`") for row in rows} == set(ORDERED)
    assert next(row[1] for row in rows if row[0] == "`cap`").endswith(f"at least {DREAM_V2.cap}")
    assert f"{DREAM_V2.trusted:g} m with the errors below" in WORDS
    for area, labels, told in ((45.0**2, 8.0, "300 steps"), (70.0**2, 8.0, "700"), (70.0**2, 3.5, "1,400")):
        assert f"{DREAM_V2.ordered(area, labels, 1.5).cap:,}" == told.split()[0]
        assert told in WORDS


def test_the_range_in_every_water_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["worlds", "--waters"]) == 0
    printed = capsys.readouterr().out.splitlines()[1 : 1 + len(WATERS)]
    _, rows = tables_under("In three dimensions")[2]
    assert [[row[0].strip("`"), *row[1:]] for row in rows] == [
        re.split(r"\s{2,}", line.strip()) for line in printed
    ]
    assert ", ".join(f"{share:g}" for share in LUMINANCE) in WORDS
    assert f"the label is `{UNTOLD.name.lower()}`" in WORDS


def test_the_errors_that_last_are_told() -> None:
    lasting = DREAM_V2.lasting
    assert lasting is not None
    _, rows = TABLES["Errors that last"]
    least, greatest = lasting.blob
    assert {row[0].strip("`"): row[2] for row in rows} == {
        "labels": ", ".join(f"{100 * share:g} % at {metres:g} m" for metres, share in lasting.labels),
        "blob": f"{least:g} to {greatest:g} m",
        "depth": f"{100 * lasting.depth:g} %",
        "height": f"{lasting.height:g} m",
        "tilt": f"{math.degrees(lasting.tilt):g}°",
    }
    assert {row[0].strip("`") for row in rows} == {one.name for one in fields(LastingErrors)}


def test_what_counts_is_told() -> None:
    _, rows = TABLES["Seen, coverage, success"]
    assert {row[0].strip("`") for row in rows} == set(Coverage.__slots__)
    assert f"**{100 * COMPLETE:g} %** is the coverage that the paper reports" in WORDS
    assert f"at least {VISIBLE_PIXELS} pixels within reach" in WORDS
    assert f"{['', 'one', 'two', 'three'][LOOK_AROUND]} quarter turns of the *look-around*" in WORDS
    assert f"a model is shown {['', 'the', 'twice the'][SHOWN]} pixels along each side" in WORDS
    assert f"{min(SIDES):g} to {max(SIDES):g} m a side" in WORDS
    assert f"no ground nearer than {DREAM_V1.blind:.1f} m" in WORDS


def test_an_advance_is_as_long_as_it_says() -> None:
    lengths = {
        nominal: {
            round(DREAM_V1.lattice * math.hypot(*DREAM_V1.offset(heading, nominal)), 2)
            for heading in range(DREAM_V1.headings)
        }
        for nominal in DREAM_V1.advances
    }
    assert lengths == {1.0: {1.0, 1.12}, 2.0: {2.0, 1.8}}
    assert "may be 1.12 m long, and one of 2 m may be 1.80 m" in WORDS


@pytest.mark.parametrize("label", Label)
def test_labels_are_told(label: Label) -> None:
    assert f"{int(label)} {label.name.lower()}" in WORDS
