"""OBJ files as other programs write them are taken, turned to look outwards, or refused by their line."""

from __future__ import annotations

import json
import math
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.cli import run_command
from dream.sim.files import examine, load_world, save_world, world_hash
from dream.sim.formats import COLUMNS, Said
from dream.sim.meshes import icosphere, post, ring_wall
from dream.sim.wavefront import obj, read_meshes
from dream.sim.world import Mesh
from tests.sim.made import made

Faces = npt.NDArray[np.int32]
Points = npt.NDArray[np.float64]

BOX = """o crate
v -0.5 -0.5 0.0 0.2 0.4 0.6
v 0.5 -0.5 0.0 0.2 0.4 0.6
v 0.5 0.5 0.0 0.2 0.4 0.6
v -0.5 0.5 0.0 0.2 0.4 0.6
v -0.5 -0.5 1.5 0.2 0.4 0.6
v 0.5 -0.5 1.5 0.2 0.4 0.6
v 0.5 0.5 1.5 0.2 0.4 0.6
v -0.5 0.5 1.5 0.2 0.4 0.6
f 1 4 3
f 1 3 2
f 5 6 7
f 5 7 8
f 1 2 6
f 1 6 5
f 2 3 7
f 2 7 6
f 3 4 8
f 3 8 7
f 4 1 5
f 4 5 8
"""
QUADS = BOX[: BOX.index("f ")] + "f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n"
GREY = "\n".join(" ".join(line.split()[:4]) for line in BOX.splitlines()) + "\n"


def grown(vertices: Points, faces: npt.ArrayLike) -> Mesh:
    colors = np.full(vertices.shape, 128, np.uint8)
    return Mesh(np.round(vertices, 3).astype(np.float32), np.asarray(faces, np.int32), colors)


def ball(radius: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    vertices, faces = icosphere(1)
    return grown(radius * vertices + at, faces)


def together(*parts: Mesh) -> Mesh:
    first = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + at for part, at in zip(parts, first, strict=False)]
    return grown(np.concatenate([part.vertices for part in parts]).astype(float), np.concatenate(faces))


def flipped(mesh: Mesh, which: Any = slice(None)) -> Mesh:
    faces = mesh.faces.copy()
    faces[which] = faces[which][:, [0, 2, 1]]
    return Mesh(mesh.vertices, faces, mesh.colors, mesh.two_sided)


TETRAHEDRON = grown(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
)
CLOSED = {
    "ball": ball(),
    "tetrahedron": TETRAHEDRON,
    "pipe": post(0.1, 2.0, 7, (90, 90, 90)),
    "ring": ring_wall(2.0, 0.2, 1.0, 9, (90, 90, 90)),
    "far from its origin": ball(0.5, (300.0, -200.0, 80.0)),
}


def said_of(
    text: str, tmp_path: Path, two_sided: tuple[int, ...] = ()
) -> tuple[tuple[Mesh, ...], list[Said]]:
    path = tmp_path / "meshes.obj"
    path.write_text(text, newline="")
    meshes, _, said = read_meshes(path, None, two_sided)
    return meshes, said


def read(mesh: Mesh, tmp_path: Path) -> tuple[Mesh, list[str]]:
    (back,), said = said_of(obj((mesh,)), tmp_path, (0,) if mesh.two_sided else ())
    return back, [f"{one.what}: {one.words}" for one in said]


# ------------------------------------------------------------------------------------------ winding


@pytest.mark.parametrize("name", CLOSED)
def test_a_closed_mesh_that_is_wound_inside_out_is_turned(name: str, tmp_path: Path) -> None:
    mesh = CLOSED[name]
    assert read(mesh, tmp_path)[1] == []
    back, said = read(flipped(mesh), tmp_path)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    assert said == [f"turned: object 0 (mesh_0): {len(mesh.faces)} faces, wound inside out"]


@pytest.mark.parametrize("name", CLOSED)
def test_single_faces_that_are_wound_the_other_way_are_turned(name: str, tmp_path: Path) -> None:
    mesh = CLOSED[name]
    which = np.flatnonzero(np.random.default_rng(3).random(len(mesh.faces)) < 0.4)
    back, said = read(flipped(mesh, which), tmp_path)
    np.testing.assert_array_equal(back.faces, mesh.faces)
    assert said[0].endswith(f"of which {len(which)} were wound the other way")


def test_of_two_bodies_only_the_one_that_is_inside_out_is_turned(tmp_path: Path) -> None:
    beside, touching = ball(0.5, (3.0, 0.0, 0.0)), ball(0.5, (0.6, 0.0, 0.0))
    for other in (beside, touching):
        whole = together(ball(), other)
        back, _ = read(together(ball(), flipped(other)), tmp_path)
        np.testing.assert_array_equal(back.faces, whole.faces)


def test_a_cavity_looks_into_itself(tmp_path: Path) -> None:
    hollow = together(ball(), flipped(ball(0.5)))
    back, said = read(hollow, tmp_path)
    np.testing.assert_array_equal(back.faces, hollow.faces)
    assert said == []
    inside_out, _ = read(together(flipped(ball()), flipped(ball(0.5))), tmp_path)
    np.testing.assert_array_equal(inside_out.faces, hollow.faces)


def test_a_body_without_a_bottom_is_turned_and_what_may_be_meant_either_way_is_told(tmp_path: Path) -> None:
    box = said_of(BOX, tmp_path)[0][0]
    no_bottom, no_top = (
        Mesh(box.vertices, np.delete(box.faces, gone, 0), box.colors) for gone in ([0, 1], [2, 3])
    )
    back, said = read(flipped(no_bottom), tmp_path)
    np.testing.assert_array_equal(back.faces, no_bottom.faces)
    assert said == ["turned: object 0 (mesh_0): 10 faces, wound inside out"]
    plate = Mesh(box.vertices, box.faces[:2], box.colors)
    for either in (no_top, flipped(no_top), plate, flipped(plate)):
        back, said = read(either, tmp_path)
        np.testing.assert_array_equal(back.faces, either.faces)
        assert said == [
            "taken: 1 object open, so that nothing tells which side is out: object 0 (mesh_0). Seen from "
            "where corners run counter-clockwise; list under two_sided what is seen from both"
        ]
    # Most of a plate is as it was meant.
    strip = Mesh(box.vertices, box.faces[[2, 3, 6, 7]], box.colors)
    np.testing.assert_array_equal(read(flipped(strip, [2]), tmp_path)[0].faces, strip.faces)


def test_a_surface_with_one_side_is_refused_unless_it_is_seen_from_both(tmp_path: Path) -> None:
    turns = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    rim = [
        [
            (2.0 + s * math.cos(t / 2)) * math.cos(t),
            (2.0 + s * math.cos(t / 2)) * math.sin(t),
            s * math.sin(t / 2),
        ]
        for t in turns
        for s in (-0.5, 0.5)
    ]
    faces = []
    for k in range(12):
        a, b, c, d = 2 * k, 2 * k + 1, (2 * k + 2) % 24, (2 * k + 3) % 24
        c, d = (c, d) if k < 11 else (d, c)
        faces += [[a, c, b], [b, c, d]]
    strip = grown(np.array(rim), faces)
    assert read(strip, tmp_path)[1][0].startswith("refused: object 0 (mesh_0): expected faces with an inside")
    back, said = read(Mesh(strip.vertices, strip.faces, strip.colors, two_sided=True), tmp_path)
    np.testing.assert_array_equal(back.faces, strip.faces)
    assert said == []


def test_a_mesh_whose_faces_share_no_vertices_is_turned_all_the_same(tmp_path: Path) -> None:
    mesh = ball()
    soup = grown(
        mesh.vertices[mesh.faces].reshape(-1, 3).astype(float), np.arange(3 * len(mesh.faces)).reshape(-1, 3)
    )
    back, said = read(flipped(soup), tmp_path)
    np.testing.assert_array_equal(back.faces, soup.faces)
    assert "wound inside out" in said[0]


# ------------------------------------------------------------------------------------- other writers


STAR = "".join(f"v {math.cos(k * 2.4)} {math.sin(k * 2.4)} 0\n" for k in range(9)) + "f 1 2 3 4 5 6 7 8 9"


def corner_set(mesh: Mesh) -> set[tuple[tuple[float, ...], ...]]:
    """Triangles by their places, each from its least corner on."""
    found = set()
    for face in mesh.vertices[mesh.faces].round(3).tolist():
        k = min(range(3), key=lambda n: face[n])
        found.add(tuple(tuple(face[(k + n) % 3]) for n in range(3)))
    return found


def with_faces(change: Callable[[str], str], text: str = BOX) -> str:
    """Every corner of every face in another form."""
    lines = [
        " ".join(["f", *map(change, line.split()[1:])]) if line.startswith("f ") else line
        for line in text.splitlines()
    ]
    return "\n".join(lines) + "\n"


WRITERS = {
    "normals": (with_faces(lambda k: f"{k}//{k}", BOX.replace("f 1 4", "vn 0 0 1\nf 1 4", 1)), ""),
    "textures": (with_faces(lambda k: f"{k}/1", "mtllib box.mtl\n" + BOX), "materials and textures"),
    "both": (
        with_faces(lambda k: f"{k}/1/{k}", BOX.replace("f 5", "usemtl steel\ns off\nf 5", 1)),
        "materials",
    ),
    "from the end": (with_faces(lambda k: str(int(k) - 9)), "12 faces counted from the end"),
    "quads": (QUADS, "6 polygons split into triangles, 6 more faces"),
    "quads from the end": (with_faces(lambda k: f"{int(k) - 9}//1", QUADS), "6 faces counted from the end"),
    "no object": (BOX.replace("o crate\n", ""), ""),
    "a group": (BOX.replace("o crate\n", "g crate\n"), ""),
    "vertices first": (BOX.replace("o crate\n", "").replace("f 1 4", "o crate\nf 1 4", 1), ""),
    "carriage returns": ("\ufeff" + BOX.replace("\n", "\r\n"), ""),
    "comments": (BOX.replace("f 5 6 7\n", "# top\nf 5 6 7 # half\n"), ""),
    "continued": (BOX.replace("f 5 6 7\n", "f 5 \\\n6 \\\n7\n"), ""),
    "levels": (BOX.replace("0.2 0.4 0.6", "51 102 153"), "colours from 0 to 255"),
    "lines": (BOX + "l 1 2 3\np 1\n", ""),
}


@pytest.mark.parametrize("name", WRITERS)
def test_what_other_programs_write_is_the_same_mesh(name: str, tmp_path: Path) -> None:
    text, told = WRITERS[name]
    (plain,), _ = said_of(BOX, tmp_path)
    (mesh,), said = said_of(text, tmp_path)
    assert [one.what for one in said if one.what != "taken"] == []
    assert told in " ".join(one.words for one in said)
    area = sum(np.linalg.norm(np.cross(b - a, c - a)) / 2 for a, b, c in mesh.vertices[mesh.faces])
    assert area == pytest.approx(8.0)
    if "quads" not in name:  # Which may be split along the other diagonal.
        assert corner_set(mesh) == corner_set(plain)
    np.testing.assert_array_equal(np.unique(mesh.colors, axis=0), [[51, 102, 153]])


@pytest.mark.parametrize(
    "text",
    [
        GREY,
        GREY.replace("0.0\n", "0.0 1.0\n"),
        GREY + BOX.replace("f ", "f -0").split("f ")[0].replace("o crate", "# more"),
    ],
)
def test_vertices_without_colour_are_grey(text: str, tmp_path: Path) -> None:
    (mesh, *_), said = said_of(text, tmp_path)
    assert (mesh.colors[:8] == 128).all()
    assert "8 vertices without colour, taken for grey" in [one.words for one in said]


def test_a_polygon_with_a_notch_is_split_within_itself(tmp_path: Path) -> None:
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    arrow = [(0, 0), (2, 1), (0, 2), (0.5, 1)]
    for corners, area in ((outline, 3.0), (arrow, 1.5)):
        for turn in range(len(corners)):
            rolled = corners[turn:] + corners[:turn]
            text = "".join(f"v {x} {y} 0\n" for x, y in rolled)
            text += "f " + " ".join(map(str, range(1, len(rolled) + 1))) + "\n"
            (mesh,), said = said_of(text, tmp_path)
            a, b, c = (mesh.vertices[mesh.faces[:, side]].astype(float) for side in range(3))
            up = np.cross(b - a, c - a)[:, 2] / 2
            assert (up >= 0.0).all()
            assert up.sum() == pytest.approx(area)
            assert all(one.what == "taken" for one in said)


def test_objects_may_share_the_vertices_of_one_before(tmp_path: Path) -> None:
    head, faces = BOX.split("f ", 1)
    text = head.replace("o crate\n", "") + "o lower\nf 1 4 3\nf 1 3 2\no upper\nf 5 6 7\nf 5 7 8\n"
    meshes, _ = said_of(text, tmp_path, (0, 1))
    assert [len(mesh.vertices) for mesh in meshes] == [4, 4]
    assert [set(mesh.vertices[:, 2].tolist()) for mesh in meshes] == [{0.0}, {1.5}]
    assert faces


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (BOX.replace("f 1 4 3", "f 0 4 3"), "line 10: expected vertices from 1, or from −1 to -8 from"),
        (BOX.replace("f 1 4 3", "f 1 4 9"), "line 10: expected vertices 1 to 8, got 9"),
        (BOX.replace("f 1 4 3", "f -1 -2 -9"), "line 10: expected vertices from 1, or from −1 to -8"),
        (BOX.replace("f 1 4 3", "f 1 4"), "line 10: expected a face of 3 to 1000 corners"),
        (BOX.replace("f 1 4 3", "f 1 4 " + "3 " * 1000), "line 10: expected a face of 3 to 1000 corners"),
        (BOX.replace("f 1 4 3", "f 1 4 /3"), "line 10: expected numbers"),
        (BOX.replace("f 1 4 3", "f 1 4 3.0"), "line 10: expected numbers"),
        (BOX.replace("v 0.5 -0.5 0.0 ", "v 0.5 -0,5 0.0 "), 'line 3: expected numbers, got "v 0.5 -0,5'),
        (BOX.replace("v 0.5 -0.5 0.0 0.2 0.4 0.6", "v 0.5 -0.5"), 'line 3: expected "v x y z" or'),
        (BOX.replace("v 0.5 -0.5 0.0 0.2 0.4 0.6", "v 0.5 -0.5 0 2"), 'line 3: expected "v x y z" or'),
        (BOX.replace("0.6\nf", "-0.6\nf"), "object 0: expected colours from 0 to 1, got -0.6"),
        (BOX.replace("0.6\nf", "nan\nf"), "line 9: expected finite numbers, got \"v "),
        (BOX + "o rope\nv 0 0 0\nl 1 2\n", "object 1 (rope): expected faces, got none"),
        (BOX.replace("f 1 4 3", "f \x1b[31m"), 'got "f \\x1b[31m"'),
        (STAR, "line 10: expected a polygon that is a fan"),
    ],
)  # fmt: skip
def test_what_cannot_be_a_mesh_is_refused_by_its_line(text: str, told: str, tmp_path: Path) -> None:
    _, said = said_of(text, tmp_path)
    refused = [str(one) for one in said if one.what == "refused"]
    assert len(refused) == 1
    assert refused[0].startswith("meshes.obj: ")
    assert told in refused[0]
    assert len(refused[0]) < 250


def test_of_many_lines_that_are_refused_the_first_are_told(tmp_path: Path) -> None:
    _, said = said_of(BOX + "f 1 2 99\n" * 500, tmp_path)
    assert len(said) == 21
    assert said[-1].words == "480 more lines like these"


def test_whatever_stands_in_a_file_it_is_a_mesh_or_refused(tmp_path: Path) -> None:
    """Texts that are cut, repeated, swapped and made up, by a seed."""
    rng = np.random.default_rng(39)
    words = [
        "f ",
        "v ",
        "o ",
        "\n",
        "-1",
        "0",
        "1e39",
        "nan",
        "/",
        "//2",
        "#",
        "\\\n",
        "999999999999999999999",
        "\x1b",
        "é",
    ]
    texts = [BOX, QUADS, GREY, WRITERS["both"][0], WRITERS["from the end"][0]]
    taken = 0
    for _ in range(160):
        text = texts[rng.integers(len(texts))]
        for _ in range(rng.integers(1, 3)):
            at, wide = int(rng.integers(len(text) + 1)), int(rng.integers(6))
            text = (
                text[:at]
                + (words[rng.integers(len(words))] if rng.random() < 0.7 else "")
                + text[at + wide :]
            )
        meshes, said = said_of(text, tmp_path)
        assert all(one.words.isprintable() and len(one.words) < 400 for one in said)
        if any(one.what == "refused" for one in said):
            continue
        taken += 1
        for mesh in meshes:
            assert len(mesh.colors) == len(mesh.vertices)
            assert mesh.faces.min(initial=0) >= 0
            assert mesh.faces.max(initial=0) < len(mesh.vertices)
    assert 10 < taken < 140


# ------------------------------------------------------------------------------------ in their world


@pytest.fixture(scope="module")
def empty(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("own") / "empty"
    save_world(made("flat/empty", 1), folder)
    return folder


Built = Callable[..., Path]


@pytest.fixture
def built(empty: Path, tmp_path: Path) -> Built:
    """A folder with a bare seabed, these meshes, and these obstacles: mesh, place, quaternion and scale."""

    def build(text: str, *obstacles: str, name: str = "own", **meshes: Any) -> Path:
        folder = tmp_path / name
        shutil.copytree(empty, folder)
        (folder / "meshes.obj").write_text(text)
        rows = "".join(f"{row},1,1,1,0\n" for row in obstacles)
        (folder / "obstacles.csv").write_text(f"{COLUMNS}\n{rows}")
        content = json.loads((folder / "world.json").read_text())
        starts = [line.split()[0] for line in text.splitlines() if line.strip()]
        content["obstacles"] = len(obstacles)
        content["meshes"] = {
            "count": starts.count("o"),
            "vertices": starts.count("v"),
            "faces": starts.count("f"),
        }
        content["meshes"] |= {"two_sided": [], **meshes}
        (folder / "world.json").write_text(json.dumps(content))
        return folder

    return build


FLOOR = float(made("flat/empty", 1).terrain.heights[0, 0])
THERE = f"0,5,5,{FLOOR},1,0,0,0,1,1,1"


def refused(folder: Path) -> list[str]:
    examined = examine(folder)
    assert (examined.world is None) == any(one.what == "refused" for one in examined.said)
    return [str(one) for one in examined.said if one.what == "refused"]


def sized(
    sides: tuple[float, float, float],
    middle: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    inwards: bool = False,
) -> str:
    """The box, with sides in metres."""
    lines = []
    for line in BOX.splitlines():
        word, *values = line.split()
        if word == "v":
            x, y, z = (float(value) for value in values[:3])
            at = (x * sides[0] + middle[0], y * sides[1] + middle[1], (z / 1.5 - 0.5) * sides[2] + middle[2])
            values = [*(f"{value:.3f}" for value in at), *values[3:]]
        lines.append(" ".join([word, *(values[::-1] if word == "f" and inwards else values)]))
    return "\n".join(lines) + "\n"


def scaled(factor: float) -> str:
    lines = []
    for line in BOX.splitlines():
        word, *values = line.split()
        if word == "v":
            line = " ".join([word, *(str(factor * float(value)) for value in values[:3]), *values[3:]])
        lines.append(line)
    return "\n".join(lines) + "\n"


def test_a_world_is_the_same_however_its_meshes_are_wound_and_written(built: Built) -> None:
    plain = load_world(built(BOX, THERE))
    inside_out = "\n".join(
        " ".join(["f", *line.split()[:0:-1]]) if line.startswith("f") else line for line in BOX.splitlines()
    )
    turned = load_world(built(inside_out, THERE, name="turned"))
    assert corner_set(turned.meshes[0]) == corner_set(plain.meshes[0])
    quads = load_world(built(QUADS, THERE, name="quads"))
    assert quads.meshes[0].faces.shape == (12, 3)
    # Its count may be that of the triangles as well.
    assert world_hash(load_world(built(QUADS, THERE, name="counted", faces=12))) == world_hash(quads)
    assert refused(built(QUADS, THERE, name="cut", faces=7)) == [
        "meshes.obj: faces: expected 7 as world.json says, got 6 (12 triangles). If the file is whole, "
        "correct world.json"
    ]


START = made("flat/empty", 1).starts[0]
HALF = math.sqrt(0.5)
ROOMS = {
    "room": ((16.0, 12.0, 6.0), (0.0, 0.0, 0.0), f"0,{START.x},{START.y},{FLOOR + 2},1,0,0,0,1,1,1"),
    "tank": ((42.0, 42.0, 9.0), (0.0, 0.0, 0.0), f"0,0,0,{FLOOR + 4},1,0,0,0,1,1,1"),
    "turned and scaled": (
        (2.0, 1.0, 1.0),
        (5.0, 0.0, 0.0),
        f"0,{START.x},{START.y - 15},{FLOOR + 2},{HALF},0,0,{HALF},3,4,5",
    ),
}


@pytest.mark.parametrize("name", ROOMS)
def test_a_room_around_a_start_keeps_its_faces_inwards(name: str, built: Built, tmp_path: Path) -> None:
    sides, middle, row = ROOMS[name]
    text = sized(sides, middle, inwards=True)
    examined = examine(built(text, row, name="in"))
    assert examined.world is not None
    (mesh,), _ = said_of(sized(sides, middle), tmp_path)
    assert corner_set(examined.world.meshes[0]) == corner_set(flipped(mesh))
    (told,) = examined.said
    assert told.what == "taken"
    assert "object 0 (crate)" in told.words
    assert "around a start" in told.words
    # Beside the start it is a body inside out.
    x, y = START.x + 14.0 * (1 if START.x < 0 else -1), START.y
    beside = sized((3.0, 3.0, 3.0), inwards=True)
    aside = examine(built(beside, f"0,{x},{y},{FLOOR + 2},1,0,0,0,1,1,1", name="aside"))
    assert [one.what for one in aside.said] == ["turned"]


def test_a_room_without_a_floor_keeps_its_faces_inwards_but_for_some(built: Built) -> None:
    sides, middle, row = ROOMS["room"]
    text = sized(sides, middle, inwards=True).replace("f 3 4 1\nf 2 3 1\n", "")
    lines = text.splitlines()
    a, b, c = lines[-1].split()[1:]
    wrong = "\n".join([*lines[:-1], f"f {c} {b} {a}"]) + "\n"
    one, other = (examine(built(words, row, name=name)) for words, name in ((text, "one"), (wrong, "other")))
    assert one.world is not None
    assert other.world is not None
    assert text.count("f ") == 10
    assert corner_set(one.world.meshes[0]) == corner_set(other.world.meshes[0])
    assert [said.what for said in one.said] == ["taken"]
    assert [said.what for said in other.said] == ["turned", "taken"]


def test_an_arch_whose_box_holds_a_start_is_turned_all_the_same(built: Built) -> None:
    ring = flipped(ring_wall(6.0, 0.5, 8.0, 16, (90, 90, 90)))
    examined = examine(built(obj((ring,)), f"0,{START.x},{START.y},{FLOOR},1,0,0,0,1,1,1"))
    assert [one.what for one in examined.said] == ["turned"]


def test_what_was_turned_in_a_world_is_told_on_the_log_once(
    built: Built, caplog: pytest.LogCaptureFixture
) -> None:
    folder = built(sized((1.0, 1.0, 1.0), inwards=True), THERE)
    load_world(folder)
    load_world(folder)
    assert caplog.messages == [f"{folder}: meshes.obj: object 0 (crate): 12 faces, wound inside out"]
    caplog.clear()
    many = obj(tuple(flipped(ball(0.5, (k, 0.0, 0.0))) for k in range(9)))
    folder = built(many, *(THERE.replace("0", str(k), 1) for k in range(9)), name="many")
    load_world(folder)
    assert len(caplog.messages) == 4
    assert caplog.messages[-1] == f"{folder}: and 6 more turned: dream worlds --check {folder}"


@pytest.mark.parametrize(
    ("factor", "row", "told"),
    [
        (
            1000.0,
            THERE,
            r"obstacles, row 1: expected at most 40 m in bounds of 40 x 40 m, got 1500 m.*millimetres",
        ),
        (200.0, THERE, r"obstacles, row 1: expected at most 40 m .*got 300 m"),
        (
            20000.0,
            THERE,
            r"meshes\[0\].vertices, row 5, column 3: expected a number within ±10000, got 30000.*millimetres",
        ),
        (1.0, THERE.replace("1,1,1", "1,500,1"), r"obstacles, row 1: expected at most 80 m .*got 500 m"),
        (1e-4, THERE, r"obstacles, row 1: expected a mesh of a millimetre or more, got 0.00015 m.*metres"),
    ],
)
def test_lengths_that_are_not_metres_are_refused(built: Built, factor: float, row: str, told: str) -> None:
    folder = built(scaled(factor), row)
    (words,) = refused(folder)
    assert re.search(told, words)
    with pytest.raises(ValueError, match=told):
        load_world(folder)


@pytest.mark.parametrize("sides", [(70.0, 30.0, 25.0), (45.0, 40.0, 20.0), (60.0, 20.0, 40.0)])
def test_shells_in_millimetres_are_refused_though_the_bounds_are_as_large(
    built: Built, sides: tuple[float, float, float]
) -> None:
    (words,) = refused(built(sized(sides), THERE))
    assert f"obstacles, row 1: expected at most 40 m in bounds of 40 x 40 m, got {sides[0]:g} m" in words


@pytest.mark.parametrize("sides", [(8.0, 5.0, 5.0), (30.0, 4.0, 4.0), (6.0, 1.0, 6.0)])
def test_an_individual_is_not_larger_than_some_metres_unless_it_is_of_a_hull(
    built: Built, sides: tuple[float, float, float]
) -> None:
    folder = built(sized(sides))
    (folder / "targets.csv").write_text(f"{COLUMNS}\n{THERE},1,1,1,0\n")
    content = json.loads((folder / "world.json").read_text())
    (folder / "world.json").write_text(json.dumps(content | {"targets": 1}))
    (words,) = refused(folder)
    assert (
        f"targets, row 1: expected at most 5 m of an individual that is no part of a hull, got {sides[0]:g}"
        in words
    )
    (folder / "world.json").write_text(json.dumps(content | {"targets": 1, "targets_are_hull": True}))
    assert refused(folder) == []


@pytest.mark.parametrize(
    ("sides", "row"),
    [
        ((60.0, 50.0, 12.0), f"0,0,0,{FLOOR},1,0,0,0,1,1,1"),
        ((75.0, 0.5, 3.0), THERE),
        ((60.0, 12.0, 9.0), f"0,20,5,{FLOOR},1,0,0,0,1,1,1"),
    ],
    ids=["a tank", "a quay", "a wreck"],
)
def test_what_is_longer_than_the_bounds_is_slender_or_goes_round_them(
    built: Built, sides: tuple[float, float, float], row: str
) -> None:
    assert refused(built(sized(sides), row)) == []


def test_millimetres_that_the_table_scales_are_taken(built: Built) -> None:
    assert refused(built(scaled(1000.0), THERE.replace("1,1,1", "0.001,0.001,0.001"))) == []


UPRIGHT = {
    "crate": BOX,
    "post": obj((post(0.4, 3.0, 9, (90, 90, 90)),)),
    "ring": obj((ring_wall(1.0, 0.2, 2.0, 9, (90, 90, 90)),)),
}


def y_up(text: str) -> str:
    """As exporters write it that hold y for up: x, z, −y."""
    lines = []
    for line in text.splitlines():
        word, *values = line.split()
        if word == "v":
            x, y, z = map(float, values[:3])
            line = " ".join(["v", f"{x}", f"{z}", f"{-y}", *values[3:]])
        lines.append(line)
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("times", [2, 3])
@pytest.mark.parametrize("name", ["crate", "post", "ring"])
def test_an_object_that_was_pasted_behind_others_is_refused_by_its_name(
    built: Built, name: str, times: int
) -> None:
    """Each file counts from its own first vertex, so that the faces of the second use those of the first."""
    whole = UPRIGHT[name]
    told = refused(built(whole * times, THERE))
    assert len(told) == times - 1
    for line in told:
        assert "got faces between those of others. They count from the first vertex of the file" in line


@pytest.mark.parametrize("name", UPRIGHT)
def test_a_mesh_with_y_up_is_refused_until_the_world_says_which_is_up(built: Built, name: str) -> None:
    text = UPRIGHT[name]
    right = load_world(built(text, THERE))
    lying = y_up(text)
    (told,) = refused(built(lying, THERE, name="lying"))
    assert 'Is y up? Say "up": "y" under "meshes" in world.json' in told
    turned = examine(built(lying, THERE, name="turned", up="y"))
    assert turned.world is not None
    assert world_hash(turned.world) == world_hash(right)
    assert [str(one) for one in turned.said] == ["meshes.obj: y is up, as world.json says: x, −z, y"]
    # What is meant to lie there does.
    assert refused(built(lying, THERE, name="meant", up="z")) == []
    half = math.sqrt(0.5)
    assert refused(built(lying, THERE.replace("1,0,0,0", f"{half},{half},0,0"), name="by quaternion")) == []
    above = THERE.replace(f"{FLOOR}", f"{FLOOR + 2.0}")
    assert refused(built(lying, above, name="above")) == []


@pytest.mark.parametrize(("long", "wide"), [(5.0, 0.4), (30.0, 1.0), (2.0, 0.11)])
def test_a_pipe_that_is_half_buried_along_y_is_taken_and_told(built: Built, long: float, wide: float) -> None:
    pipe = sized((wide, long, wide), middle=(0.0, 0.5 * long, 0.0))
    examined = examine(built(pipe, THERE))
    assert examined.world is not None
    (told,) = examined.said
    assert told.what == "taken"
    assert re.search(r"object 0 \(crate\): begins at y = 0 .*taken for a pipe along y. Is y up\?", told.words)


def test_all_that_is_amiss_is_said_at_once(built: Built, capsys: pytest.CaptureFixture[str]) -> None:
    folder = built(
        BOX.replace("f 1 4 3", "f 1 4 33").replace("v 0.5 0.5 0.0", "v 0.5 half 0.0"),
        THERE,
        "0,1,2,three,1,0,0,0,1,1,1",
    )
    content = json.loads((folder / "world.json").read_text())
    content["starts"][0]["x"] = 0.123
    content["protocol"] = "dream-v9"
    (folder / "world.json").write_text(json.dumps(content))
    (folder / "terrain.npy").write_bytes(b"none")
    (folder / "targets.csv").unlink()
    assert run_command(["worlds", "--check", str(folder)]) == 1
    lines = capsys.readouterr().out.splitlines()
    for file, words in [
        ("world.json", "dream-v9"),
        ("terrain.npy", "damaged"),
        ("targets.csv", "expected a file"),
        ("obstacles.csv", "line 3"),
        ("meshes.obj", "line 10: expected vertices 1 to 8, got 33"),
        ("meshes.obj", "line 4"),
    ]:
        assert sum(line.startswith(f"refused  {file}: ") and words in line for line in lines) == 1, words
    assert lines[-1] == f"{folder}: refused, 6 things to mend"
    with pytest.raises(ValueError, match=r"\(and 5 more: dream worlds --check"):
        load_world(folder)


def test_a_world_that_is_fit_is_said_to_be_and_what_became_of_it(
    built: Built, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = built(GREY, THERE)
    assert run_command(["worlds", "--check", str(folder)]) == 0
    taken, last = capsys.readouterr().out.splitlines()
    assert taken == "taken    meshes.obj: 8 vertices without colour, taken for grey"
    assert last.startswith(f"{folder}: fit to fly; meshes: 1, individuals: 0, obstacles: 1")
    assert run_command(["worlds", "--check", str(folder), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["fit"]
    assert told["hash"] == world_hash(load_world(folder))
    assert [one["what"] for one in told["findings"]] == ["taken"]


@pytest.mark.parametrize("name", ["./nowhere", "nowhere/", "/nowhere/at/all", "~/nowhere", "..", "file.txt"])
def test_a_world_s_folder_that_is_not_there_is_said_to_be_missing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file.txt").touch()
    for command in (["draw", "--world"], ["bench", "--world"], ["worlds", "--check"]):
        if name == ".." and command[0] == "worlds":
            continue  # It is a folder, of which all is told.
        assert run_command([*command, name]) == 2
        told = capsys.readouterr().err
        assert "expected a folder with a world.json, got " in told
        assert "dream worlds --save" in told
    assert run_command(["draw", "--world", "my-bay"]) == 2
    assert 'no such folder or world: "my-bay"' in capsys.readouterr().err
