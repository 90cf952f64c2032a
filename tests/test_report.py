from __future__ import annotations

import base64
import io
import itertools
import json
import logging
import re
import shlex
import shutil
import struct
import subprocess
import zlib
from collections.abc import Iterable
from dataclasses import asdict, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream import commands
from dream.cli import run_command
from dream.planning import PLANNERS, AnyPlanner, Dream, Lawnmower, RandomWalk, SixSteps, Vanilla
from dream.recording import RunConfig, read_config, read_summary, record, write_config, write_summary
from dream.report import repeating_command, write_report
from dream.types import Step
from tests.programs import CHROMIUM, do_without
from tests.recorded_runs import (
    CONFIG,
    SUMMARY,
    asking_mission,
    exchange,
    painted_coverage,
    painted_mission,
    painted_pictures,
)

HOSTILE = (
    "</script ></script><script>document.title='owned'</script><img src=x onerror=alert(1)> & <!-- {{run}}"
)


class Page(HTMLParser):
    """The elements of a page, and the text of each script."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.loads: list[str] = []
        self.scripts: dict[str, str] = {}
        self.policy = ""
        self._script = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.tags.append(tag)
        self.loads += [value for name in ("src", "href", "action", "data") if (value := named.get(name))]
        self._script = (named.get("id") or "module") if tag == "script" else ""
        if named.get("http-equiv") == "Content-Security-Policy":
            self.policy = named.get("content") or ""

    def handle_data(self, data: str) -> None:
        if self._script:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data

    def handle_endtag(self, tag: str) -> None:
        self._script = ""


def recorded(folder: Path, count: int, *, kept: int | None = None, said: str = "") -> Path:
    return kept_in(folder, painted_mission(count, said=said), kept)


def kept_in(folder: Path, mission: Iterable[Step], kept: int | None = None) -> Path:
    write_config(folder, CONFIG)
    steps = record(mission, folder, annotate=painted_coverage)
    for _ in itertools.islice(steps, kept):
        pass
    steps.close()
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = recorded(tmp_path_factory.mktemp("finished"), 12)
    write_summary(folder, SUMMARY)
    write_report(folder)
    return folder


def test_the_page_holds_every_step_with_its_pictures(finished: Path) -> None:
    page = Page(finished / "report.html")
    run = json.loads(page.scripts["run"])
    assert [step["step"] for step in run["steps"]] == list(range(12))
    assert run["summary"]["success"] is True
    assert run["depth_max"] == 20  # metres: the scale ends at the next five beyond the farthest ground seen
    for step in range(12):
        pictures = json.loads(page.scripts[f"pictures-{step}"])
        assert all(pictures[name].startswith("data:image/") for name in ("map", "rgb", "depth", "labels"))


def test_the_page_loads_nothing_and_may_not(finished: Path) -> None:
    page = Page(finished / "report.html")
    assert all(load.startswith(("data:", "#")) for load in page.loads)
    assert page.policy.startswith("default-src 'none'; img-src data:; base-uri 'none'; form-action 'none';")
    assert "unsafe" not in page.policy
    assert not re.search(
        r"@import|url\(|fetch\(|XMLHttpRequest|WebSocket|import\(|innerHTML|webgl", page.scripts["module"]
    )
    assert not re.search(r"@import|url\(", (finished / "report.html").read_text(encoding="utf-8"))


def test_two_hundred_steps_stay_below_twelve_megabytes(tmp_path: Path) -> None:
    few, many = 4, 200
    assert write_report(recorded(tmp_path, few)).stat().st_size * many / few < 12e6


def test_what_a_run_says_cannot_leave_its_place_in_the_page(tmp_path: Path) -> None:
    folder = recorded(tmp_path, 2, said=HOSTILE)
    began = "2026-06-01T09:30:12Z"
    write_config(folder, {**CONFIG, "world": HOSTILE, "planner": HOSTILE, "began": began})
    page = Page(write_report(folder))
    assert page.tags.count("script") == 2 + 2  # the run, the program, and the pictures of two steps
    assert "img" not in page.tags
    assert not set("<>&") & set(page.scripts["run"])
    run = json.loads(page.scripts["run"])
    assert run["config"]["world"] == HOSTILE
    assert run["config"]["began"] == began
    assert run["steps"][1]["reasoning"]["safety"].endswith(HOSTILE)


def test_an_interrupted_run_is_shown_as_far_as_it_went(tmp_path: Path) -> None:
    folder = recorded(tmp_path, 9, kept=3)
    with (folder / "steps.jsonl").open("a") as lines:
        lines.write('{"step": 3, "ti')
    run = json.loads(Page(write_report(folder)).scripts["run"])
    assert len(run["steps"]) == 3
    assert run["summary"] is None


def test_a_run_interrupted_before_its_first_step_has_a_page_too(tmp_path: Path) -> None:
    run = json.loads(Page(write_report(recorded(tmp_path, 9, kept=0))).scripts["run"])
    assert run["steps"] == []


def test_a_missing_or_damaged_picture_is_left_out_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = recorded(tmp_path, 2)
    (folder / "frames/0001_rgb.png").unlink()
    (folder / "frames/0001_depth.png").write_bytes((folder / "frames/0001_depth.png").read_bytes()[:400])
    (folder / "frames/0001_labels.png").write_bytes(b"GIF89a no picture")
    with caplog.at_level(logging.WARNING):
        page = Page(write_report(folder))
    pictures = json.loads(page.scripts["pictures-1"])
    assert [name for name, url in pictures.items() if url is None] == ["rgb", "depth", "labels"]
    assert "0001_depth.png is left out" in caplog.text


def promised(width: int, height: int) -> bytes:
    """A PNG whose header promises that many grey pixels, and that holds none."""
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
        (b"IDAT", b""),
        (b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))
        for name, data in chunks
    )


@pytest.mark.parametrize("size", [(30000, 30000), (10000, 10000), (5000, 2), (2**31 - 1, 2**31 - 1)])
def test_a_picture_that_promises_too_many_pixels_is_left_out_with_a_warning(
    size: tuple[int, int], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = recorded(tmp_path, 1)
    (folder / "frames/0000_rgb.png").write_bytes(promised(*size))
    with caplog.at_level(logging.WARNING):
        page = Page(write_report(folder))
    pictures = json.loads(page.scripts["pictures-0"])
    assert [name for name, url in pictures.items() if url is None] == ["rgb"]
    assert "0000_rgb.png is left out" in caplog.text


def test_a_map_of_more_colours_than_any_drawing_has_is_shown_in_fewer(tmp_path: Path) -> None:
    folder = recorded(tmp_path, 1)
    colors = np.random.default_rng(1).integers(0, 256, (400, 400, 3)).astype(np.uint8)
    colors[:200] = (20, 120, 220)
    Image.fromarray(colors).save(folder / "maps/0000.png")
    url = json.loads(Page(write_report(folder)).scripts["pictures-0"])["map"]
    with Image.open(io.BytesIO(base64.b64decode(url.split(",", 1)[1]))) as shown:
        assert shown.mode == "P"
        found = np.asarray(shown.convert("RGB"), np.int32)
    assert np.abs(found[:200] - (20, 120, 220)).max() <= 2
    assert np.abs(found[200:] - colors[200:]).mean() < 24.0


def test_a_folder_that_is_no_run_has_no_report(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="expected a run folder"):
        write_report(tmp_path)


def test_the_command_of_the_footer_holds_what_is_not_the_default() -> None:
    plain = "dream run sixsteps --world reef/string --seed 3 --protocol dream-v1"
    assert repeating_command(RunConfig(**CONFIG)) == plain
    parameters = asdict(SixSteps())
    assert repeating_command(RunConfig(**CONFIG, planner_parameters=parameters)) == plain
    changed = RunConfig(**CONFIG, planner_parameters={**parameters, "prior_weight": 0.25})
    assert repeating_command(changed) == plain + " --prior-weight 0.25"


@pytest.mark.parametrize(
    ("planner", "options"),
    [
        (SixSteps(), {}),
        (SixSteps(kernel=5.0 / 3.0, standoff_cells=2.0), {"start": 2, "max_steps": 40}),
        (Lawnmower(swath=0.8), {"world": "my reef; it's old", "protocol": "pool-v1"}),
        (RandomWalk(walk_seed=7), {"seed": 2**63 - 1}),
        (Dream(model="openai:gpt-5", max_calls=0, max_usd=0.5, timeout=30.0), {}),
        (
            Vanilla(model="http://[::1]:8000/v1", model_name="my model", latency=0.0, record="kept; here"),
            {"max_steps": 9},
        ),
        (Dream(model="wire:slow", replay_replies="kept"), {}),
    ],
)
def test_the_command_of_the_footer_parses_to_the_run_that_was_recorded(
    planner: AnyPlanner, options: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = commands.Run(**{"planner": planner, "protocol": "dream-v1", **options})
    config = {
        **CONFIG,
        "planner": next(name for name, default in PLANNERS.items() if type(default) is type(planner)),
        "planner_parameters": asdict(planner),
        "world_from": made.world,
        "seed": made.seed,
        "start": made.start,
        "max_steps": made.max_steps,
        "protocol": made.protocol,
    }
    write_config(tmp_path, config)
    parsed: list[commands.Run] = []

    def kept(run: commands.Run) -> int:
        parsed.append(run)
        return 0

    monkeypatch.setattr(commands.Run, "__call__", kept)
    program, *arguments = shlex.split(repeating_command(read_config(tmp_path)))
    assert program == "dream"
    assert run_command(arguments) == 0
    assert parsed == [made]


def test_a_planner_that_is_not_known_here_is_named_with_all_its_parameters() -> None:
    config = RunConfig(**{**CONFIG, "planner": "mine", "planner_parameters": {"far_off": 3, "how": "a b"}})
    assert repeating_command(config).endswith(" --far-off 3 --how 'a b'")


def browse(page: Path, step: int | None, profile: Path, *options: str) -> subprocess.CompletedProcess[str]:
    if CHROMIUM is None:
        do_without("needs Chromium to open the page with: apt-get install chromium")
    quiet = (
        "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
        "--disable-component-update --disable-sync --hide-scrollbars --enable-logging=stderr "
        "--virtual-time-budget=4000 --window-size=1400,900"
    )
    address = page.as_uri() + ("" if step is None else f"#step={step}")
    return subprocess.run(
        [CHROMIUM, *quiet.split(), f"--user-data-dir={profile}", *options, address],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )


@pytest.mark.slow
def test_a_browser_shows_the_page_without_a_complaint(finished: Path, tmp_path: Path) -> None:
    picture = tmp_path / "page.png"
    seen = browse(finished / "report.html", 5, tmp_path / "profile", f"--screenshot={picture}")
    assert "CONSOLE" not in seen.stderr
    with Image.open(picture) as shown:
        pixels = np.array(shown.convert("RGB")).astype(int)
    assert pixels.shape == (900, 1400, 3)
    assert len(np.unique(pixels.reshape(-1, 3), axis=0)) > 1000
    # The map is white, grey and green in the left half; the camera image blue-green right of it.
    left, middle = pixels[180:780, 40:580].reshape(-1, 3), pixels[230:500, 620:980].reshape(-1, 3)
    assert (np.ptp(left, axis=1) == 0).mean() > 0.2
    assert (middle[:, 2] > middle[:, 0] + 20).mean() > 0.5


@pytest.mark.slow
def test_a_link_to_a_step_opens_it(finished: Path, tmp_path: Path) -> None:
    shown = browse(finished / "report.html", 7, tmp_path / "profile", "--dump-dom").stdout
    assert 'data-ready="12"' in shown
    assert re.search(r'id="counter"[^>]*>Step 7 <small>of 11', shown)
    assert "Success" in shown


@pytest.mark.slow
def test_the_page_opens_at_the_last_step(finished: Path, tmp_path: Path) -> None:
    shown = browse(finished / "report.html", None, tmp_path / "profile", "--dump-dom").stdout
    assert re.search(r'id="counter"[^>]*>Step 11 <small>of 11', shown)


@pytest.mark.few(3)
@pytest.mark.slow
@pytest.mark.parametrize(
    ("why", "summarized", "said"),
    [
        (None, False, "It left no word why: the program was killed, or the power failed, or it is still"),
        ("", True, "It was aborted after 2 steps, with 100 % of the individuals seen and no contact."),
        ("dive: lost <b>", True, "It was aborted after 2 steps, with .* contact: dive: lost &lt;b&gt;."),
        ("dive: lost <b>", False, "It was aborted after step 2: dive: lost &lt;b&gt;."),
    ],
)
def test_a_mission_that_did_not_end_is_called_aborted_and_says_why(
    why: str | None, summarized: bool, said: str, tmp_path: Path
) -> None:
    (folder := tmp_path / "run").mkdir()
    recorded(folder, 9, kept=3)
    if why is not None:
        told = {**SUMMARY, "ended": "aborted", "why": why, "steps": 2, "t_stop": None, "success": False}
        write_summary(folder, told)
    if not summarized:
        # Where there was no room for it, the last step says so as well.
        (folder / "summary.json").unlink(missing_ok=True)
    shown = browse(write_report(folder), None, tmp_path / "profile", "--dump-dom").stdout
    assert re.search(r'id="badge"[^>]*>Aborted<', shown)
    assert re.search(said, shown)


@pytest.mark.rare
@pytest.mark.slow
def test_what_was_ordered_stands_below_the_headline_as_text(tmp_path: Path) -> None:
    for name in ("plain", "ordered"):
        (tmp_path / name).mkdir()
    plain = recorded(tmp_path / "plain", 2)
    write_summary(plain, SUMMARY)
    shown = browse(write_report(plain), None, tmp_path / "profile", "--dump-dom").stdout
    assert re.search(r'id="words"[^>]*hidden', shown)
    assert "of the individuals seen" in shown
    ordered = recorded(tmp_path / "ordered", 2)
    write_summary(ordered, SUMMARY)
    understood = ["1. Map all targets in the western half of the survey area."]
    orders = {"words": f"the west {HOSTILE}", "orders": {"legs": []}, "understood": understood}
    write_config(ordered, {**CONFIG, **orders})
    seen = browse(write_report(ordered), None, tmp_path / "profile", "--dump-dom")
    assert "CONSOLE" not in seen.stderr
    assert "<title>reef/string seed 3, sixsteps · DREAM</title>" in seen.stdout
    assert "“the west &lt;/script &gt;" in text_of(seen.stdout, "words")
    assert understood[0] in text_of(seen.stdout, "orders")
    assert "100 % of the individuals in the ordered area seen" in seen.stdout


@pytest.mark.slow
def test_a_browser_runs_nothing_that_a_run_says(tmp_path: Path) -> None:
    folder = recorded(tmp_path, 2, said=HOSTILE)
    seen = browse(write_report(folder), 1, tmp_path / "profile", "--dump-dom")
    assert 'data-ready="2"' in seen.stdout
    assert "<title>reef/string seed 3, sixsteps · DREAM</title>" in seen.stdout
    assert "CONSOLE" not in seen.stderr


VLM: dict[str, Any] = {
    "model": "openai:painted",
    "prompts": ["dream 1"],
    "calls": 1098,
    "questions": 900,
    "tokens": 1234567,
    "tokens_in": 1200000,
    "tokens_out": 34567,
    "cost_usd": 3.275,
    "outcomes": {"followed": 600, "overruled": 296},
    "fallbacks": 4,
    "reasons": {"invalid": 1, "timeout": 3},
    "waited_s": 1176.0,
}


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = kept_in(tmp_path_factory.mktemp("asked"), asking_mission(7, said=HOSTILE))
    write_summary(folder, {**SUMMARY, "mission_s": 1500.0, "vlm": VLM})
    write_report(folder)
    return folder


def test_the_page_holds_what_a_model_was_shown_to_the_byte(asked: Path) -> None:
    page = Page(asked / "report.html")
    assert [name for name in page.scripts if name.startswith("asked-")] == ["asked-4", "asked-5", "asked-6"]
    for step in (4, 5, 6):
        (told,) = json.loads(page.scripts[f"asked-{step}"])
        assert list(told["pictures"]) == ["camera", "depth", "labels", "map"]
        for name, url in told["pictures"].items():
            kind, _, content = url.partition(",")
            assert kind == "data:image/png;base64"
            assert base64.b64decode(content) == (asked / f"replies/{step:04d}_{name}.png").read_bytes()
    (told,) = json.loads(page.scripts["asked-5"])
    assert told["replies"][0] == "I would turn left. " + HOSTILE
    assert told["lacks"] == ["no JSON object", "step_m: Field required; up" + HOSTILE]
    assert json.loads(told["expected"])["properties"]["turn_deg"]["enum"] == [0, 30, 60, 90, 180]
    assert (told["fallback"], told["requests"], told["cost_usd"]) == (
        f"invalid: step_m: Field required; up{HOSTILE}, asked twice",
        2,
        None,
    )


def test_what_a_model_says_cannot_leave_its_place_in_the_page(asked: Path) -> None:
    page = Page(asked / "report.html")
    assert page.tags.count("script") == 2 + 7 + 3  # the run, the program, the pictures and what was asked
    assert "img" not in page.tags
    assert not any(set("<>&") & set(text) for name, text in page.scripts.items() if name != "module")
    assert page.policy.startswith("default-src 'none'; img-src data:;")


def test_a_picture_that_is_none_is_left_out_of_what_a_model_was_shown(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    first, second = painted_mission(2)
    pngs = {**painted_pictures(second), "depth": b"GIF89a", "labels": promised(30000, 30000)}
    decision = replace(second.decision, exchanges=(exchange(pictures=pngs),))
    with caplog.at_level(logging.WARNING):
        page = Page(write_report(kept_in(tmp_path, [first, replace(second, decision=decision)])))
    (told,) = json.loads(page.scripts["asked-1"])
    assert [name for name, url in told["pictures"].items() if url is None] == ["depth", "labels"]
    assert "the picture depth of step 1 is left out" in caplog.text


def test_a_damaged_exchange_is_named_by_the_report(asked: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(asked, tmp_path / "copy"))
    (folder / "replies/0005.json").write_text("{}")
    with pytest.raises(ValueError, match=r"0005\.json: .*Field required"):
        write_report(folder)


def text_of(dom: str, name: str) -> str:
    """What an element with that id says, tags left out."""
    found = re.search(rf'id="{name}"[^>]*>(.*?)</(?:p|section|blockquote|ul)>', dom, re.S)
    assert found is not None
    return re.sub(r"<[^>]+>", " ", found[1])


@pytest.mark.slow
def test_a_browser_shows_what_a_model_saw_and_said(asked: Path, tmp_path: Path) -> None:
    seen = browse(asked / "report.html", 5, tmp_path / "profile", "--dump-dom")
    assert "CONSOLE" not in seen.stderr
    dom = re.sub(r"<script.*?</script>", "", seen.stdout, flags=re.S)
    total = text_of(dom, "asked-total")
    assert "openai:painted was asked: 1098 calls, 1,234,567 tokens, US$ 3.27" in total.replace(
        "1,098", "1098"
    )
    assert (
        "4 of 900 questions decided by geometry (invalid 1, timeout 3), its answers: 600 followed, "
        "296 overruled, waited 19.6 min of 25.0 min"
    ) in total
    panel = dom[dom.index('id="asked-panel"') : dom.index('id="curve-title"')]
    assert panel.count("<img") == 4
    assert panel.count('src="data:image/png;base64,') == 4
    assert "No reply used" in panel
    assert "asked twice. The offline planner decided." in panel
    assert '<p class="lacks">Lacks: no JSON object.</p>' in panel
    assert re.search(r"What a reply must be.*turn_deg", panel, re.S)
    assert '<p class="lacks">Lacks: step_m: Field required; up&lt;/script &gt;' in panel
    assert re.search(r'<p class="outcome" id="without-answer" hidden="">', dom)
    assert "I would turn left. &lt;/script &gt;" in panel
    assert '{\n  "direction": "up"\n}' in panel
    assert "24 s on the mission's clock" in panel
    assert "<title>reef/string seed 3, sixsteps · DREAM</title>" in dom


def test_what_is_hidden_is_not_laid_out_whatever_else_its_class_says(asked: Path) -> None:
    page = write_report(asked).read_text()
    assert 'class="outcome" id="without-answer" hidden' in page
    assert re.search(r"^\[hidden\] \{ display: none !important; \}$", page, re.MULTILINE)


@pytest.mark.slow
def test_a_browser_shows_why_a_reply_was_not_followed_and_at_its_head_that_none_counted(
    asked: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(asked, tmp_path / "copy"))
    silent = {**VLM, "fallbacks": VLM["questions"], "last_fallback": f"invalid: {HOSTILE}"}
    write_summary(folder, {**SUMMARY, "vlm": silent})
    dom = browse(write_report(folder), 4, tmp_path / "profile", "--dump-dom").stdout
    told = dom[dom.index('id="without-answer"') :].partition("</p>")[0]
    assert told.startswith('id="without-answer"><strong class="badge warn">No answer of the model counted<')
    assert "The last had none because of invalid: &lt;/script &gt;" in told
    panel = re.sub(r"<script.*?</script>", "", dom, flags=re.S)
    panel = panel[panel.index('id="asked-panel"') : panel.index('id="curve-title"')]
    assert '<strong class="badge warn">Overruled</strong> place 7, which costs 5.2 steps, 2.0 are ' in panel
    assert "&lt;/script &gt;" in panel[panel.index("2.0 are allowed") :]


@pytest.mark.slow
def test_a_browser_shows_whom_a_planner_never_asked(finished: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(finished, tmp_path / "copy"))
    write_config(folder, {**CONFIG, "planner": "ranked", "planner_parameters": {"model": "openai:x"}})
    dom = browse(write_report(folder), 2, tmp_path / "profile", "--dump-dom").stdout
    assert "openai:x was asked nothing: no choice was close enough" in text_of(dom, "asked-total")


@pytest.mark.slow
def test_a_browser_shows_no_model_where_none_was_asked(asked: Path, finished: Path, tmp_path: Path) -> None:
    early = browse(asked / "report.html", 2, tmp_path / "profile", "--dump-dom").stdout
    assert "No model was asked at this step." in early
    assert 'The one next: <a href="#step=4">step 4</a>.' in early
    assert "The one before" not in re.sub(r"<script.*?</script>", "", early, flags=re.S)
    never = browse(finished / "report.html", 2, tmp_path / "profile", "--dump-dom").stdout
    assert re.search(r'id="asked-panel"[^>]*hidden', never)
    assert "No model was asked at this step." not in re.sub(r"<script.*?</script>", "", never, flags=re.S)


@pytest.mark.slow
def test_a_run_with_the_stand_in_is_called_a_wire_test(asked: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(asked, tmp_path / "copy"))
    write_config(folder, {**CONFIG, "planner": "dream", "planner_parameters": {"model": "wire:mute"}})
    dom = browse(write_report(folder), 2, tmp_path / "profile", "--dump-dom").stdout
    assert "A wire test" in text_of(dom, "asked-total")


REAL = {
    "version": "0.1.0",
    "protocol": "pool-v1",
    "world": "dive",
    "seed": 1,
    "planner": "belief",
    "command": "dream dive belief --area -1.8 -1.8 1.8 1.8",
    "dive": {"stand_in": False, "area": [-1.8, -1.8, 1.8, 1.8]},
}
"""`config.json` of a dive with a real vehicle."""
OF_A_DIVE = {
    **SUMMARY,
    "world": "dive",
    "world_hash": "",
    "ended": "done",
    "t_stop": 11,
    **dict.fromkeys(("t90", "t95", "t98", "t100", "collisions", "min_clearance_m", "success")),
    "coverage": dict.fromkeys(("instances", "clusters", "area", "visible")),
    "position_error_m": None,
    "drift": None,
    "dive": {
        "estimator": "inekf",
        "drive": "alt-hold",
        "command_lag_ms": {"p50": 1.4, "p99": 41.0},
        "late_beats": 3,
        "picture_age_ms": {"p50": 1.0, "p99": 9.0},
        "pictures": 1180,
        "pictures_per_s": 10.0,
        "packets_lost": 1,
        "link_loss": 0.004,
        "refused": {"dvl: too far from what was expected": 2},
        "log_lost": {},
        "behind_s": None,
    },
}
"""`summary.json` of one: what only a truth could tell is not there."""


@pytest.fixture(scope="module")
def real_dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dive")
    write_config(folder, REAL)
    steps = record(painted_mission(12), folder)
    for _ in steps:
        pass
    write_summary(folder, OF_A_DIVE)
    write_report(folder)
    return folder


def test_what_only_a_truth_could_tell_may_be_missing(real_dive: Path) -> None:
    summary = read_summary(real_dive)
    assert summary is not None
    assert (summary.world_hash, summary.success, summary.collisions) == ("", None, None)
    assert summary.coverage.instances is None
    run = json.loads(Page(real_dive / "report.html").scripts["run"])
    assert run["summary"]["success"] is None
    assert run["command"] == REAL["command"]


@pytest.mark.slow
def test_a_dive_that_was_cut_short_says_that_the_computer_was_too_slow(
    real_dive: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(real_dive, tmp_path / "cut")
    write_summary(folder, {**OF_A_DIVE, "ended": "aborted", "why": "dive: disarmed", "t_stop": None})
    shown = browse(write_report(folder), None, tmp_path / "profile", "--dump-dom").stdout
    assert "dive: disarmed. This computer did not keep up: of the 25 beats a second" in shown
    assert "3 came late" in shown
    whole = browse(real_dive / "report.html", None, tmp_path / "profile", "--dump-dom").stdout
    assert not re.search(r'id="outcome"[^<]*did not keep up', whole)


@pytest.mark.rare
@pytest.mark.slow
def test_out_of_steps_it_says_whether_it_called_the_mission_complete(tmp_path: Path) -> None:
    for name, region in (("never", ""), ("refused", "around (1, 2)")):
        (tmp_path / name).mkdir()
        folder = recorded(tmp_path / name, 3)
        lines = [json.loads(line) for line in (folder / "steps.jsonl").read_text().splitlines()]
        lines[1]["open_region"] = region
        (folder / "steps.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
        write_summary(folder, {**SUMMARY, "ended": "cap", "steps": 2, "t_stop": None, "success": False})
        shown = browse(write_report(folder), None, tmp_path / "profile", "--dump-dom").stdout
        head = re.search(r'id="outcome">([^<]*)<', shown)
        assert head
        assert ("without calling the mission complete" in head[1]) == (not region)
        assert ("complete at step 1, but the map's own check did not agree" in head[1]) == bool(region)


@pytest.mark.slow
def test_the_page_of_a_real_dive_claims_nothing_that_nobody_knows(real_dive: Path, tmp_path: Path) -> None:
    seen = browse(real_dive / "report.html", 5, tmp_path / "profile", "--dump-dom")
    shown = re.sub(r"<(script|pre|style).*?</\1>", "", seen.stdout, flags=re.DOTALL)
    assert "CONSOLE" not in seen.stderr
    assert "It stopped by itself at step 11." in shown
    claims = ("no contact", "seed 1", "is north", "World hash", "not reached", "null", "NaN", "undefined")
    for claim in claims:
        assert claim not in shown, claim
    assert "nobody knows what there was to see" in shown
    assert "too far from what was expected (2)" in shown
    assert "1 packet lost" in shown


SCROLLED = """() => new Promise((tell) => {
  let looks = 300;
  const look = () => {
    if (document.querySelector(".page").scrollTop > 0) tell(true);
    else if (--looks) requestAnimationFrame(look);
    else tell(false);
  };
  look();
})"""
"""Whether the page moves within some frames."""

LAID_OUT = """() => {
  const box = (node) => node.getBoundingClientRect();
  const page = document.querySelector(".page"), player = document.getElementById("player");
  page.scrollTo(0, page.scrollHeight);
  const last = box(document.querySelector("footer"));
  const parts = [...player.children].filter((node) => node.offsetParent !== null).map((node) => {
    const { left, right, top, bottom } = box(node);
    return [left, right, top, bottom, node.scrollWidth - node.clientWidth];
  });
  const written = [...document.querySelectorAll(".ticks span, .maplegend li")];
  return {
    page: [box(page).top, box(page).bottom], player: [box(player).top, box(player).bottom], last: last.bottom,
    parts, screen: [innerWidth, innerHeight], whole: document.documentElement.scrollHeight,
    sideways: page.scrollWidth - page.clientWidth,
    letters: written.map((node) => parseFloat(getComputedStyle(node).fontSize)),
    ticks: document.querySelectorAll(".ticks span").length,
  };
}"""


@pytest.mark.rare
@pytest.mark.slow
def test_the_player_covers_nothing_and_the_map_is_readable_on_every_screen(finished: Path) -> None:
    if CHROMIUM is None:
        do_without("needs Chromium to open the page with: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        for width, height in ((1366, 768), (1280, 800), (390, 844)):
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto((finished / "report.html").as_uri())
            page.wait_for_selector("html[data-ready]")
            page.keyboard.press("ArrowDown")
            assert page.evaluate(SCROLLED)
            found = page.evaluate(LAID_OUT)
            # What scrolls ends where the player begins; nothing else scrolls.
            assert found["page"][0] == 0
            top = found["player"][0] + 0.5  # Pixels are whole on a screen.
            assert found["page"][1] <= top
            assert found["player"][1] <= height == found["whole"]
            assert found["last"] <= top
            assert found["sideways"] == 0
            for (left, right, upper, lower, hidden), other in itertools.permutations(found["parts"], 2):
                assert 0 <= left < right <= width
                assert hidden <= 0, "all of it is written"
                aside = right <= other[0] or other[1] <= left
                assert aside or lower <= other[2] or other[3] <= upper, "no part lies on another"
            assert found["ticks"] == 18
            assert min(found["letters"]) >= 11.0
            page.close()
        browser.close()
