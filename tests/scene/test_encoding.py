from __future__ import annotations

import base64
import json
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.scene import NEVER, RunScene, encoded, made, mapped
from dream.scene.encoding import SIDES, exposed
from tests.scene.test_building import ABOUT, ball, targets

Array = npt.NDArray[Any]


def unpacked(packed: dict[str, str]) -> Array:
    numbers: Array = np.frombuffer(base64.b64decode(packed["data"]), "<" + packed["type"])
    return numbers


def positions(told: dict[str, Any], name: str) -> Array:
    steps = unpacked(told["surfaces"][name]["positions"]).reshape(-1, 3)
    found: Array = np.array(told["low"]) + steps * told["step"]
    return found


def test_surfaces_come_back_to_half_a_sixteenth_bit(wreck: RunScene) -> None:
    told = json.loads(json.dumps(encoded(wreck), allow_nan=False))
    for name, surface in (
        ("obstacles", wreck.obstacles),
        ("seabed", wreck.seabed),
    ):
        assert np.abs(positions(told, name) - surface.positions).max() < 0.51 * max(told["step"])
        faces = unpacked(told["surfaces"][name]["faces"]).reshape(-1, 3)
        np.testing.assert_array_equal(faces, surface.faces)
    assert max(told["step"]) < 1e-3  # metres
    # The vertices of targets may change their order, the triangles not.
    faces = unpacked(told["surfaces"]["targets"]["faces"]).reshape(-1, 3)
    found = positions(told, "targets")[faces]
    assert np.abs(found - wreck.targets.triangles).max() < 0.51 * max(told["step"])


def test_each_vertex_belongs_to_its_individual(wreck: RunScene) -> None:
    shuffled = np.random.default_rng(1).permutation(len(wreck.targets.positions))
    place = np.argsort(shuffled).astype(np.int32)
    surface = replace(
        wreck.targets,
        positions=wreck.targets.positions[shuffled],
        owner=wreck.targets.owner[shuffled],
        faces=place[wreck.targets.faces],
    )
    told = encoded(replace(wreck, targets=surface))
    owner = np.repeat(np.arange(len(wreck.kind)), unpacked(told["vertices"]))
    faces = unpacked(told["surfaces"]["targets"]["faces"]).reshape(-1, 3)
    np.testing.assert_array_equal(owner[faces[:, 0]], wreck.targets.face_owner)
    np.testing.assert_array_equal(unpacked(told["seen_at"]), wreck.seen_at)


def test_a_side_is_exposed_where_nothing_was_mapped_by_then() -> None:
    cells = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 2], [0, 0, 1]])
    voxels = mapped(0.5, cells * 0.5 + 3.0, [True] * 4, [0, 5, 0, 9], [-1] * 4)
    sides = exposed(voxels)

    def hidden(voxel: int) -> set[tuple[int, int, int]]:
        return {side for bit, side in enumerate(SIDES) if not (sides[voxel] >> bit) & 1}

    assert hidden(0) == set()  # Its neighbours come later.
    assert hidden(1) == {(-1, 0, 0)}
    assert hidden(3) == {(0, 0, 1), (0, 0, -1)}


def test_exposed_sides_are_those_of_a_slow_twin(wreck: RunScene) -> None:
    voxels = wreck.voxels
    _, cells = voxels.cells()
    seen = {tuple(cell): at for cell, at in zip(cells.tolist(), voxels.seen_at.tolist(), strict=True)}
    for cell, at, bits in list(zip(cells.tolist(), voxels.seen_at.tolist(), exposed(voxels), strict=True))[
        ::7
    ]:
        beside = [seen.get(tuple(np.add(cell, side).tolist()), NEVER) for side in SIDES]
        assert [not (bits >> bit) & 1 for bit in range(6)] == [then <= at for then in beside]


def test_two_hundred_thousand_faces_take_a_few_megabytes() -> None:
    one = 4.0 * ball(224, (1.2, 1.2, -1.2))
    scene = made(**ABOUT, targets=targets(one, np.zeros(len(one), int), 1))
    assert 195_000 < len(scene.targets.faces) <= 200_000
    assert len(json.dumps(encoded(scene))) < 4.2e6


def test_an_empty_scene_has_no_surface_and_no_voxels() -> None:
    told = encoded(made(**ABOUT))
    assert told["surfaces"] == {}
    assert told["voxels"] is None
    assert told["path"]["step"] == []


@pytest.mark.parametrize("count", [1, 300])
def test_text_of_a_scene_is_text(count: int, wreck: RunScene) -> None:
    told = encoded(replace(wreck, title="</script>" * count, kinds=("<b>",)))
    assert told["title"].startswith("</script>")
    assert told["kinds"] == ["<b>"]
