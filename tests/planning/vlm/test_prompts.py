from __future__ import annotations

import re
from importlib import resources
from pathlib import Path

import pytest

from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.planning.vlm import prompts
from dream.planning.vlm.reply import STEPS
from dream.protocol import DREAM_V1, POOL_V1
from dream.types import Mission, Target

FILES = sorted(
    path.name.removesuffix(".md")
    for path in resources.files("dream").joinpath("planning", "prompts").iterdir()
    if path.name.endswith(".md")
)
ARENA = Bounds(-20.0, -20.0, 20.0, 20.0)


def filled(name: str, mission: Mission) -> tuple[str, str]:
    return prompts.instructions(name, mission, OccupancyMap(ARENA, mission.protocol), count="7")


@pytest.mark.parametrize("name", FILES)
def test_every_prompt_has_a_version_and_a_text(name: str) -> None:
    prompt = prompts.load(name)
    assert re.fullmatch(rf"{name} \d+", prompt.label)
    assert len(prompt.text) > 100


@pytest.mark.parametrize("target", Target)
@pytest.mark.parametrize("name", ["vanilla", "dream", "ranked"])
def test_nothing_is_left_to_be_filled_in(name: str, target: Target) -> None:
    text, label = filled(name, Mission(DREAM_V1, ARENA, 200, target))
    assert "$" not in text
    assert prompts.load(target.value).heads["mission"] in text
    assert label.startswith(f"{name} ")


def test_the_papers_ablation_has_neither_guidance_nor_steps_nor_knowledge() -> None:
    mission = Mission(DREAM_V1, ARENA, 200, Target.OYSTERS)
    vanilla, label = filled("vanilla", mission)
    dream, _ = filled("dream", mission)
    knowledge = prompts.load("oysters").text
    assert knowledge in dream
    assert knowledge not in vanilla
    assert "oysters" not in label
    for step in STEPS:
        assert f"`{step}`" in dream
        assert f"`{step}`" not in vanilla
    for name in ("camera", "depth", "labels", "map"):
        assert f"[{name}]" in vanilla
        assert f"[{name}]" in dream


def test_what_is_said_of_the_robot_is_what_the_protocol_says() -> None:
    for protocol, reach, group in ((DREAM_V1, "8 m", "3 m"), (POOL_V1, "1.5 m", "0.6 m")):
        text, _ = filled("dream", Mission(protocol, ARENA, 200))
        assert f"out to {reach}" in text
        assert f"at least {group} across" in text
        assert "a metre is 20 pixels" in text
        assert "5 m apart" in text


@pytest.mark.parametrize(
    ("text", "told"), [("The $reach and $mystery", r"got \$mystery$"), ("5 $ each", r"got a lone \$, which")]
)
def test_a_prompt_with_a_place_that_nothing_fills_is_refused_by_name(text: str, told: str) -> None:
    prompt = prompts.Prompt("mine", {"version": "1"}, text)
    with pytest.raises(ValueError, match=rf"prompts/mine\.md: expected none but \$reach, {told}"):
        prompts.filled(prompt, {"reach": "8"})


def test_a_prompt_without_a_version_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "files", lambda _: _Files("title: none\n\nText."))
    with pytest.raises(ValueError, match="prompt other: expected a first line such as version: 1"):
        prompts.load("other")


class _Files:
    def __init__(self, text: str) -> None:
        self.text = text

    def joinpath(self, *_: str) -> _Files:
        return self

    def read_text(self, encoding: str) -> str:
        return self.text


@pytest.mark.parametrize("name", FILES)
def test_the_documentation_shows_every_prompt_in_full(name: str) -> None:
    page = Path(__file__).parents[3].joinpath("docs", "prompts.md").read_text(encoding="utf-8")
    prompt = prompts.load(name)
    assert f"## `{name}`, version {prompt.heads['version']}\n" in page
    assert "\n".join(f"> {line}" if line else ">" for line in prompt.text.splitlines()) in page
    assert prompt.heads.get("mission", "") in page
