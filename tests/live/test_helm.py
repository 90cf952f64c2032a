"""A person's steps are a planner's steps: the same decisions, the same mission, the same score."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")

from dream.live import cockpit
from dream.live.helm import SaidStep, Seat, moves_of
from dream.mapping import OccupancyMap
from dream.planning import PLANNERS, Human
from dream.protocol import DREAM_V1, DREAM_V2, DREAM_V2_TRUE, PROTOCOLS, SurveyProtocol
from dream.sim.world import World
from dream.sim.worlds import make_world
from dream.types import Decision, Mission, Observation, Step
from tests.live.flying import Browser, Flying, flown, fly


@pytest.fixture(scope="module")
def world() -> World:
    return make_world("reef/fringing", 1)


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Flying]]:
    monkeypatch.setattr(cockpit, "LINGER_S", 0.0)
    monkeypatch.setattr(cockpit, "WAIT_S", 1.0)
    with contextlib.ExitStack() as ended:
        yield lambda *given, **named: ended.enter_context(flown(*given, **named))


@dataclass
class Scripted:
    """A planner that says what it is given."""

    decisions: list[Decision]
    spatial: ClassVar[bool] = True

    def begin(self, mission: Mission) -> Scripted:
        return self

    def decide(self, observation: Observation, occupancy: OccupancyMap) -> Decision:
        return self.decisions.pop(0)


def as_said(step: int, decision: Decision) -> dict[str, Any]:
    return {
        "step": step,
        "turn_deg": math.degrees(decision.turn),
        "advance_m": decision.advance,
        "climb_m": decision.climb,
        "tilt_deg": None if decision.tilt is None else math.degrees(decision.tilt),
        "done": decision.done,
    }


SPACE = [
    Decision(math.pi / 6, 2.0, climb=0.5),
    Decision(0.0, 1.0, climb=-1.0, tilt=math.radians(45.0)),
    Decision(tilt=math.radians(-25.0)),
]


@pytest.mark.parametrize(
    ("name", "protocol", "planner"),
    [
        ("reef/fringing", DREAM_V1, PLANNERS["lawnmower"]),
        pytest.param("flat/empty", DREAM_V2, Scripted(SPACE), marks=pytest.mark.slow),
    ],
)
def test_posted_steps_fly_the_mission_of_the_planner_that_decides_the_same(
    name: str, protocol: SurveyProtocol, planner: Any, start: Callable[..., Flying]
) -> None:
    world, most = make_world(name, 1), 6
    planned = list(fly(world, protocol, planner, most))
    flying = start(world, protocol, most)
    browser = flying.browser()
    for step, _ in planned[4:]:
        browser.awaited(step.index)
        assert browser.post("/decide", as_said(step.index, step.decision)) == (204, "")
    flying.join()
    assert len(flying.steps) == len(planned) == most + 1
    for by_hand, score, (step, scored) in zip(flying.steps, flying.scores, planned, strict=True):
        assert _carried_out(by_hand) == _carried_out(step)
        assert score == scored
    assert flying.scores[-1] > 0.0


def _carried_out(step: Step) -> tuple[Any, ...]:
    """All that a decision does: what it was, what the guard made of it, where it led."""
    seen, moves = step.observation, (step.decision, step.guarded.decision)
    moved = [(one.turn, one.advance, one.climb, one.tilt, one.done) for one in moves]
    return moved, step.guarded.note, step.arrival.pose, seen.z, seen.tilt, seen.time, step.ended


def test_nothing_of_the_truth_is_on_the_page(world: World, start: Callable[..., Flying]) -> None:
    flying = start(world, most=5)
    browser = flying.browser()
    told = browser.awaited(4)
    assert set(told) == {
        *("state", "step", "flown", "most", "pose", "areas", "heights", "last", "inset"),
        *("number", "helm", "pictures"),
    }
    assert set(told["last"]) == {
        *("step", "decision", "guarded", "open_region", "pose", "distance_m", "ended"),
    }
    assert set(told["pictures"]) == {"camera", "depth", "labels", "map"}
    told_at_all = browser.get("/")[1] + json.dumps(told).encode()
    assert not any(word in told_at_all for word in (world.name.encode(), b"coverage", b"instances", b"truth"))


def test_pictures_are_those_that_a_model_is_shown(world: World, start: Callable[..., Flying]) -> None:
    from dream.planning.vlm.pictures import camera_pictures

    flying = start(world, most=5)
    browser = flying.browser()
    told = browser.awaited(4)
    seen = flying.steps[-1].observation
    for name, png in camera_pictures(seen).items():
        assert browser.get(f"/pictures/{told['number']}/{name}") == (200, png)
    assert browser.get("/pictures/1/truth")[0] == 404


def test_the_guard_is_told_where_it_changed_a_move(start: Callable[..., Flying]) -> None:
    flying = start(make_world("flat/empty", 1), most=30)
    browser = flying.browser()
    step, told = 4, browser.awaited(4)
    while not told["last"]["guarded"]["note"]:
        assert step < 29
        assert browser.post("/decide", {"step": step, "advance_m": 2})[0] == 204
        step += 1
        told = browser.awaited(step)
    assert "leaves known free ground" in told["last"]["guarded"]["note"]
    assert told["last"]["guarded"]["advance"] < 2.0


def test_the_word_done_ends_it_where_the_map_agrees_and_costs_a_step_where_not(
    world: World, start: Callable[..., Flying]
) -> None:
    flying = start(world, most=5)
    browser = flying.browser()
    browser.awaited(4)
    assert browser.post("/decide", {"step": 4, "done": True})[0] == 204
    told = browser.awaited(5)
    assert told["last"]["open_region"]
    assert told["last"]["decision"]["done"]
    assert browser.post("/decide", {"step": 5, "done": True})[0] == 204
    flying.join()
    assert [step.decision.done for step in flying.steps[-2:]] == [True, True]
    assert browser.until(lambda told: told["state"] == "over")["last"]["ended"] == "cap"


@pytest.mark.slow
def test_the_word_done_ends_a_mission_in_space(start: Callable[..., Flying]) -> None:
    flying = start(make_world("flat/empty", 1), DREAM_V2_TRUE, 9)
    browser = flying.browser()
    assert set(browser.awaited(4)["pictures"]) == {"camera", "depth", "labels", "map", "level", "slice"}
    assert browser.post("/decide", {"step": 4, "done": True})[0] == 204
    flying.join()
    assert flying.steps[-1].ended == "done"


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"turn_deg": 31}, "turn_deg: expected one of -90, -60, -30, 0, 30, 60, 90, 180, got 31"),
        ({"turn_deg": -180}, "turn_deg: expected one of"),
        ({"advance_m": 1.5}, "advance_m: expected one of 0, 1, 2, got 1.5"),
        ({"advance_m": -1}, "advance_m: expected one of"),
        ({"climb_m": 0.5}, "climb_m: expected one of 0, got 0.5"),
        ({"tilt_deg": 20}, "tilt_deg: expected none"),
        ({"done": True, "turn_deg": 30}, "done: expected no move with it"),
        ({"turn_deg": "30"}, "turn_deg: Input should be a valid number"),
        ({"turn_deg": 1e300}, "turn_deg: Input should be less than"),
        ({"done": 1}, "done: Input should be a valid boolean"),
        ({"waited": 1}, "waited: Extra inputs are not permitted"),
        ({"step": 0}, "step: Input should be greater than"),
        (b"", "decision: Invalid JSON"),
        (b"[1]", "decision: Input should be an object"),
        (b'{"step": 4, "turn_deg": NaN}', "turn_deg: Input should be a finite number"),
        (b" " * 2000, "body: expected at most 1024 bytes"),
    ],
)
def test_what_the_protocol_does_not_allow_is_refused_with_the_reason(
    said: Any, told: str, refusing: Browser
) -> None:
    content = said if isinstance(said, bytes) else {"step": 4, **said}
    status, text = refusing.post("/decide", content)
    assert status == 400
    assert text.startswith(told)
    now = refusing.view()
    assert now is not None
    assert (now["state"], now["step"]) == ("waiting", 4)


@pytest.fixture(scope="module")
def refusing() -> Iterator[Browser]:
    """A page whose mission waits for its step 4."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cockpit, "LINGER_S", 0.0)
        with flown(make_world("flat/empty", 1), DREAM_V1, 5) as flying:
            browser = flying.browser()
            browser.awaited(4)
            yield browser


def test_a_step_is_decided_once(start: Callable[..., Flying], world: World) -> None:
    browser = start(world, most=6).browser()
    browser.awaited(4)
    assert browser.post("/decide", {"step": 5}) == (409, "step 5 waits for no decision: step 4 does\n")
    assert browser.post("/decide", {"step": 4, "turn_deg": 30})[0] == 204
    assert browser.post("/decide", {"step": 4, "turn_deg": 30})[0] == 409
    assert browser.awaited(5)["last"]["step"] == 4


def test_whoever_lacks_the_token_or_comes_from_elsewhere_may_do_nothing(refusing: Browser) -> None:
    stranger = Browser(int(refusing.base.rsplit(":", 1)[1]))
    assert stranger.open("another-token-of-some-length") == 401
    assert stranger.get("/view")[0] == 401
    assert stranger.post("/decide", {"step": 4})[0] == 401
    assert stranger.open() == 200
    for origin in ("http://evil.example", "null", "", refusing.base.replace("127.0.0.1", "localhost")):
        for path in ("/decide", "/take"):
            status, said = refusing.post(path, {"step": 4}, origin=origin)
            assert (status, said.startswith("Only the page of this server")) == (403, True)
    assert refusing.post("/view", {})[0] == 405
    assert refusing.get("/decide")[0] == 405


def test_a_second_browser_watches_and_takes_the_helm_once_the_first_is_away(
    refusing: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    second = Browser(int(refusing.base.rsplit(":", 1)[1]))
    assert second.open() == 200
    told = second.view()
    assert told is not None
    assert (told["state"], told["helm"]) == ("waiting", "theirs")
    assert second.post("/decide", {"step": 4, "turn_deg": 30}) == (409, "Another page is at the helm.\n")
    assert second.post("/take", {})[0] == 409
    monkeypatch.setattr("dream.live.helm.AWAY_S", -1.0)
    assert second.until(lambda told: told["helm"] == "free")
    assert second.post("/take", {})[0] == 204
    assert second.until(lambda told: told["helm"] == "yours")
    monkeypatch.undo()
    again = refusing.view()
    assert again is not None
    assert again["helm"] == "theirs"
    monkeypatch.setattr("dream.live.helm.AWAY_S", -1.0)
    assert refusing.post("/take", {})[0] == 204


def test_a_page_that_comes_back_goes_on(refusing: Browser) -> None:
    refusing.view()
    assert refusing.get("/")[0] == 200  # The browser keeps its cookies, the page is new.
    told = refusing.view()
    assert told is not None
    assert told["helm"] == "yours"


def test_the_seat_is_held_for_a_while_and_kept_where_nobody_takes_it() -> None:
    now = [0.0]
    seat = Seat(lambda: now[0])
    assert seat.hear("one") == "yours"
    assert seat.hear("two") == "theirs"
    now[0] = 29.0
    assert not seat.take("two")
    now[0] = 31.0
    assert seat.hear("two") == "free"
    assert seat.hear("one") == "yours"
    assert not seat.take("two")
    now[0] = 90.0
    assert seat.take("two")
    assert seat.hear("one") == "theirs"


@pytest.mark.parametrize("protocol", PROTOCOLS.values(), ids=lambda protocol: protocol.name)
def test_what_a_page_offers_is_what_the_protocol_allows_to_the_last_bit(protocol: SurveyProtocol) -> None:
    moves = moves_of(protocol)
    for turn in moves["turns"]:
        said = SaidStep.read(json.dumps({"step": 4, "turn_deg": turn}).encode())
        assert said.decision(protocol).turn in protocol.turn_angles
    for advance in moves["advances"]:
        said = SaidStep.read(json.dumps({"step": 4, "advance_m": advance}).encode())
        assert said.decision(protocol).advance in (0.0, *protocol.advances)
    for climb in moves["climbs"]:
        assert SaidStep(step=4, climb_m=climb).decision(protocol).climb in protocol.climbs
    for tilt in moves["tilts"] if moves["space"] else ():
        assert SaidStep(step=4, tilt_deg=tilt).decision(protocol).tilt in protocol.tilts


def test_a_person_is_no_planner_that_a_command_flies_by_itself() -> None:
    assert "human" not in PLANNERS
    with pytest.raises(ValueError, match="expected a person at the page of dream fly"):
        Human().begin(Mission(DREAM_V1, make_world("flat/empty", 1).bounds, 5))
