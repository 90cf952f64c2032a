"""What stands in `examples` works as it is."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from dream.evaluation import runner
from dream.evaluation.report import write_report
from dream.evaluation.results import read_results
from dream.evaluation.runner import simulate
from dream.evaluation.suites import Case
from dream.protocol import DREAM_V1
from dream.sim.world import World
from tests.engines import InProcess

EXAMPLE = Path(__file__).parent.parent / "examples/planner.py"


@contextmanager
def loaded(path: Path) -> Generator[ModuleType, None, None]:
    spec = importlib.util.spec_from_file_location("example_planner", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module")
def example() -> Generator[ModuleType, None, None]:
    with loaded(EXAMPLE) as module:
        yield module


def test_the_planner_to_copy_finds_targets_and_says_why(example: ModuleType, string_reef: World) -> None:
    found = []
    for step in simulate(string_reef, example.Nearby(), DREAM_V1, max_steps=14):
        found.append(int(step.occupancy.target.sum()))
        assert not step.arrival.collided
        assert step.index < 4 or step.decision.reasoning.action
    assert found[-1] > found[3]
    with pytest.raises(ValueError, match="elsewhere: expected"):
        example.Nearby(elsewhere=2.0)


def test_it_is_benched_beside_those_of_the_package(
    example: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = []

    class Shown:
        def print(self) -> None:
            flown.append(read_results(tmp_path))

    def fly(plan: runner.Plan, folder: Path, engine: object) -> Shown:
        short = replace(plan, cases=plan.cases[:1], max_steps=6)
        assert len(list(runner.fly_plan(short, tmp_path, InProcess()))) == 3
        write_report(tmp_path)
        return Shown()

    monkeypatch.setattr(example, "fly", fly)
    example.main()
    (results,) = flown
    assert {row.planner for row in results.rows} == {"nearby", "belief", "frontier"}
    assert results.manifest["planners"]["nearby"]["beside"] == 2.0
    assert "nearby" in (tmp_path / "report.html").read_text()


def test_missions_of_a_planner_whose_file_has_changed_are_not_taken_for_its_own(tmp_path: Path) -> None:
    mine, folder = tmp_path / "mine.py", tmp_path / "bench"
    mine.write_bytes(EXAMPLE.read_bytes())

    def fly() -> None:
        with loaded(mine) as module:
            planners = {"nearby": module.Nearby()}
            plan = runner.Plan("mine", (Case("flat/empty", 1),), planners, DREAM_V1, max_steps=4)
            assert len(list(runner.fly_plan(plan, folder, InProcess()))) == 1

    fly()
    fly()
    mine.write_text(EXAMPLE.read_text().replace("np.where(near, 1.0,", "np.where(near, 0.01,"))
    with pytest.raises(ValueError, match=r"files of nearby\.code: expected \w{64} as for the missions in it"):
        fly()
