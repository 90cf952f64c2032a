"""How far a model's word goes in `ranked`: steps with advisers that know the world, and with bad ones.

    python perf/advice.py --out advice.jsonl       twelve reefs of `dev`, eight pilots; some fifteen minutes
    python perf/advice.py --out a.jsonl --advisers random --worlds reef/string:103 reef/patch:103

Every adviser is a server on this machine, asked over the wire as any model is. `knowing` ranks by what
really is to be seen from each place, `random` anyhow, `first` by number, `last` against it; `doubting` is
`first` and never holds the mission to be complete; `opposed` puts the places last that the table makes look
best; `silent` never answers; `wire:error:0.5` and the like are the stand-in that comes with the package.
`belief` flies alone. Missions that are in the file are not flown again. Ratios are to `belief`, world by
world, with intervals at 95 % by resampling the worlds.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from dream.evaluation import statistics
from dream.evaluation.metrics import Scorer
from dream.evaluation.runner import simulate
from dream.planning import PLANNERS, AnyPlanner, Asking, Belief
from dream.planning.vlm import Ranked
from dream.planning.vlm.reply import STEPS
from dream.protocol import DREAM_V1
from dream.sim.visibility import Visibility
from dream.sim.worlds import make_world
from dream.standin import chat
from dream.standin.chat import Json
from dream.standin.faults import Delivery
from dream.standin.server import ModelStandIn

ADVISERS = ("silent", "knowing", "random", "first", "last", "doubting", "opposed")
WORLDS = [f"reef/{kind}:{seed}" for seed in (103, 104) for kind in ("string", "patch", "mixed", "fringing")]
WORLDS += ["reef/L:103", "reef/K:103", "reef/S:104", "reef/E:104"]
ROW = re.compile(
    r"^\| (\d+) \| \((\S+), (\S+)\) \| (\d+) \| (\d+) degrees \(\w+\) \| (\S+) \| (\S+)", re.MULTILINE
)
"""Number, position, steps, heading, expected targets and cleared ground in the table of places."""


@dataclass
class Truth:
    """What is left to be seen, for the adviser who knows."""

    visibility: Visibility
    seen: npt.NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        self.seen = np.zeros(len(self.visibility.countable), np.bool_)

    def rate(self, x: float, y: float, yaw: float, steps: float) -> float:
        """Individuals that a place shows for each step there."""
        shows = self.visibility.seen(np.array([[x, y, yaw]]))[0]
        return float((shows & self.visibility.countable & ~self.seen).sum()) / max(steps, 1.0)

    @property
    def complete(self) -> bool:
        """Nothing is left."""
        return bool(self.seen[self.visibility.countable].all())


def advice(adviser: str, question: str, truth: Truth) -> dict[str, Any]:
    """What an adviser says to a question."""
    rows = {int(number): [float(cell) for cell in cells] for number, *cells in ROW.findall(question)}
    numbers, confidence, complete = sorted(rows), 1.0, adviser not in ("doubting", "opposed")
    if adviser == "knowing":
        worth = {n: truth.rate(x, y, np.radians(h), steps) for n, (x, y, steps, h, *_) in rows.items()}
        numbers.sort(key=lambda n: -worth[n])
        # Without anything to be seen from any of them it knows no better than the planner.
        confidence, complete = float(max(worth.values()) > 0.0), truth.complete
    elif adviser == "random":
        digest = hashlib.sha256(question.encode()).digest()
        rng = np.random.default_rng(int.from_bytes(digest[:8]))
        numbers, confidence = rng.permutation(numbers).tolist(), float(rng.random())
        complete = bool(rng.integers(2))
    elif adviser == "opposed":
        numbers.sort(key=lambda n: (rows[n][4] + 0.05 * rows[n][5]) / max(rows[n][2], 1.0))
    elif adviser == "last":
        numbers.reverse()
    said = dict.fromkeys(STEPS, "None.")
    return {**said, "ranking": numbers, "confidence": confidence, "mission_complete": complete}


class Adviser(ModelStandIn):
    """Speaks as models do, and says what an adviser says."""

    def __init__(self, name: str, truth: Truth) -> None:
        super().__init__()
        self.name, self.truth = name, truth
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def reply(self, request: Json) -> Delivery:
        """Advice; nothing of use from who is silent."""
        if self.name == "silent":
            return Delivery(chat.error("silent", "No word."), 418)
        content = json.dumps(advice(self.name, request["messages"][-1]["content"][-1]["text"], self.truth))
        return Delivery(json.dumps(chat.completion(content, chat.asked(request))).encode())


def fly(planner: str, adviser: str, world_name: str, seed: int) -> dict[str, Any]:
    """One mission."""
    world = make_world(world_name, seed)
    visibility = Visibility(world, DREAM_V1)
    truth, scorer = Truth(visibility), Scorer(world, DREAM_V1, visibility=visibility)
    server = Adviser(adviser, truth)
    chosen: AnyPlanner = Belief()
    if adviser.startswith("wire"):
        chosen = Asking(model=adviser).given_to(PLANNERS[planner])
    elif adviser != "belief":
        chosen = Ranked(model=server.address, model_name=adviser)
    asked = followed = 0
    for step in simulate(world, chosen, DREAM_V1):
        scorer.add(step)
        pose = step.observation.pose
        truth.seen |= visibility.seen(np.array([[pose.x, pose.y, pose.yaw]]))[0]
        asked += len(step.decision.exchanges)
        followed += "The model ranked place" in step.decision.reasoning.next_target
    server.shutdown()
    server.server_close()
    summary = scorer.summary()
    return {
        "adviser": adviser,
        "world": f"{world_name}:{seed}",
        "t98": summary["t98"] or DREAM_V1.cap,
        "stop": summary["t_stop"] or DREAM_V1.cap,
        "seen": summary["coverage"]["instances"],
        "collisions": summary["collisions"],
        "asked": asked,
        "followed": followed,
    }


def told(missions: Sequence[dict[str, Any]], alone: Sequence[dict[str, Any]]) -> str:
    """A line of the table."""
    cells = [missions[0]["adviser"], str(len(missions))]
    for mark in ("t98", "stop"):
        ours, theirs = (np.array([m[mark] for m in flown], float) for flown in (missions, alone))
        weights = statistics.resampling_weights(["all"] * len(ours), np.random.default_rng(0))
        ratio, error = ours.sum() / theirs.sum(), ((weights @ ours) / (weights @ theirs)).std(ddof=1)
        margin = float(stats.t.ppf(0.975, len(ours) - 1)) * error
        cells += [f"{ours.mean():.1f}", f"{ratio:.2f} [{ratio - margin:.2f}, {ratio + margin:.2f}]"]
    cells.append(f"{100.0 * float(np.mean([m['seen'] for m in missions])):.2f}")
    cells.append(str(sum(m["collisions"] for m in missions)))
    cells += [f"{np.mean([m[k] for m in missions]):.1f}" for k in ("asked", "followed")]
    return "| " + " | ".join(cells) + " |"


def main() -> int:
    """Fly what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="file of finished missions, a line each")
    parser.add_argument(
        "--advisers", nargs="+", default=list(ADVISERS), help=f"of {', '.join(ADVISERS)}, wire"
    )
    parser.add_argument(
        "--planner", default="ranked", choices=["dream", "vanilla", "ranked"], help="with wire"
    )
    parser.add_argument("--worlds", nargs="+", default=WORLDS, help="reefs or wrecks, as NAME:SEED")
    options = parser.parse_args()
    for name in options.advisers:
        if name not in ADVISERS and not name.startswith("wire"):
            parser.error(f"--advisers: expected some of {', '.join(ADVISERS)}, wire, wire:FAULT, got {name}")
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    flown = {(m["adviser"], m["world"]): m for m in map(json.loads, lines)}
    pilots = ["belief", *options.advisers]
    for number, (pilot, world) in enumerate([(p, w) for p in pilots for w in options.worlds], start=1):
        if (pilot, world) not in flown:
            name, _, seed = world.partition(":")
            flown[pilot, world] = mission = fly(options.planner, pilot, name, int(seed))
            with options.out.open("a") as file:
                file.write(json.dumps(mission) + "\n")
        print(f"\r{number}/{len(pilots) * len(options.worlds)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    columns = [
        *("adviser", "worlds", "98.26 % seen", "to belief", "own stop", "to belief", "seen, %"),
        *("contacts", "asked", "steps followed"),
    ]
    print("| " + " | ".join(columns) + " |\n|---|" + "--:|" * (len(columns) - 1))
    alone = [flown["belief", world] for world in options.worlds]
    for pilot in pilots:
        print(told([flown[pilot, world] for world in options.worlds], alone))
    return 0


if __name__ == "__main__":
    sys.exit(main())
