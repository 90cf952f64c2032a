"""What a page was told so far → what it is told next, as server-sent events.

The position in a stream says how many steps of each run a page has. It is the id of every event, so a page
that comes back says with it where it stopped: it gets what follows, without a gap and nothing twice, also
from a server that was started anew.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from dream.live.folders import MAX_RUNS, Watched, WatchedRun

AT_ONCE = 200
"""Events at most before the rest has to wait for the next round."""

_POSITION = re.compile(r"[0-9a-f]{8}\.[0-9]{1,7}(-[0-9a-f]{8}\.[0-9]{1,7})*")


@dataclass(slots=True)
class Cursor:
    """How far one page is."""

    open: str = ""
    """Key of the run of which it is shown everything; the others come in brief."""
    counts: dict[str, int] = field(default_factory=dict)
    """Steps that it has, by run."""
    _heads: dict[str, int] = field(default_factory=dict)
    _space: str = ""
    _places: tuple[Any, ...] | None = None

    @classmethod
    def at(cls, position: str, shown: str) -> Cursor:
        """Of a page that is where `position` says; from the beginning where that is no position."""
        if len(position) > 20 * MAX_RUNS or not _POSITION.fullmatch(position):
            return cls(shown)
        counted = (entry.split(".") for entry in position.split("-"))
        return cls(shown, {key: int(count) for key, count in counted})

    @property
    def position(self) -> str:
        """For `at`."""
        return "-".join(f"{key}.{count}" for key, count in self.counts.items() if count)

    def news(self, watched: Watched) -> Iterator[bytes]:
        """The events that bring a page up to date, `AT_ONCE` at most; each moves the cursor."""
        left = AT_ONCE
        keys = tuple(run.key for run in watched)
        self.counts = {key: count for key, count in self.counts.items() if key in keys}
        places = (keys, tuple(watched.waiting()), watched.left_out)
        if places != self._places:
            self._places = places
            yield self._event("runs", {"runs": keys, "waiting": places[1], "left_out": watched.left_out})
        for run in watched:
            for event in self._of_run(run):
                yield event
                left -= 1
                if left <= 0:
                    return

    def _of_run(self, run: WatchedRun) -> Iterator[bytes]:
        key = run.key
        has = self.counts.get(key, 0)
        if has > len(run.steps) and not run.behind:
            # The folder was made anew under its name.
            self.counts[key] = has = 0
            yield self._event("again", {"run": key})
        if self._heads.get(key) != run.version:
            self._heads[key] = run.version
            yield self._event("run", run.head())
        if key == self.open and run.space != self._space:
            self._space = run.space
            yield self._event("space", {"run": key, "version": run.space})
        for index in range(has, len(run.steps)):
            self.counts[key] = index + 1
            step = run.steps[index]
            told = step.whole if key == self.open else step.brief
            yield self._event("step", {"run": key, "index": index, "step": told})

    def is_behind(self, watched: Watched) -> bool:
        """Whether there are steps that the page was not told of yet."""
        return any(run.behind or self.counts.get(run.key, 0) < len(run.steps) for run in watched)

    def beat(self, watched: Watched) -> bytes:
        """That the server is there and the page is up to date, and how old the last step of each run is."""
        ages = {run.key: run.age() for run in watched}
        return self._event("beat", {"ages": ages})

    def _event(self, name: str, data: Mapping[str, Any]) -> bytes:
        text = json.dumps(data, allow_nan=False, separators=(",", ":"))
        return f"event: {name}\nid: {self.position}\ndata: {text}\n\n".encode()
