"""A scene that grows beside its steps: what the server tells of it, and the page that follows it."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("fastapi")
pytest.importorskip("httpx")
from starlette.testclient import TestClient

from dream.live import folders
from dream.live.doors import Doors
from dream.live.folders import Watched
from dream.live.server import Pages, application
from dream.live.stream import Cursor
from dream.scene import SPACE, RunScene, made, mapped, save
from dream.scene import Path as Way
from tests.live.runs import STEPS, Growing
from tests.live.test_stream import told
from tests.scene.test_building import ABOUT, ball, targets

Make = Callable[..., Growing]


def grown(steps: int) -> RunScene:
    """A ball of which half is inspected at the third step, and a map and a path of so many steps."""
    one = ball(12, (5.0, 5.0, -5.0))
    owner = (one.mean(axis=1)[:, 0] > 5.0).astype(int)
    seen = np.array([2, -1])
    at = np.arange(steps)
    return made(
        **ABOUT,
        targets=replace(targets(one, owner, 2), seen_at=seen, inspected_at=seen),
        voxels=mapped(0.5, np.column_stack([at, at, 0 * at]) * 0.5 - 5.0, at >= 0, at, at * 0 - 1),
        path=Way(
            at.astype(np.int32),
            np.column_stack([at, at * 0, at * 0 - 5]).astype(np.float32),
            (0 * at).astype(np.float32),
            (0 * at).astype(np.float32),
            at < 0,
        ),
    )


def put(run: Growing, steps: int) -> None:
    """The scene as of so many steps, and certainly newer than the one before."""
    path = run.folder / SPACE
    before = path.stat().st_mtime_ns if path.exists() else 0
    save(grown(steps), path)
    after = max(path.stat().st_mtime_ns, before + 1_000_000)
    os.utime(path, ns=(after, after))


def versions(cursor: Cursor, watched: Watched) -> list[dict[str, Any]]:
    watched.look()
    return [data for name, _, data in told(list(cursor.news(watched))) if name == "space"]


def test_a_page_is_told_of_each_version_of_the_scene_of_the_run_it_shows(growing: Make) -> None:
    run = growing().write(STEPS)
    watched = Watched([run.folder])
    watched.look()
    (shown,) = watched
    cursor, other = Cursor(shown.key), Cursor("")
    assert versions(cursor, watched) == []
    put(run, 2)
    (first,) = versions(cursor, watched)
    assert first["run"] == shown.key
    assert versions(cursor, watched) == []
    put(run, 3)
    (second,) = versions(cursor, watched)
    assert second["version"] != first["version"]
    assert versions(other, watched) == []
    # One that comes back is told again, since its position says nothing of scenes.
    assert versions(Cursor.at(cursor.position, shown.key), watched) == [second]


@pytest.fixture
def client(growing: Make) -> Callable[[Growing], tuple[TestClient, str]]:
    def of(run: Growing) -> tuple[TestClient, str]:
        watched = Watched([run.folder])
        watched.look()
        (shown,) = watched
        app = application(Pages(watched), Doors())
        return TestClient(app, base_url="http://localhost:8412"), f"/runs/{shown.key}/space"

    return of


def test_the_scene_is_given_as_a_report_holds_it(growing: Make, client: Callable[..., Any]) -> None:
    run = growing().write(2)
    asking, address = client(run)
    assert asking.get(address).status_code == 404
    put(run, 2)
    answer = asking.get(address)
    assert answer.headers["content-type"] == "application/json"
    assert answer.headers["cache-control"] == "no-store"
    told = answer.json()
    assert told["problem"] is None
    assert told["scene"]["path"]["step"] == [0, 1]
    assert asking.get("/runs/00000000/space").status_code == 404
    (run.folder / SPACE).write_bytes(b"nothing")
    told = asking.get(address).json()
    assert told["scene"] is None
    assert "space.npz: expected a scene" in told["problem"]


def test_a_scene_that_is_too_large_or_lies_elsewhere_is_not_given(
    growing: Make, client: Callable[..., Any], tmp_path: Path
) -> None:
    run = growing().write(2)
    asking, address = client(run)
    put(run, 2)
    os.truncate(run.folder / SPACE, folders.MAX_FILE_BYTES + 1)
    assert asking.get(address).status_code == 404
    put(run, 2)
    assert asking.get(address).status_code == 200
    (run.folder / SPACE).rename(tmp_path / "elsewhere.npz")
    (run.folder / SPACE).symlink_to(tmp_path / "elsewhere.npz")
    assert asking.get(address).status_code == 404
