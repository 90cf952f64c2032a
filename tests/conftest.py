"""Worlds and flown missions that several tests share; each is made once."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache

import pytest
from hypothesis import settings

from dream.evaluation.runner import simulate
from dream.planning import SixSteps
from dream.protocol import DREAM_V1
from dream.sim.render import Renderer
from dream.sim.render.ground import ground_map
from dream.sim.render.scene import build_scene
from dream.sim.visibility import Visibility
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Step

# No test may ask a model that is not on this machine.
os.environ["DREAM_OFFLINE"] = "1"

# A shell has what runs in its background ignore Ctrl-C, which some tests press.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The first call of a kernel compiles it or reads it from disk, which no deadline should judge.
# `make test` draws the same examples each time, so that red means the change; `make test-slow` draws others.
settings.register_profile("dream", deadline=None, max_examples=50, derandomize=True, database=None)
settings.register_profile("search", deadline=None, max_examples=200)
settings.load_profile("dream")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a test that is marked `few`, make all cases rare but so many: the first, the last, some between.

    Files with slow tests begin first, then those of many: at the end no process waits for another.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    count = Counter(item.path for item in items)
    items.sort(key=lambda item: (item.path not in slow, -count[item.path], item.path))
    cases: dict[str, list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("few") and not item.get_closest_marker("rare"):
            cases.setdefault(item.nodeid.partition("[")[0], []).append(item)
    for alike in cases.values():
        mark = alike[0].get_closest_marker("few")
        assert mark is not None
        (count,) = mark.args
        kept = {round(n * (len(alike) - 1) / max(count - 1, 1)) for n in range(count)}
        for number, item in enumerate(alike):
            if number not in kept:
                item.add_marker("rare")


def pytest_collection_finish() -> None:
    """Have the garbage collector come rarely: going through all that was imported took a 30th of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 100)


@pytest.fixture(scope="session", autouse=True)
def progress_is_not_told_by_the_machines_clock() -> Iterator[None]:
    """What a command prints must not depend on how fast this machine is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dream.commands.progress.EVERY", 86400.0)
        yield


@pytest.fixture(scope="session", autouse=True)
def what_is_kept_of_worlds_is_not_the_users(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Nor is anything taken that another version of the rules has worked out."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DREAM_CACHE", str(tmp_path_factory.mktemp("kept")))
        yield


@pytest.fixture(scope="session", autouse=True)
def worlds_are_prepared_once() -> Iterator[None]:
    """For the camera of a robot and for scores, where the very same world is flown again and again.

    Neither changes by being asked, and `test_a_world_that_is_used_again_gives_the_same_mission` holds them
    to it.
    """
    with pytest.MonkeyPatch.context() as patch:
        prepared = lru_cache(maxsize=4)(Renderer)
        patch.setattr("dream.robots.camera.Renderer", prepared)
        patch.setattr("dream.evaluation.metrics.Renderer", prepared)
        patch.setattr("dream.evaluation.metrics.Visibility", lru_cache(maxsize=4)(Visibility))
        yield


@pytest.fixture(scope="module")
def worlds_are_made_once() -> Iterator[None]:
    """For tests of commands, each of which makes its world and prepares what the camera shows of it.

    Not for tests that ask whether the same name makes the same world.
    """
    with pytest.MonkeyPatch.context() as patch:
        made = lru_cache(maxsize=8)(make_world)
        patch.setattr("dream.sim.worlds.make_world", made)
        patch.setattr("dream.evaluation.suites.make_world", made)
        patch.setattr("dream.sim.render.rasterizer.build_scene", lru_cache(maxsize=4)(build_scene))
        patch.setattr("dream.sim.render.shading.ground_map", lru_cache(maxsize=4)(ground_map))
        yield


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """The curves of a benchmark are left out, which take most of the time and say nothing in words."""
    monkeypatch.setattr("dream.evaluation.figures.Picture._bytes", lambda *_, **__: b"<svg/>")


@pytest.fixture(scope="session")
def string_reef() -> World:
    """The reef of `make run`."""
    return make_world("reef/string", 1)


@pytest.fixture(scope="session")
def empty_world() -> World:
    """Flat sand and nothing else."""
    return make_world("flat/empty", 1)


@pytest.fixture(scope="session")
def short_mission(string_reef: World) -> list[Step]:
    """Twelve steps of `sixsteps` on the string reef; the map in every step is the final one."""
    return list(simulate(string_reef, SixSteps(), DREAM_V1, max_steps=12))
