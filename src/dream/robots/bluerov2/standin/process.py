"""A stand-in in a process of its own, and what may be asked of it there: it has a core to itself."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

import numpy as np

from dream.geometry import SE3

STARTS = 180.0
"""Seconds that a start may take: its code is compiled at the first."""
ANSWERS = 5.0
"""Seconds that an answer may take."""


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """What only the stand-in knows."""

    time: float
    """Seconds of its own clock."""
    T_world_base: SE3
    collisions: int
    behind: float
    """Seconds that it was behind real time, at most."""


class StandInProcess:
    """Starts a stand-in and answers for it.

    What it does: the process prints where its sockets are, then answers one line of JSON for each that it is
    asked, and ends when its input does, so that it never outlives whoever began it.
    """

    def __init__(
        self,
        world: str,
        seed: int,
        *,
        ground: tuple[str, int],
        video: tuple[str, int],
        options: tuple[str, ...] = (),
    ) -> None:
        """Begin to start it.

        Args:
            world: Where.
            seed: Of the world, and of all that is drawn.
            ground: UDP address of the ground station.
            video: UDP address that pictures are sent to.
            options: More words of its command line.
        """
        words = ["--world", world, "--seed", str(seed), *options]
        words += ["--gcs", f"{ground[0]}:{ground[1]}", "--video", f"{video[0]}:{video[1]}"]
        self._lock = threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "dream.robots.bluerov2.standin", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
            start_new_session=True,  # Ctrl-C is for the dive, which ends it in order.
            text=True,
        )
        where = self._line(STARTS)
        self.a50: tuple[str, int] = (str(where["a50"][0]), int(where["a50"][1]))
        self.surface_pressure = float(where["surface_hpa"])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
            self._process.wait(5.0)
        except (OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait(5.0)
        finally:
            if self._process.stdout is not None:
                self._process.stdout.close()

    def truth(self) -> Truth:
        """Where the vehicle really is.

        Raises:
            OSError: It does not answer.
        """
        told = self._ask({"ask": "truth"})
        return Truth(
            float(told["time"]),
            SE3(np.array(told["rotation"], np.float64).reshape(3, 3), np.array(told["position"], np.float64)),
            int(told["collisions"]),
            float(told["behind"]),
        )

    def fault(self, **fault: object) -> None:
        """Let something go wrong; see `standin.__main__`."""
        self._ask({"ask": "fault", **fault})

    def _ask(self, question: dict[str, object]) -> dict[str, Any]:
        with self._lock:
            assert self._process.stdin is not None
            try:
                self._process.stdin.write(json.dumps(question) + "\n")
                self._process.stdin.flush()
            except OSError as error:
                raise OSError(f"stand-in: expected it to run, got {error}") from error
            told = self._line(ANSWERS)
        if "error" in told:
            raise OSError(f"stand-in: {told['error']}")
        return told

    def _line(self, patience: float) -> dict[str, Any]:
        """The next line that it prints; it is killed where none comes in time."""
        assert self._process.stdout is not None
        late = threading.Timer(patience, self._process.kill)
        late.start()
        try:
            line = self._process.stdout.readline()
        finally:
            late.cancel()
        if not line:
            raise OSError(
                f"stand-in: expected an answer within {patience:g} s, got none; "
                f"it ended with {self._process.poll()}"
            )
        told: dict[str, Any] = json.loads(line)
        return told
