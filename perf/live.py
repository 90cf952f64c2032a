"""What it costs a mission to be watched: missions with a page open in a browser beside the same without.

    python perf/live.py                  some four minutes; needs the extra `live` and chromium
    python perf/live.py --rounds 16 --world wreck/1

In every round the same mission flies alone, served without anybody looking, and with its page open in a
browser, in an order drawn anew, so that a machine that is busy for a while is so for all three. Wall time is
that of the mission alone (`wall_s` of its summary): world, steps and recording; it holds on a machine that is
idle otherwise. Processor time is what the mission's own process worked, which holds on a busy one, too. The
browser is the costlier part and runs on the same machine here, which it need not do; it is open all the time,
its tab from the moment at which the mission tells its address.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or "chromium"
DRAWS = 10_000
PATIENCE_S = 600.0
START_S = 30.0


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


class Browser:
    """A browser that is open all the time, as a user's is.

    It is asked for tabs and for nothing else: a driver such as Playwright's hears of every request of a page
    and would cost more than the page.
    """

    def __init__(self, profile: str) -> None:
        flags = [
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--remote-debugging-port=0",
        ]
        self._process = subprocess.Popen(
            [CHROMIUM, *flags, f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        told = Path(profile) / "DevToolsActivePort"
        until = time.monotonic() + START_S
        while not (told.is_file() and told.read_text().strip()):
            if time.monotonic() > until:
                self.close()
                raise RuntimeError(f"{CHROMIUM} did not start within {START_S:g} s")
            time.sleep(0.1)
        self._address = f"http://127.0.0.1:{told.read_text().split()[0]}/json"

    @contextlib.contextmanager
    def tab(self, address: str) -> Iterator[None]:
        """A tab with a page, open while the block runs."""
        key = json.loads(self._ask(f"new?{urllib.parse.quote(address)}", "PUT"))["id"]
        try:
            yield
        finally:
            self._ask(f"close/{key}", "GET")

    def _ask(self, what: str, method: str) -> bytes:
        asked = urllib.request.Request(f"{self._address}/{what}", method=method)
        with urllib.request.urlopen(asked, timeout=START_S) as answer:
            told: bytes = answer.read()
        return told

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        self._process.wait()


@contextlib.contextmanager
def flying(mission: list[str], *more: str) -> Iterator[subprocess.Popen[str]]:
    """A mission, always the same; it is ended with the block, or after too long."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as out:
        words = [sys.executable, "-c", FLY, "run", "belief", *mission, "--json", "--out", out, *more]
        flown = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        end = threading.Timer(PATIENCE_S, flown.kill)
        end.start()
        try:
            yield flown
        finally:
            end.cancel()
            flown.kill()
            flown.communicate()


def cost(mission: subprocess.Popen[str]) -> Cost:
    """Of a mission, once it is over."""
    told, said = mission.communicate()
    worked = re.search(r"worked (\S+) (\S+)", said)
    if mission.returncode or worked is None:
        raise RuntimeError(f"the mission failed: {said}")
    return Cost(float(json.loads(told)["wall_s"]), float(worked[1]), float(worked[2]))


def alone(mission: list[str]) -> Cost:
    """A mission that nobody watches."""
    with flying(mission) as flown:
        return cost(flown)


def served(mission: list[str]) -> Cost:
    """A mission with a server that nobody asks for anything."""
    with flying(mission, "--live") as flown:
        return cost(flown)


def watched(mission: list[str], browser: Browser) -> Cost:
    """A mission whose page is open, from the moment at which its address is known."""
    with flying(mission, "--live") as flown:
        said = said_until(flown, r"http://\S+")
        with browser.tab(said):
            # The server stays until the last page is gone: it says so once it knows of one.
            said_until(flown, "until it is closed")
        return cost(flown)


def said_until(mission: subprocess.Popen[str], what: str) -> str:
    """What a mission says that looks like this."""
    assert mission.stderr is not None
    said = ""
    while line := mission.stderr.readline():
        said += line
        if found := re.search(what, line):
            return found[0]
    raise RuntimeError(f"expected the mission to say {what}, got: {said}")


def interval(ratios: list[float], rng: np.random.Generator) -> str:
    """Median and its 95 % interval, by bootstrap."""
    logs = np.log(ratios)
    medians = np.median(logs[rng.integers(0, len(logs), (DRAWS, len(logs)))], axis=1)
    low, high = np.exp(np.percentile(medians, [2.5, 97.5]))
    return f"{np.exp(np.median(logs)):.3f}, 95 % interval {low:.3f} to {high:.3f}"


def main() -> int:
    """Fly the rounds and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=12)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--world", default="reef/string")
    options = parser.parse_args()
    mission = ["--world", options.world, "--protocol", "dream-v1", "--max-steps", str(options.steps)]
    rng = np.random.default_rng(0)
    rounds: list[dict[str, Cost]] = []
    with contextlib.ExitStack() as stack:
        profile = stack.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
        browser = stack.enter_context(contextlib.closing(Browser(profile)))
        arms: dict[str, Callable[[list[str]], Cost]] = {
            "alone": alone,
            "served": served,
            "watched": lambda mission: watched(mission, browser),
        }
        for fly in arms.values():
            fly(mission)  # Compiles what is not compiled yet, and reads the browser's files.
        print("| round | wall alone, s | served | watched | worked alone, s | served | watched | server, s |")
        print("|--:|--:|--:|--:|--:|--:|--:|--:|")
        for number in range(1, options.rounds + 1):
            flown = {arm: arms[arm](mission) for arm in rng.permutation(list(arms))}
            rounds.append(flown)
            walls, works = ([f"{getattr(flown[arm], of):.2f}" for arm in arms] for of in ("wall", "worked"))
            row = [str(number), *walls, *works, f"{flown['watched'].server:.2f}"]
            print(f"| {' | '.join(row)} |", flush=True)
    print()
    for of, name in (("wall", "wall time"), ("worked", "processor time of the mission")):
        for arm in ("served", "watched"):
            ratios = [getattr(flown[arm], of) / getattr(flown["alone"], of) for flown in rounds]
            print(f"{name}, {arm} to alone: median {interval(ratios, rng)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
