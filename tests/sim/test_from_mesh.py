"""A mesh of somebody's becomes a world: what is kept, what is checked, and where it stands."""

from __future__ import annotations

import json
import math
import os
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.cli import run_command
from dream.geometry import SE3
from dream.protocol import DREAM_V1
from dream.sim.files import load_world, world_hash
from dream.sim.from_mesh import COVER, MARGIN, RAGGED, SINK, Made, world_of
from dream.sim.mesh_files import ReadMesh, read_surface
from dream.sim.render import Renderer
from dream.sim.solids import Solids
from dream.sim.world import World
from dream.sim.wrecks.patches import SLIVER

Points = npt.NDArray[np.float64]
QUADS = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (1, 3, 7, 5), (0, 4, 6, 2)]
"""Of a box whose corners count x first, then y, then z."""
BOX = 12.0, 4.0, 3.0


def box(x: float, y: float, z: float, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ReadMesh:
    """A closed box of twelve triangles that stands on `at`."""
    corners = np.array([(i, j, k) for k in (0, 1) for j in (0, 1) for i in (0, 1)], np.float64)
    vertices = (corners - (0.5, 0.5, 0.0)) * (x, y, z) + at
    faces = [(q[0], q[k], q[k + 1]) for q in QUADS for k in (1, 2)]
    return ReadMesh(vertices, np.array(faces, np.int64), None, ())


def both(*surfaces: ReadMesh) -> ReadMesh:
    first = np.cumsum([0, *(len(one.vertices) for one in surfaces)])
    faces = [one.faces + at for one, at in zip(surfaces, first, strict=False)]
    return ReadMesh(np.concatenate([one.vertices for one in surfaces]), np.concatenate(faces), None, ())


def sheet(height: Any, half: float = 6.0) -> ReadMesh:
    """An open sheet over a square, wound to look up: z is a function of x and y."""
    line = np.linspace(-half, half, 13)
    x, y = np.meshgrid(line, line)
    vertices = np.stack([x, y, height(x, y) + 0.0 * x], axis=-1).reshape(-1, 3)
    a = (np.arange(12)[:, None] * 13 + np.arange(12)).ravel()
    faces = np.concatenate([np.stack(c, 1) for c in ((a, a + 1, a + 14), (a, a + 14, a + 13))])
    return ReadMesh(vertices, faces, None, ())


def soup(world: World) -> Points:
    """(T, 3, 3) all triangles of the targets, in the world."""
    table = world.targets
    parts = [
        (world.meshes[k].vertices + at)[world.meshes[k].faces]
        for k, at in zip(table.mesh, table.position, strict=True)
    ]
    return np.concatenate(parts).astype(np.float64)


def areas(triangles: Points) -> Points:
    a, b, c = np.moveaxis(triangles, 1, 0)
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def above(world: World, points: Points) -> Points:
    """Metres over the seabed."""
    return np.asarray(points[:, 2] - world.terrain.height(points[:, 0], points[:, 1]))


@pytest.fixture(scope="module")
def barge() -> Made:
    return world_of(box(*BOX), "barge", up="z", scale=1.0)


def test_the_surface_is_kept_and_cut_into_patches_of_half_a_metre(barge: Made) -> None:
    world = barge.world
    whole = 2.0 * (12.0 * 4.0 + 12.0 * 3.0 + 4.0 * 3.0)
    each = np.array(
        [float(areas(mesh.vertices[mesh.faces].astype(np.float64)).sum()) for mesh in world.meshes]
    )
    assert each.sum() == pytest.approx(whole, rel=1e-6)
    assert 0.2 < np.median(each) < 0.3
    assert (each < SLIVER).mean() < 0.06, "as of the package's barge"
    assert 0.5 * whole / 0.25 < len(world.targets) < 1.5 * whole / 0.25
    assert not any(mesh.two_sided for mesh in world.meshes)
    assert barge.extents == pytest.approx(BOX)
    assert world.hull.all()
    triangles = soup(world)
    a, b, c = np.moveaxis(triangles - [0.0, 0.0, triangles[..., 2].mean()], 1, 0)
    assert (a * np.cross(b, c)).sum() / 6.0 == pytest.approx(12.0 * 4.0 * 3.0, rel=1e-6), "outwards"
    assert barge.told == ("no colours: painted as rusty steel",)


def test_it_stands_on_the_seabed_deep_enough_and_with_room_around(barge: Made) -> None:
    world = barge.world
    points = soup(world).reshape(-1, 3)
    foot = points[points[:, 2] < points[:, 2].min() + 0.01]
    assert SINK - 0.0011 <= above(world, foot).min() <= above(world, foot).max() < 0.1
    box = world.bounds
    assert box.x_max - points[:, 0].max() >= MARGIN
    assert box.y_max - points[:, 1].max() >= MARGIN
    assert world.terrain.x0 <= box.x_min - 20.0


def test_no_patch_is_too_wide_whichever_way_the_surface_lies() -> None:
    c, s = math.cos(0.6), math.sin(0.6)
    leaning = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ np.array(
        [[1, 0, 0], [0, c, s], [0, -s, c]]
    )
    surface = box(*BOX)
    made = world_of(replace(surface, vertices=surface.vertices @ leaning), "leaning", up="z")
    for mesh in made.world.meshes:
        spread = mesh.vertices[:, None] - mesh.vertices[None]
        assert np.sqrt(np.square(spread).sum(axis=-1)).max() <= RAGGED + 1e-6


@pytest.mark.parametrize(("tall", "deep"), [(3.0, 10.0), (9.5, 14.0)])
def test_the_top_stays_under_water(tall: float, deep: float) -> None:
    world = world_of(box(12.0, 10.0, tall), "tower", up="z").world
    heights = soup(world)[..., 2]
    assert heights.max() <= -COVER
    assert heights.min() == pytest.approx(-deep, abs=1e-5)


def test_its_starts_are_free_and_look_at_it(barge: Made) -> None:
    world = barge.world
    solids, places = Solids(world), soup(world).reshape(-1, 3)[:, :2]
    assert len(world.starts) == 4
    for start in world.starts:
        assert solids.clearance(start.x, start.y, DREAM_V1) > 2.5
        away = places - (start.x, start.y)
        nearest = away[np.hypot(*away.T).argmin()]
        assert 4.5 <= np.hypot(*nearest) <= 8.0
        turn = math.atan2(nearest[1], nearest[0]) - start.yaw
        assert abs(math.remainder(turn, 2.0 * math.pi)) <= 0.5 * DREAM_V1.heading_step + 1e-6
    lattice = solids.lattice(DREAM_V1)
    assert lattice.reachable.sum() > 0.5 * lattice.reachable.size


def test_a_camera_beside_it_sees_it(barge: Made) -> None:
    world = barge.world
    floor = float(world.terrain.height(0.0, -6.0))
    eye = SE3.level(0.0, -6.0, floor + DREAM_V1.altitude, 0.5 * math.pi) @ DREAM_V1.T_base_camera
    frame = Renderer(world).render(DREAM_V1.camera, eye)
    middle = frame.depth[frame.depth.shape[0] // 2, frame.depth.shape[1] // 2]
    assert 3.5 < middle < 5.0
    shown = np.unique(frame.ids[frame.ids >= 0])
    assert len(shown) > 20
    assert (world.targets.position[shown, 1] < 0.0).all(), "the near side"


@pytest.mark.parametrize(
    "change",
    [
        lambda s: (replace(s, vertices=s.vertices[:, [0, 2, 1]] * (1.0, 1.0, -1.0)), "y", 1.0),
        lambda s: (replace(s, vertices=1000.0 * s.vertices), "z", 0.001),
        lambda s: (replace(s, vertices=s.vertices + np.array([500_000.0, 4_000_000.0, -30.0])), "z", 1.0),
        lambda s: (replace(s, faces=np.concatenate([s.faces, s.faces[:3]])), "z", 1.0),
    ],
    ids=["y up", "millimetres", "far from the origin", "faces twice"],
)  # fmt: skip
def test_axis_unit_and_place_of_the_file_make_no_difference(change: Any, barge: Made) -> None:
    surface, up, scale = change(box(*BOX))
    made = world_of(surface, "barge", up=up, scale=scale)
    assert world_hash(made.world) == world_hash(barge.world)


def test_a_mesh_wound_inside_out_is_turned(barge: Made) -> None:
    inside_out = replace(box(*BOX), faces=box(*BOX).faces[:, ::-1])
    made = world_of(inside_out, "barge")
    np.testing.assert_allclose(areas(soup(made.world)).sum(), areas(soup(barge.world)).sum())
    triangles = soup(made.world)
    a, b, c = np.moveaxis(triangles - [0.0, 0.0, triangles[..., 2].mean()], 1, 0)
    assert (a * np.cross(b, c)).sum() > 0.0
    assert "12 of 12 triangles turned, which were wound the other way" in made.told


@pytest.mark.parametrize("over", [False, True])
def test_an_open_shell_is_seen_from_both_sides_and_its_ground_lies_under_it(over: bool) -> None:
    surface = sheet(lambda x, y: 0.2 * x + 0.3 * np.cos(0.8 * y))
    if over:
        surface = replace(surface, faces=surface.faces[:, ::-1])
    made = world_of(surface, "shell")
    assert all(mesh.two_sided for mesh in made.world.meshes)
    assert ("288 of 288 triangles turned, which were wound the other way" in made.told) == over
    assert "288 of 288 triangles are of open shells: seen from both sides" in made.told
    points = soup(made.world).reshape(-1, 3)
    under = above(made.world, points)
    assert under.min() >= SINK - 0.0011
    assert np.quantile(under, 0.95) < 0.5, "although it rises by 2.4 m"
    middles = soup(made.world).mean(axis=1)
    assert above(made.world, middles).min() > 0.0


def test_the_seabed_does_not_rise_to_what_overhangs() -> None:
    made = world_of(both(box(2.0, 2.0, 3.0), box(14.0, 8.0, 1.0, (0.0, 0.0, 3.0))), "mushroom")
    x, y = np.meshgrid(np.linspace(-6.5, 6.5, 27), np.linspace(-3.5, 3.5, 15))
    ground = made.world.terrain.height(x, y)
    assert np.ptp(ground) < 0.5
    assert soup(made.world)[..., 2].min() - ground.max() < 0.2


def test_edges_of_more_than_two_triangles_and_scraps_are_told() -> None:
    hull = box(*BOX)
    fin = ReadMesh(np.array([(6.0, 2.0, 1.0)]), np.empty((0, 3), np.int64), None, ())
    scrap = ReadMesh(np.array([(0, 3, 1), (0.05, 3, 1), (0, 3.05, 1)]), np.array([(0, 1, 2)]), None, ())
    joined = both(hull, fin, scrap)
    one = np.array([(0, 1, 8)])  # On an edge of the box, to a corner of its own.
    made = world_of(replace(joined, faces=np.concatenate([joined.faces, one])), "odd")
    assert "1 edges with more than two triangles (not manifold)" in made.told
    assert "1 loose scraps of less than 100 cm² left out" in made.told
    assert areas(soup(made.world)).sum() > 192.0


def test_colours_of_the_file_are_kept_where_faces_are_halved() -> None:
    surface = box(*BOX)
    red = np.where(surface.vertices[:, :1] > 0.0, (200, 40, 40), (40, 40, 200)).astype(np.uint8)
    made = world_of(replace(surface, colors=red), "painted")
    assert made.told == ()
    for mesh, at in zip(made.world.meshes, made.world.targets.position, strict=True):
        east = (mesh.vertices[:, 0] + at[0] + 6.0) / 12.0
        np.testing.assert_allclose(mesh.colors[:, 0], 40.0 + 160.0 * east, atol=1.5)


def test_what_is_no_target_is_an_obstacle_and_shells_stop_nothing() -> None:
    shells = world_of(box(*BOX), "shells", shells=True).world
    assert not shells.hull.any()
    assert Solids(shells).free([[0.0, 0.0]], DREAM_V1).all()
    rock = world_of(box(*BOX), "rock", target=False).world
    assert (len(rock.targets), len(rock.obstacles)) == (0, 1)
    assert not Solids(rock).free([[6.0, 0.0]], DREAM_V1).any()


@pytest.mark.parametrize(
    ("surface", "said", "words"),
    [
        (box(12_000.0, 4_000.0, 3_000.0), {}, r"--scale: expected a mesh 3 to 250 m long, got 12000 m\. "
         r"Say --scale 0\.001 if it is in millimetres, which makes 12 m, or --scale 0\.01 if it is in cent"),
        (box(60.0, 20.0, 15.0), {"scale": 10.0}, r"--scale: expected a mesh 0\.5 to 400 m long, got 600 m"),
        (box(0.6, 0.2, 0.1), {}, r"got 0\.6 m\. Say --scale 10 if it is a model of 1:10, .*--scale 1 if 0"),
        (box(600.0, 200.0, 100.0), {}, r"--scale 0\.3048 if it is in feet, which makes 183 m"),
        (box(12.0, 4.0, 3.0), {"scale": -1.0}, r"--scale: expected metres of a unit, more than 0, got -1"),
        (box(12.0, 3.0, 10.0), {}, r"--up: expected a mesh that lies flat, got x 12, y 3, z 10 m\. Say"),
        (box(6.0, 6.0, 3.0), {"water": "claer"}, r'no water "claer"\. Did you mean "clear"'),
        (box(300.0, 200.0, 90.0), {"scale": 1.0}, r"expected at most 25,000 m² of surface, got 210,000 m²"),
    ],
)  # fmt: skip
def test_what_looks_wrong_is_asked_with_what_to_say(surface: ReadMesh, said: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        world_of(surface, "odd", **said)


def test_what_somebody_said_is_believed() -> None:
    world_of(box(12.0, 3.0, 10.0), "tower", up="z")
    assert world_of(box(0.6, 0.3, 0.2), "coral", scale=1.0).extents == pytest.approx((0.6, 0.3, 0.2))


# Files


def ply(surface: ReadMesh, form: str, colors: bool = False, quads: bool = False) -> bytes:
    """The surface as PLY."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[form]
    faces = [list(quad) for quad in QUADS] if quads else surface.faces.tolist()
    names = ["x", "y", "z", "nx"]
    head = [f"format {form} 1.0", "comment by hand", f"element vertex {len(surface.vertices)}"]
    head += [f"property float {name}" for name in names]
    head += [f"property uchar {name}" for name in ("red", "green", "blue")] * colors
    head += [f"element face {len(faces)}", "property uchar flags", "property list uchar int vertex_indices"]
    rows = [[*vertex, 0.0, *((9, 99, 199) if colors else ())] for vertex in surface.vertices.tolist()]
    lines = b""
    if not order:
        lines = "".join(f"{' '.join(map(str, row))}\n" for row in rows).encode()
        lines += "".join(f"7 {len(face)} {' '.join(map(str, face))}\n" for face in faces).encode()
    else:
        lines = b"".join(struct.pack(f"{order}4f{'3B' if colors else ''}", *row) for row in rows)
        lines += b"".join(struct.pack(f"{order}BB{len(face)}i", 7, len(face), *face) for face in faces)
    return ("ply\n" + "\n".join(head) + "\nend_header\n").encode() + lines


def stl(surface: ReadMesh, text: bool) -> bytes:
    triangles = surface.vertices[surface.faces]
    if text:
        facets = [
            f"facet normal 0 0 0\nouter loop\n{corners}endloop\nendfacet\n"
            for corners in ("".join(f"vertex {x} {y} {z}\n" for x, y, z in t) for t in triangles.tolist())
        ]
        return f"solid box\n{''.join(facets)}endsolid box\n".encode()
    return (
        b"solid but binary".ljust(80)
        + struct.pack("<I", len(triangles))
        + b"".join(struct.pack("<12fH", 0, 0, 0, *t.ravel().tolist(), 0) for t in triangles)
    )


def obj(surface: ReadMesh) -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in surface.vertices.tolist()]
    lines += ["o hull", *(f"f {' '.join(f'{k + 1}/1' for k in quad)}" for quad in QUADS)]
    return "\n".join(lines).encode()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", ply(box(*BOX), "ascii")),
        ("a.ply", ply(box(*BOX), "binary_little_endian")),
        ("a.ply", ply(box(*BOX), "binary_big_endian", colors=True)),
        ("a.ply", ply(box(*BOX), "ascii", quads=True)),
        ("a.ply", ply(box(*BOX), "binary_little_endian", quads=True)),
        ("a.stl", stl(box(*BOX), text=True)),
        ("a.STL", stl(box(*BOX), text=False)),
        ("a.obj", obj(box(*BOX))),
    ],
)
def test_every_format_gives_the_same_triangles(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    read, wanted = read_surface(tmp_path / name), box(*BOX)
    found, expected = read.vertices[read.faces], wanted.vertices[wanted.faces]
    assert areas(found).sum() == pytest.approx(areas(expected).sum())
    a, b, c = np.moveaxis(found, 1, 0)
    assert (a * np.cross(b, c)).sum() / 6.0 == pytest.approx(144.0)
    if b"uchar red" in content:
        assert read.colors is not None
        assert (read.colors == (9, 99, 199)).all()
    else:
        assert read.colors is None


def test_triangles_and_quads_in_one_binary_file_are_read(tmp_path: Path) -> None:
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty double x\nproperty double y\n"
    head += "property double z\nelement face 11\nproperty list uchar uint vertex_index\nend_header\n"
    body = box(*BOX).vertices.astype("<f8").tobytes() + struct.pack("<B4I", 4, *QUADS[0])
    body += b"".join(struct.pack("<B3I", 3, *face) for face in box(*BOX).faces[2:].tolist())
    (tmp_path / "a.ply").write_bytes(head.encode() + body)
    read = read_surface(tmp_path / "a.ply")
    assert areas(read.vertices[read.faces]).sum() == pytest.approx(192.0)
    assert read.told == ("1 polygons split into triangles",)


GOOD, TEXT = ply(box(*BOX), "binary_little_endian"), ply(box(*BOX), "ascii")
FACETS = stl(box(*BOX), text=True)


QUAD = np.arange(4, dtype="<f4").tobytes()


def faces_of(kinds: bytes, rows: bytes, count: int) -> bytes:
    """A binary PLY of the corners of a unit square, with faces as they are given."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4").tobytes()
    head = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\n"
    head += b"property float x\nproperty float y\nproperty float z\n"
    head += b"element face %d\nproperty list %s vertex_indices\nend_header\n" % (count, kinds)
    return head + corners + rows


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.glb", b"glTF", r"expected a mesh in \.ply, \.obj or \.stl, got \.glb\. Export it as PLY"),
        ("a.ply", b"", r'expected a header from "ply" to "end_header"'),
        ("a.ply", GOOD[:-5], r"expected 12 rows of face, got 11"),
        ("a.ply", GOOD[:300], r"expected 8 rows of vertex, got"),
        ("a.ply", GOOD.replace(b"face 12", b"face 0"), r"expected triangles, got none\. Is it a cloud"),
        ("a.ply", GOOD.replace(b"float z", b"float w"), r"expected vertices with x, y and z, got none of z"),
        (
            "a.ply",
            GOOD.replace(b"float x", b"quad x"),
            r'expected a line of a PLY header, got "property quad',
        ),
        ("a.ply", GOOD.replace(b"_indices", b"_numbers"), r"expected faces with vertex_indices or"),
        ("a.ply", TEXT.replace(b"7 3 ", b"7 9 ", 1), r"face: expected numbers for flags"),
        ("a.ply", TEXT.replace(b"-6.0", b"there", 1), r"vertex: expected numbers for x, y"),
        ("a.ply", TEXT.replace(b"-6.0", b"nan", 1), r"vertex 0: expected finite numbers"),
        (
            "a.ply",
            faces_of(b"uchar float", b"\x04" + np.arange(4, dtype="<f4").tobytes(), 1),
            r"whole numbers",
        ),
        ("a.ply", faces_of(b"char int", b"\xff" + bytes(2048), 1), r"expected 1 rows of face, got 0"),
        ("a.ply", TEXT.replace(b"7 3 0", b"7 3 inf", 1), r"face: expected numbers for flags"),
        ("a.ply", TEXT.replace(b"7 3 0", b"7 3 1e30", 1), r"expected whole numbers of vertices as corners"),
        ("a.ply", TEXT.replace(b"7 3 0", b"7 3 99", 1), r"expected corners from 0 to 7, got 99"),
        ("a.stl", stl(box(*BOX), text=False)[:-1], r"expected 684 bytes of 12 triangles, got 683"),
        ("a.stl", FACETS.replace(b"vertex -6.0", b"vertex six", 1), r'expected lines "vertex x y z", three'),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", r"line 2: expected vertices 1 to 1, got 3"),
    ],
)
def test_a_damaged_file_is_refused(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=words):
        read_surface(tmp_path / name)


def test_too_many_triangles_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.ply").write_bytes(GOOD)
    monkeypatch.setattr("dream.sim.mesh_files.MOST_TRIANGLES", 11)
    with pytest.raises(ValueError, match=r"expected at most 11 triangles, got 12\. Simplify it"):
        read_surface(tmp_path / "a.ply")


# The command


@pytest.mark.rare
def test_the_command_makes_a_folder_that_can_be_flown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], barge: Made
) -> None:
    (tmp_path / "barge.ply").write_bytes(GOOD)
    folder = tmp_path / "my-wreck"
    command = ["worlds", "--from-mesh", str(tmp_path / "barge.ply"), "--up", "z", "--scale", "1", "--target"]
    assert run_command([*command, "--out", str(folder), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert world_hash(load_world(folder)) == said["hash"] == world_hash(barge.world)
    assert said["patches"] == len(barge.world.targets)
    assert run_command(["worlds", "--check", str(folder)]) == 0
    assert "fit to fly" in capsys.readouterr().out
    flown = ["run", "belief", "--world", str(folder), "--max-steps", "2", "--out", str(tmp_path / "run")]
    assert run_command([*flown, "--json"]) == 0


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--from-mesh", "no.ply"], "no.ply: expected a file with a mesh, got none"),
        (["--from-mesh", "no.ply", "--save", "reef/O"], "--from-mesh: expected it alone, got --save with it"),
        (["--scale", "2"], "--shells, --name, --water: expected --from-mesh FILE with them, got none"),
        (["--water", "turbid", "--shells"], "expected --from-mesh FILE with them, got none"),
    ],
)
def test_the_command_refuses_what_it_does_not_understand(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["worlds", *options]) == 2
    assert words in capsys.readouterr().err


# A real wreck

REAL = os.environ.get("DREAM_REAL_DATA")


@pytest.mark.skipif(REAL is None, reason="DREAM_REAL_DATA names no folder with wreck/sesa_60k.ply")
def test_a_real_wreck_becomes_a_world(tmp_path: Path) -> None:
    assert REAL is not None
    made = world_of(read_surface(Path(REAL) / "wreck/sesa_60k.ply"), "sesa", up="y", scale=1.0)
    world = made.world
    assert made.extents == pytest.approx((59.1, 102.4, 10.2), abs=0.1)
    assert (world.bounds.width, world.bounds.depth) == (84.0, 127.0)
    assert all(Solids(world).free([[start.x, start.y] for start in world.starts], DREAM_V1))
    points = soup(world).reshape(-1, 3)
    assert above(world, points).min() > 0.0
    assert np.median(above(world, points)) < 0.5
    assert points[:, 2].max() <= -COVER
