"""Golden missions: what a planner does in a world must not change unless a change says why.

Run this file as a program to write the recorded missions anew: `python -m tests.golden.test_missions`.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.planning import PLANNERS
from dream.protocol import protocol_named
from tests.sim.made import made

FOLDER = Path(__file__).parent
STEPS = 30
MISSIONS = [
    ("belief", "reef/string", 1),
    ("belief", "wreck/5", 1),
    ("sixsteps", "reef/string", 1),
    ("sixsteps", "wreck/5", 1),
    ("lawnmower", "reef/K", 1),
    ("belief", "pool/arc", 1),
]


def mission(planner: str, name: str, seed: int) -> dict[str, Any]:
    """Path, coverage and map of thirty steps."""
    world = made(name, seed)
    protocol = protocol_named(world.protocol)
    scorer, path = Scorer(world, protocol), []
    for step in simulate(world, PLANNERS[planner], protocol, max_steps=STEPS):
        coverage = scorer.add(step)
        pose = step.observation.pose
        path.append([pose.x, pose.y, round(math.degrees(pose.yaw))])
    return {"path": path, "coverage": coverage.as_dict(), "areas": step.occupancy.areas()}


def _file(planner: str, name: str, seed: int) -> Path:
    return FOLDER / f"{planner}_{name.replace('/', '-')}-{seed}.json"


@pytest.mark.few(3)
@pytest.mark.parametrize(("planner", "name", "seed"), MISSIONS)
def test_a_golden_mission_has_not_moved(planner: str, name: str, seed: int) -> None:
    golden = json.loads(_file(planner, name, seed).read_text())
    flown = mission(planner, name, seed)
    assert flown["path"] == golden["path"]
    # A rounding of the last bit may move a pixel across the edge of a cell, not more.
    assert flown["coverage"] == pytest.approx(golden["coverage"], abs=0.002)
    assert flown["areas"] == pytest.approx(golden["areas"], rel=0.01)


if __name__ == "__main__":
    for case in MISSIONS:
        _file(*case).write_text(json.dumps(mission(*case), indent=None) + "\n")
