from __future__ import annotations

import hashlib
import re
from importlib import resources
from pathlib import Path

import pytest

from dream.geometry import Bounds
from dream.mapping import OccupancyMap
from dream.planning import Dream
from dream.planning.vlm import prompts
from dream.planning.vlm.reply import STEPS
from dream.protocol import DREAM_V1, DREAM_V2, POOL_V1
from dream.types import Mission, Target

FILES = sorted(
    path.name.removesuffix(".md")
    for path in resources.files("dream").joinpath("planning", "prompts").iterdir()
    if path.name.endswith(".md")
)
ARENA = Bounds(-20.0, -20.0, 20.0, 20.0)


def filled(name: str, mission: Mission, own: str | None = None) -> tuple[str, str]:
    occupancy = OccupancyMap(ARENA, mission.protocol)
    return prompts.instructions(name, mission, occupancy, prompts.own_prompts(own), count="7")


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


@pytest.mark.parametrize("name", ["vanilla", "dream"])
def test_in_space_every_climb_and_tilt_is_named_and_what_counts_is_said(name: str) -> None:
    text, label = filled(name, Mission(DREAM_V2, ARENA, 200))
    assert "$" not in text
    assert label.endswith(", space 1, steering 1")
    assert "one of -1, -0.5, 0, 0.5, 1:" in text
    assert "one of -25, 20, 45:" in text
    for said in ("[level]", "[slice]", "no more than 70 degrees", "at least 0.8 m above", "0.5 m under"):
        assert said in text


@pytest.mark.parametrize("name", ["vanilla", "dream", "ranked"])
def test_in_the_plane_nothing_is_said_of_heights(name: str) -> None:
    text, label = filled(name, Mission(DREAM_V1, ARENA, 200))
    assert not any(word in text for word in ("climb", "tilt", "[slice]", "violet"))
    assert "space" not in label


def test_every_prompt_names_the_places_that_are_filled_in() -> None:
    assert set(FILES) == set(prompts.PLACES)


@pytest.mark.parametrize("name", [name for name in FILES if prompts.PLACES[name]])
def test_every_place_that_may_be_named_is_filled_in(name: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.md").write_text(
        "version: 1\n\n" + " ".join(f"${place}" for place in prompts.PLACES[name])
    )
    if name == "orders":
        return  # `tests/test_mission_words.py` asks with all of its places.
    asked = name if "mission" in prompts.PLACES[name] else "dream"
    protocol = DREAM_V2 if name in ("space", "steering") else POOL_V1
    text, label = filled(asked, Mission(protocol, ARENA, 200, Target.OYSTERS), str(tmp_path))
    assert "$" not in text
    assert re.search(rf"{name} 1 \(own, [0-9a-f]{{8}}\)", label)


def test_ones_own_prompt_takes_the_place_of_one_and_leaves_the_others(tmp_path: Path) -> None:
    mission = Mission(DREAM_V1, ARENA, 200, Target.OYSTERS)
    own = "version: 7\n\n$mission Mind the seals, for $$1 each. $legend"
    (tmp_path / "dream.md").write_text(own)
    (tmp_path / "notes.txt").write_text("not a prompt")
    text, label = filled("dream", mission, str(tmp_path))
    assert "Mind the seals, for $1 each." in text
    assert prompts.load("oysters").heads["mission"] in text
    sha256 = hashlib.sha256(own.encode()).hexdigest()
    assert label.startswith(f"dream 7 (own, {sha256[:8]}), legend ")
    assert {name: own.own for name, own in prompts.own_prompts(str(tmp_path)).items()} == {"dream": sha256}
    assert filled("vanilla", mission, str(tmp_path)) == filled("vanilla", mission)


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("dream", "version: 1\n\nThe $reach and $mystery", r"but \$mission, .*, got \$mystery$"),
        ("dream", "version: 1\n\n5 $ each", r"got a lone \$, which is written \$\$"),
        ("dream", "title: none\n\nText.", "expected a first line such as version: 1"),
        ("dream", "Text only.", "expected a first line such as version: 1"),
        ("dream", "version: 1\n\n  \n", "expected a text after its heads"),
        ("dream", b"version: 1\n\n\xff\xfe", "expected text in UTF-8"),
        ("dream", "version: 1\n\n" + "a" * prompts.MOST_BYTES, "expected at most 65536 bytes"),
        ("oysters", "version: 1\n\nThey grow.", "expected a head such as mission: "),
        ("dreams", "version: 1\n\nText.", r"expected some of vanilla\.md, .*, got dreams\.md"),
        (None, "", r"expected some of vanilla\.md, .*, got none"),
    ],
)
def test_a_prompt_that_cannot_be_used_is_refused_before_anything_is_asked(
    tmp_path: Path, name: str | None, text: str | bytes, told: str
) -> None:
    if name is not None:
        (tmp_path / f"{name}.md").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=told) as refused:
        Dream(model="wire", prompts=str(tmp_path)).line()
    assert str(tmp_path) in str(refused.value)


def test_a_folder_of_prompts_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"expected a folder with some of vanilla\.md"):
        Dream(model="wire", prompts=str(tmp_path / "none")).line()


def test_the_documentation_says_of_every_prompt_what_it_is_for() -> None:
    page = Path(__file__).parents[3].joinpath("docs", "models.md").read_text(encoding="utf-8")
    table = page[page.index("| file | is for |") :].split("\n\n")[0]
    assert sorted(re.findall(r"`(\w+)\.md`", table)) == FILES
