"""What stands, in the products of a survey: drawn side by side, in tables, and as a mesh."""

from __future__ import annotations

import csv
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dream.survey import Survey
from dream.survey.products import elevations, mesh, side_by_side, tables, words
from dream.survey.products.export import export
from dream.survey.site import Site
from tests.scene.test_exports import ply
from tests.survey.scenes import WRECK_SITE, raised_wreck, wreck

INSPECTED, SEEN, OPEN = elevations.INSPECTED, elevations.SEEN_ALONE, elevations.MAY_GO_ON


@pytest.fixture(scope="module")
def survey() -> Survey:
    return raised_wreck()


def test_a_side_is_drawn_as_it_looks_from_outside(survey: Survey) -> None:
    """From the north east is on the left: the cube that was not inspected is the western lower one."""
    views = {view.index: view for view in elevations.views(survey.structures[0])}
    assert list(views) == [1, 2, 0]
    behind = elevations.BEHIND
    assert [tuple(color) for row in views[0].colors.tolist() for color in row] == [
        *(elevations.PAPER, INSPECTED, INSPECTED, INSPECTED, INSPECTED),
        *(behind, INSPECTED, INSPECTED, INSPECTED, SEEN),
    ]
    assert (views[1].colors[:, :4] == SEEN).all()
    assert tuple(views[1].colors[1, 4].tolist()) == behind
    # From the east north is on the right.
    assert tuple(views[2].colors[1, 1].tolist()) == OPEN
    assert elevations.extents(survey.structures[0]) == pytest.approx((1.25, 0.5, 0.5))


@pytest.mark.parametrize(
    "heading, names",
    [
        (0.0, ["north side", "south side", "east end", "west end"]),
        (90.0, ["east side", "west side", "south end", "north end"]),
        (-50.0, ["north-west side", "south-east side", "north-east end", "south-west end"]),
    ],
)
def test_sides_are_called_by_the_true_compass(survey: Survey, heading: float, names: list[str]) -> None:
    site = replace(WRECK_SITE, heading_deg=heading)
    told = [words.side_name(side, site) for side in survey.structures[0].sides]
    assert told == [*names, "top", "underside"]
    assert isinstance(site, Site)


def test_the_page_tells_each_structure(survey: Survey) -> None:
    text = side_by_side.sections(survey)
    assert "Structure 1, side by side" in text
    assert "Structure 2, side by side" in text
    assert "It stands 2.50 m" in text
    assert "North side" in text
    assert text.count("<figure class='view") == 4
    assert ".structure1 .views { grid-template-columns: 1.25fr 0.5fr; }" in side_by_side.style(
        survey.structures
    )


def test_a_page_in_the_plane_says_nothing_of_structures() -> None:
    assert side_by_side.sections(wreck()) == side_by_side.style(()) == ""


def test_the_table_of_measures_has_rows_of_structures_and_sides(survey: Survey, tmp_path: Path) -> None:
    tables.write(survey, tmp_path)
    with (tmp_path / "measures.csv").open(encoding="utf-8") as file:
        rows = {(row["of"], row["name"]): row["value"] for row in csv.DictReader(file)}
    assert rows["structure 1", "height"] == "2.5"
    assert rows["structure 1, north side", "inspected_share"] == "0.875"
    assert rows["structure 1, east end", "open_area"] == "0.0625"
    assert ("structure 1, west end", "open_area") not in rows
    assert rows["survey", "inspected_share"] == "0.4375"


def test_the_mesh_has_all_cubes_with_what_was_inspected(survey: Survey, tmp_path: Path) -> None:
    mesh.write(survey, tmp_path / mesh.NAME)
    lines, vertices, faces = ply(tmp_path / mesh.NAME)
    assert "comment structure 1, side 0: north side" in lines
    wall = vertices[vertices["structure"] == 1]
    # 2 × (4 × 2 + 2 × 2 + 4 × 2) faces of the wall, and of the cube beyond 5 more less the one it covers.
    assert len(wall) == 4 * (40 + 4)
    assert len(vertices) - len(wall) == 4 * 6
    assert len(faces) == len(vertices) // 2
    colors = np.stack([vertices[name] for name in ("red", "green", "blue")], -1)
    assert (colors[vertices["state"] == 2] == INSPECTED).all()
    assert (colors[vertices["state"] == 1] == SEEN).all()
    assert (colors[vertices["state"] == 0] == OPEN).all()
    assert set(vertices["inspected_from"][vertices["state"] == 2].tolist()) == {2}
    assert set(vertices["inspected_from"][vertices["state"] < 2].tolist()) == {0}
    assert (wall["side"][wall["state"] == 2] == 0).all()
    corners = np.stack([vertices[axis] for axis in "xyz"], -1)[np.stack([faces[c] for c in "abc"], -1)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(normals, axis=1).sum() / 2.0 == pytest.approx((44 + 6) * 0.0625)


def test_the_products_of_a_mission_in_space(survey: Survey, tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    made = export(survey, tmp_path / "out", only=["geopackage", "mesh"])
    assert mesh.NAME in made.files
    with closing(sqlite3.connect(made.folder / "survey.gpkg")) as file:
        rows = file.execute(
            "SELECT structure, side, value FROM structures WHERE name = 'inspected_share' AND structure = 1"
        ).fetchall()
    assert rows[:2] == [(1, "", 0.4375), (1, "north side", 0.875)]


def test_there_is_no_mesh_of_a_mission_in_the_plane(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="mesh: nothing stands in it, or it is of a mission in the plane"):
        export(wreck(), tmp_path / "out", only=["mesh"])
