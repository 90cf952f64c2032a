"""Missions at a helm, with the server of their page, and as much of a browser as that needs."""

from __future__ import annotations

import contextlib
import http.cookiejar
import json
import threading
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from dream.evaluation.metrics import Scorer, sight_in
from dream.evaluation.runner import simulate
from dream.live.cockpit import served
from dream.live.doors import Doors
from dream.live.helm import Helmsman
from dream.live.server import listen
from dream.protocol import DREAM_V1, SHOWN, SurveyProtocol
from dream.sim.world import World
from dream.types import Step

TOKEN = "a-token-of-some-length"
WAIT_S = 60.0


class Browser:
    """As much of one as the page needs: it keeps cookies, and says where it comes from."""

    def __init__(self, port: int) -> None:
        self.base = f"http://127.0.0.1:{port}"
        jar = urllib.request.HTTPCookieProcessor(http.cookiejar.CookieJar())
        self._opener = urllib.request.build_opener(jar)

    def open(self, token: str = TOKEN) -> int:
        """The page."""
        return self.get(f"/?token={token}")[0]

    def get(self, path: str) -> tuple[int, bytes]:
        return self._answer(urllib.request.Request(self.base + path))

    def post(self, path: str, content: Any, origin: str | None = None) -> tuple[int, str]:
        body = content if isinstance(content, bytes) else json.dumps(content).encode()
        headers = {"Origin": self.base if origin is None else origin}
        status, text = self._answer(urllib.request.Request(self.base + path, body, headers))
        return status, text.decode()

    def view(self, has: str = "") -> dict[str, Any] | None:
        status, content = self.get(f"/view?has={has}")
        return json.loads(content) if status == 200 else None

    def until(self, wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """What the page shows once it is so."""
        told = self.view()
        assert told is not None
        while not wanted(told):
            told = self.view(f"{told['number']}-{told['helm']}") or told
        return told

    def awaited(self, step: int) -> dict[str, Any]:
        return self.until(lambda told: told["state"] == "waiting" and told["step"] == step)

    def _answer(self, request: urllib.request.Request) -> tuple[int, bytes]:
        try:
            with self._opener.open(request, timeout=WAIT_S) as answer:
                return answer.status, answer.read()
        except urllib.error.HTTPError as error:
            return error.code, error.read()


@dataclass
class Flying:
    """A mission at a helm, in a thread of its own, and the server of its page."""

    helm: Helmsman
    port: int
    steps: list[Step] = field(default_factory=list)
    scores: list[float] = field(default_factory=list)
    thread: threading.Thread | None = None

    def browser(self) -> Browser:
        opened = Browser(self.port)
        assert opened.open() == 200
        return opened

    def join(self) -> None:
        assert self.thread is not None
        self.thread.join(WAIT_S)
        assert not self.thread.is_alive()


def fly(world: World, protocol: SurveyProtocol, planner: Any, most: int) -> Iterator[tuple[Step, float]]:
    visibility = sight_in(world, protocol)
    scorer = Scorer(world, protocol, visibility=visibility)
    fineness = SHOWN if isinstance(planner, Helmsman) else None
    for step in simulate(world, planner, protocol, start=1, max_steps=most, fineness=fineness):
        yield step, scorer.add(step).instances


@contextlib.contextmanager
def flown(world: World, protocol: SurveyProtocol = DREAM_V1, most: int = 6) -> Iterator[Flying]:
    """A mission that waits for a person, and its page."""
    helm, listening = Helmsman(protocol), listen("127.0.0.1", 0)
    flying = Flying(helm, listening.getsockname()[1])

    def mission() -> None:
        for step, score in fly(world, protocol, helm, most):
            helm.note(step)
            flying.steps.append(step)
            flying.scores.append(score)

    flying.thread = threading.Thread(target=mission, daemon=True)
    flying.thread.start()
    with served(helm, Doors("127.0.0.1", TOKEN), listening):
        yield flying
