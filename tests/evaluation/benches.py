"""Made benchmark folders: what missions are written down as, without flying them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dream.evaluation.metrics import MILESTONES, curve
from dream.evaluation.oracle.bounds import Limit, OracleBounds
from dream.evaluation.results import Flown, Row, Trace, write_manifest, write_tables
from dream.evaluation.suites import SUITES, Case
from dream.types import LOOK_AROUND

Planners = Sequence[str] | Mapping[str, Mapping[str, Any]]
"""Names of planners, or their parameters by name."""
CAP = 200
PAPER = SUITES["paper"]


@dataclass(frozen=True)
class Made:
    """A planner that sees everything at a constant rate until it stops."""

    full_at: float
    """Steps to see all instances."""
    stops_at: int | None = None
    """None: it goes on to the cap."""
    collides_at: int | None = None


def flown(
    case: Case,
    planner: str,
    made: Made,
    *,
    cap: int = CAP,
    protocol: str = "dream-v1",
    world_hash: str = "made",
    **changes: Any,
) -> Flown:
    """A mission whose row and trace agree; `changes` overwrite the row."""
    steps = cap if made.stops_at is None else min(made.stops_at, cap)
    seen = np.minimum(np.arange(steps + 1) / made.full_at, 1.0).round(6)
    angle = 0.15 * np.arange(steps + 1) + len(planner)
    reach = 0.09 * np.arange(steps + 1)
    collided = np.zeros(steps + 1, bool)
    if made.collides_at is not None:
        collided[made.collides_at] = True
    trace = Trace(
        x=(reach * np.cos(angle)).round(3),
        y=(reach * np.sin(angle)).round(3),
        yaw_deg=np.degrees(angle).round(3),
        instances=seen,
        collided=collided,
    )
    marks = {
        name: next((k for k, share in enumerate(seen) if share >= mark), None)
        for name, mark in MILESTONES.items()
    }
    done = made.stops_at is not None and made.stops_at <= cap
    values: dict[str, Any] = {
        "protocol": protocol,
        "world": case.world,
        "seed": case.seed,
        "start": case.start,
        "world_hash": world_hash,
        "planner": planner,
        "ended": "done" if done else "cap",
        "steps": steps,
        "t_stop": steps if done else None,
        "t_claimed": steps if done else None,
        **marks,
        "instances": float(seen[-1]),
        "clusters": float(seen[-1]),
        "area": float(seen[-1]),
        "visible": float(seen[-1]),
        "countable": 400,
        "collisions": int(collided.sum()),
        "distance_m": float(np.hypot(np.diff(trace.x), np.diff(trace.y)).sum().round(3)),
        "turns": steps // 2,
        "guarded": 3,
        "min_clearance_m": 0.41,
        "planner_ms_p50": 12.5,
        "planner_ms_p99": 80.0,
        **curve([float(share) for share in seen], cap),
        "vlm_calls": None,
        "vlm_tokens": None,
        "vlm_cost_usd": None,
        "vlm_fallbacks": None,
        "vlm_waited_s": None,
        "mission_s": 10.0 * steps,
        "vlm_questions": None,
        "why": None,
        "cap": cap,
        "success": done and marks["t98"] is not None and not collided.any(),
        "wall_s": 1.5,
    }
    return Flown(Row(**(values | changes)), trace)


def manifest(cases: Sequence[Case], planners: Planners, **changes: Any) -> dict[str, Any]:
    """`manifest.json` of a benchmark."""
    parameters = planners if isinstance(planners, Mapping) else {name: {"pace": 1.5} for name in planners}
    return {
        "suite": "paper",
        "cases": [{"world": case.world, "seed": case.seed, "start": case.start} for case in cases],
        "planners": dict(parameters),
        "protocol": {"name": "dream-v1", "cap": CAP, "reach": 8.0, "cell": 0.25, "lattice": 0.5},
        "max_steps": None,
        "engine": "Processes(2)",
        "version": "0.1.0",
        "commit": "0123abc",
        "source": "5eed" * 16,
        "python": "3.11.7",
        "numpy": "2.4.6",
        "numba": "0.68.1",
        "scipy": "1.17.1",
        "machine": {"cpu": "A processor", "cores": 2, "memory_gb": 8.0, "os": "Linux"},
        "started": "2026-01-02T03:04:05+00:00",
        "finished": "2026-01-02T04:05:06+00:00",
        "wall_s": 3661.0,
        **changes,
    }


GPT: Mapping[str, Any] = {"model": "openai:gpt", "model_name": "", "latency": 12.0, "max_calls": None}
"""Parameters of a planner that asks a model."""
ASKED: Mapping[str, Any] = {
    "vlm_calls": 60,
    "vlm_tokens": 90_000,
    "vlm_cost_usd": 0.5,
    "vlm_fallbacks": 2,
    "vlm_waited_s": 720.0,
    "mission_s": 960.0,
    "vlm_questions": 50,
}
"""Of the row of a mission that asked a model."""


def write_bench(
    folder: Path, missions: Sequence[Flown], cases: Sequence[Case], planners: Planners, **changes: Any
) -> Path:
    """A benchmark folder."""
    write_manifest(folder, manifest(cases, planners, **changes))
    write_tables(folder, missions)
    return folder


PACES: Mapping[str, float] = {"sixsteps": 60.0, "lawnmower": 120.0, "frontier": 150.0, "random": 260.0}


def paper_missions(planners: Mapping[str, float] = PACES, cases: Sequence[Case] = PAPER) -> list[Flown]:
    """Every planner at its pace, which a world changes for all alike and a little for each."""
    rng = np.random.default_rng(7)
    found = []
    for case in cases:
        world = math.exp(0.3 * rng.standard_normal())
        for planner, pace in planners.items():
            full = pace * world * math.exp(0.15 * rng.standard_normal())
            stops = None if planner == "random" else math.ceil(full) + 12
            hit = 40 if planner == "frontier" and case.seed == 1 and case.world.startswith("reef/L") else None
            found.append(flown(case, planner, Made(full, stops, hit)))
    return found


def bounds(case: Case, t98: tuple[int, int | None], full: tuple[int, int | None]) -> OracleBounds:
    """Bounds that nobody certified: lower bound and best tour of each share."""
    of_full, of_t98 = (
        Limit(lower, tour, (), (0,) * (tour - LOOK_AROUND) if tour is not None else ())
        for lower, tour in (full, t98)
    )
    return OracleBounds(
        case.world, case.seed, case.start, "dream-v1", "made", 400, of_full, of_t98, cpu_s=1.0
    )
