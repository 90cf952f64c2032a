from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dream.scene import NEVER, RunScene, SceneState, SceneSurface, Voxels, mapped
from dream.scene.parts import LEGEND

Array = npt.NDArray[Any]

TRIANGLE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], np.float32)


def test_an_individual_is_seen_and_inspected_from_its_steps_on(wreck: RunScene) -> None:
    last = int(wreck.path.step[-1])
    state = wreck.states(last)
    assert (state == SceneState.INSPECTED).sum() == (wreck.inspected_at <= last).sum() > 100
    assert (state == SceneState.UNSEEN).sum() == (wreck.seen_at == NEVER).sum() > 100
    first = int(wreck.inspected_at.min())
    one = int(wreck.inspected_at.argmin())
    assert wreck.states(first)[one] == SceneState.INSPECTED
    assert wreck.states(first - 1)[one] != SceneState.INSPECTED


def test_a_voxel_is_what_it_was_at_a_step() -> None:
    voxels = mapped(0.5, [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [True, True, False], [2, 2, 0], [4, -1, -1])
    assert voxels.states(1).tolist() == [SceneState.UNSEEN, SceneState.UNSEEN, SceneState.OTHER]
    assert voxels.states(3).tolist() == [SceneState.SEEN, SceneState.SEEN, SceneState.OTHER]
    assert voxels.states(4).tolist() == [SceneState.INSPECTED, SceneState.SEEN, SceneState.OTHER]


@pytest.mark.parametrize(
    ("faces", "owner", "why"),
    [
        ([[0, 1, 3]], [0, 0, 0], "faces: expected 0 to 2"),
        ([[0, 1, 2]], [0, 0, 1], "expected the corners of a face to belong to one"),
        ([[0, 1, 2]], [0, 0], "owner: expected"),
    ],
)
def test_a_surface_that_contradicts_itself_is_refused(
    faces: list[list[int]], owner: list[int], why: str
) -> None:
    with pytest.raises(ValueError, match=why):
        SceneSurface(TRIANGLE, np.array(faces, np.int32), np.array(owner, np.int32))


def test_positions_that_are_no_place_are_refused() -> None:
    for bad in (np.nan, np.inf, 1e6):
        with pytest.raises(ValueError, match="finite metres"):
            SceneSurface(TRIANGLE + np.float32(bad), np.array([[0, 1, 2]], np.int32), np.zeros(3, np.int32))
        with pytest.raises(ValueError, match="finite metres"):
            mapped(0.5, [[bad, 0.0, 0.0]], [True], [0], [-1])


def test_a_scene_whose_parts_do_not_fit_is_refused(wreck: RunScene) -> None:
    with pytest.raises(ValueError, match="owner of targets"):
        replace(wreck, kind=wreck.kind[:5], seen_at=wreck.seen_at[:5], inspected_at=wreck.inspected_at[:5])
    with pytest.raises(ValueError, match="seen_at"):
        replace(wreck, seen_at=wreck.seen_at[:5])
    with pytest.raises(ValueError, match="kind: expected 0 to -1"):
        replace(wreck, kinds=())
    with pytest.raises(ValueError, match="expected a box"):
        replace(wreck, bounds=wreck.bounds[::-1].copy())
    with pytest.raises(ValueError, match="expected rising numbers of steps"):
        replace(wreck.path, step=wreck.path.step[::-1].copy())
    with pytest.raises(ValueError, match="expected a size"):
        replace(wreck.voxels, size=0.0)
    with pytest.raises(ValueError, match="at most 65000"):
        Voxels(0.001, np.array([[0, 0, 0], [99, 0, 0]], np.float32), np.ones(2, bool), *two())


def two() -> tuple[Array, Array]:
    return np.zeros(2, np.uint16), np.full(2, NEVER, np.uint16)


def test_the_states_differ_in_grey() -> None:
    """CIE lightness, which a shaded face still shows: 15 apart at least."""
    linear = np.array([color for _, color in LEGEND.values()]) / 255.0
    linear = np.where(linear <= 0.04045, linear / 12.92, ((linear + 0.055) / 1.055) ** 2.4)
    lightness = 116.0 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16.0
    _, unseen, seen, inspected = lightness
    assert unseen + 15.0 < seen
    assert seen + 15.0 < inspected
    assert min(abs(lightness[0] - others) for others in lightness[1:]) > 5.0
