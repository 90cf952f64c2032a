"""What it costs a mission to be watched: missions with a page open in a browser beside the same without.

    python perf/live.py                  some five minutes; needs the extra `live`, playwright and chromium
    python perf/live.py --pairs 12 --steps 80

The two of a pair fly one after the other, in alternating order, so that a machine that is busy for a while is
so for both. Wall time is that of the mission alone (`wall_s` of its summary): world, steps and recording; it
holds on a machine that is idle otherwise. Processor time is what the mission's own process worked, which
holds on a busy one, too. The browser is the costlier part and runs on the same machine here, which it need
not do.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from playwright.sync_api import Browser, sync_playwright

DRAWS = 10_000
PATIENCE_S = 600.0


# Flies, and says on standard error how long its process worked, and how long that of its server did.
FLY = """
import resource, sys, time
from dream.cli import run_command
status = run_command(sys.argv[1:])
server = resource.getrusage(resource.RUSAGE_CHILDREN)
print("worked", time.process_time(), server.ru_utime + server.ru_stime, file=sys.stderr)
sys.exit(status)
"""


@dataclass(frozen=True, slots=True)
class Cost:
    """What a mission took, in seconds."""

    wall: float
    worked: float
    server: float
    shown: int = 0
    """How often the page showed another step."""


def flying(out: str, steps: int, *more: str) -> subprocess.Popen[str]:
    """A mission of `steps` steps, always the same."""
    fixed = ["run", "belief", "--world", "reef/string", "--max-steps", str(steps), "--json", "--out", out]
    words = [sys.executable, "-c", FLY, *fixed, *more]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def cost(mission: subprocess.Popen[str], shown: int = 0) -> Cost:
    """Of a mission, once it is over."""
    told, said = mission.communicate(timeout=PATIENCE_S)
    worked = re.search(r"worked (\S+) (\S+)", said)
    if mission.returncode or worked is None:
        raise RuntimeError(f"the mission failed: {said}")
    return Cost(float(json.loads(told)["wall_s"]), float(worked[1]), float(worked[2]), shown)


def alone(steps: int) -> Cost:
    """A mission that nobody watches."""
    with tempfile.TemporaryDirectory() as out:
        return cost(flying(out, steps))


def watched(steps: int, browser: Browser) -> Cost:
    """A mission that a browser watches."""
    with tempfile.TemporaryDirectory() as out:
        mission = flying(out, steps, "--live")
        assert mission.stderr is not None
        found: re.Match[str] | None = None
        while found is None and (line := mission.stderr.readline()):
            found = re.search(r"http://\S+", line)
        if found is None:
            raise RuntimeError("the mission told no address")
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(found[0])
        seen: set[str] = set()
        until = time.monotonic() + PATIENCE_S
        while not list(Path(out).glob("*/summary.json")) and time.monotonic() < until:
            seen.add(page.inner_text("#counter"))
            time.sleep(0.2)
        page.close()
        return cost(mission, len(seen))


def interval(ratios: list[float], rng: np.random.Generator) -> str:
    """Median and its 95 % interval, by bootstrap."""
    logs = np.log(ratios)
    medians = np.median(logs[rng.integers(0, len(logs), (DRAWS, len(logs)))], axis=1)
    low, high = np.exp(np.percentile(medians, [2.5, 97.5]))
    return f"{np.exp(np.median(logs)):.3f}, 95 % interval {low:.3f} to {high:.3f}"


def main() -> int:
    """Fly the pairs and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=8)
    parser.add_argument("--steps", type=int, default=60)
    options = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    alone(8)  # Compiles what is not compiled yet.
    walls: list[float] = []
    works: list[float] = []
    with sync_playwright() as playwright:
        quiet = ["--no-sandbox", "--disable-gpu"]
        print("| pair | wall alone, s | watched | worked alone, s | watched | server, s | steps shown |")
        print("|--:|--:|--:|--:|--:|--:|--:|")
        for pair in range(options.pairs):
            browser = playwright.chromium.launch(executable_path=chromium, args=quiet)
            if pair % 2:
                plain, seen = alone(options.steps), watched(options.steps, browser)
            else:
                seen, plain = watched(options.steps, browser), alone(options.steps)
            browser.close()
            walls.append(seen.wall / plain.wall)
            works.append(seen.worked / plain.worked)
            print(
                f"| {pair + 1} | {plain.wall:.2f} | {seen.wall:.2f} | {plain.worked:.2f} | "
                f"{seen.worked:.2f} | {seen.server:.2f} | {seen.shown} |",
                flush=True,
            )
    rng = np.random.default_rng(0)
    print(f"\nwall time, watched to alone: median {interval(walls, rng)}")
    print(f"processor time of the mission: median {interval(works, rng)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
