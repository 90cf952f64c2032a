"""The view in three dimensions in the report, in a real browser: with WebGL by software, and without."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from dream.geometry import SE2
from dream.recording import record, write_config, write_summary
from dream.report import write_report
from dream.scene import NEVER, SPACE, RunScene, encoded, save
from dream.types import Step
from tests.programs import CHROMIUM, do_without
from tests.recorded_runs import CONFIG, SUMMARY, painted_coverage, painted_mission
from tests.test_report import Page

Array = npt.NDArray[Any]

STEPS = 9


def flown(path: Any) -> Iterator[Step]:
    for step, (x, y, _), yaw in zip(painted_mission(STEPS), path.positions, path.yaw, strict=False):
        yield replace(step, arrival=replace(step.arrival, pose=SE2(float(x), float(y), float(yaw))))


@pytest.fixture(scope="module")
def run(wreck: RunScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a few steps, in which all that is seen is seen by the last of them."""
    folder = tmp_path_factory.mktemp("space")
    write_config(folder, {**CONFIG, "planner": "orbits"})
    for _ in record(flown(wreck.path), folder, annotate=painted_coverage):
        pass
    write_summary(folder, SUMMARY)
    every = len(wreck.path.step) // STEPS
    path = wreck.path
    kept = slice(0, every * STEPS, every)
    short = replace(
        path,
        step=np.arange(STEPS, dtype=np.int32),
        positions=path.positions[kept],
        yaw=path.yaw[kept],
        tilt=path.tilt[kept],
        collided=path.collided[kept],
    )
    seen_at, inspected_at = (
        np.where(at == NEVER, NEVER, at // every).astype(np.uint16)
        for at in (wreck.seen_at, wreck.inspected_at)
    )
    save(replace(wreck, path=short, seen_at=seen_at, inspected_at=inspected_at), folder / SPACE)
    write_report(folder)
    return folder


@pytest.mark.rare
def test_the_page_holds_the_scene_and_its_viewer(run: Path, wreck: RunScene) -> None:
    page = Page(run / "report.html")
    told = json.loads(page.scripts["space-data"])
    assert told["problem"] is None
    assert told["scene"]["surfaces"] == json.loads(json.dumps(encoded(wreck)["surfaces"]))
    assert "webgl2" in page.scripts["module"]
    assert all(load.startswith(("data:", "#")) for load in page.loads)
    assert "unsafe" not in page.policy


def test_a_page_without_a_scene_has_no_trace_of_the_viewer(run: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(run, tmp_path / "planar"))
    (folder / SPACE).unlink()
    text = write_report(folder).read_text(encoding="utf-8")
    assert "space-panel" not in text
    assert "webgl" not in text


def test_a_damaged_scene_is_told_in_the_page(run: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(run, tmp_path / "damaged"))
    (folder / SPACE).write_bytes((folder / SPACE).read_bytes()[:1000])
    told = json.loads(Page(write_report(folder)).scripts["space-data"])
    assert told["scene"] is None
    assert told["problem"].startswith("The view in three dimensions is left out. space.npz: expected a scene")
    assert str(tmp_path) not in told["problem"]


# ---- in a browser


@pytest.fixture(scope="module")
def browsers() -> Iterator[Any]:
    """`browsers(flat)`: one with WebGL, or one without."""
    if CHROMIUM is None:
        do_without("needs Chromium to open the page with: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api")
    by_software = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as started:
        opened = {}

        def browser(flat: bool) -> Any:
            if flat not in opened:
                how = ["--disable-gpu", "--disable-3d-apis"] if flat else by_software
                opened[flat] = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *how])
            return opened[flat]

        yield browser
        for one in opened.values():
            one.close()


class View:
    """A page that shows a run; what it complains of is kept."""

    def __init__(self, browser: Any, folder: Path, step: int | None = None, **options: Any) -> None:
        self.complaints: list[str] = []
        options = {"viewport": {"width": 1200, "height": 800}, "reduced_motion": "reduce", **options}
        self.page = browser.new_context(**options).new_page()
        self.page.set_default_timeout(30_000)
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto((folder / "report.html").as_uri() + ("" if step is None else f"#step={step}"))
        self.page.wait_for_selector("html[data-ready]")

    def picture(self) -> Array:
        """(H, W, 3) of the canvas, once nothing is to be drawn any more."""
        self.page.locator("#space-view").scroll_into_view_if_needed()
        self.page.wait_for_selector("#space[data-drawn]:not([data-moving])")
        self.page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => setTimeout(drawn, 30)))")
        png = self.page.locator("#space-view").screenshot()
        with Image.open(io.BytesIO(png)) as image:
            return np.asarray(image.convert("RGB")).astype(int)

    @property
    def drawn(self) -> int:
        """How often it was drawn."""
        return int(self.page.locator("#space").get_attribute("data-drawn"))

    def close(self) -> None:
        self.page.context.close()


def near(picture: Array, color: tuple[int, int, int], most: int = 40) -> int:
    """How many pixels have nearly that colour."""
    return int((np.abs(picture - color).max(axis=2) < most).sum())


SCROLLED_UP = """(before) => new Promise((tell) => {
  let looks = 300;
  const look = () => {
    if (document.querySelector(".page").scrollTop < before) tell(true);
    else if (--looks) requestAnimationFrame(look);
    else tell(false);
  };
  look();
})"""
"""Whether the page moves up within some frames; its policy lets nothing wait for words."""

LOST_AND_FOUND = """() => new Promise((back) => {
  const canvas = document.getElementById("space");
  const card = canvas.getContext("webgl2").getExtension("WEBGL_lose_context");
  const later = (what) => requestAnimationFrame(() => setTimeout(what, 50));
  canvas.addEventListener("webglcontextlost", () => later(() => card.restoreContext()), { once: true });
  canvas.addEventListener("webglcontextrestored", () => later(back), { once: true });
  card.loseContext();
})"""
"""The card takes the memory of the view back, and gives it again."""

BEYOND = """() => {
  const page = document.querySelector(".page");
  const parts = [...document.querySelectorAll("#space-panel *")].filter((node) => !node.closest("svg"));
  const boxes = parts.map((node) => node.getBoundingClientRect()).filter((box) => box.width > 0);
  const beyond = boxes.map(({ left, right }) => Math.max(right - innerWidth, -left));
  return [page.scrollWidth - page.clientWidth, ...beyond];
}"""
"""By how many pixels parts of the panel reach beyond the screen."""

INSPECTED, UNSEEN = (170, 215, 204), (122, 28, 92)


@pytest.mark.rare
@pytest.mark.slow
@pytest.mark.parametrize("flat", [False, True], ids=["webgl", "flat"])
def test_the_scene_is_drawn_as_of_the_step_that_is_chosen(flat: bool, browsers: Any, run: Path) -> None:
    view = View(browsers(flat), run)
    view.page.click("[data-layer=path]")  # Its edges blend to the colour of what is inspected.
    last = view.picture()
    assert len(np.unique(last.reshape(-1, 3), axis=0)) > (20 if flat else 1000)
    view.page.keyboard.press("Home")
    first = view.picture()
    assert near(first, UNSEEN) > 2 * near(last, UNSEEN)
    assert near(last, INSPECTED) > 1.3 * near(first, INSPECTED) + 300
    assert "hull:" in view.page.locator("#space-counts").inner_text()
    assert view.page.locator("#space-views").is_visible() != flat
    label = view.page.locator("#space").get_attribute("aria-label")
    assert label.startswith("wreck/1 seed 1004 in three dimensions at step 0. hull: ")
    assert view.complaints == []
    view.close()


@pytest.mark.rare
@pytest.mark.slow
def test_layers_views_mouse_and_keys_change_the_picture_and_nothing_else_does(
    browsers: Any, run: Path
) -> None:
    view = View(browsers(False), run)
    page, seen = view.page, [view.picture()]

    def differs() -> None:
        seen.append(view.picture())
        assert all((seen[-1] != before).mean() > 0.002 for before in seen[:-1])

    for name in ("mapped", "truth", "path"):
        page.click(f"[data-layer={name}]")
        differs()
    for name in ("mapped", "truth", "path"):
        page.click(f"[data-layer={name}]")
    for name in ("side", "above", "behind"):
        page.click(f"[data-view={name}]")
        assert page.locator(f"[data-view={name}]").get_attribute("aria-pressed") == "true"
        differs()
    page.click("[data-view=oblique]")
    np.testing.assert_array_equal(view.picture(), seen[0])
    counted = view.drawn
    page.wait_for_timeout(300)
    assert view.drawn == counted
    page.locator("#space").scroll_into_view_if_needed()
    box = page.locator("#space").bounding_box()
    page.mouse.move(box["x"] + 300, box["y"] + 200)
    page.mouse.down()
    page.mouse.move(box["x"] + 380, box["y"] + 210, steps=3)
    page.mouse.up()
    differs()
    assert page.locator("[data-view=oblique]").get_attribute("aria-pressed") == "false"
    step = page.locator("#counter").inner_text()
    for key in ("ArrowLeft", "Shift+ArrowUp", "+"):
        page.keyboard.press(key)
        differs()
    assert page.locator("#counter").inner_text() == step
    page.mouse.wheel(0, 240)
    differs()
    assert page.evaluate("document.querySelector('.page').scrollTop") > 0
    page.keyboard.press("0")
    inside = np.s_[8:-8, 8:-8]  # Of the ring of what keys go to.
    np.testing.assert_allclose(view.picture()[inside], seen[0][inside], atol=8)
    assert view.complaints == []
    view.close()


@pytest.mark.slow
def test_the_wheel_scrolls_the_page_until_the_view_was_clicked(browsers: Any, run: Path) -> None:
    view = View(browsers(False), run)
    page = view.page
    page.locator("#space").scroll_into_view_if_needed()
    view.picture()
    box, drawn = page.locator("#space").bounding_box(), view.drawn
    before = page.evaluate("document.querySelector('.page').scrollTop")
    page.mouse.move(box["x"] + 300, box["y"] + 100)
    page.mouse.wheel(0, -120)
    assert page.evaluate(SCROLLED_UP, before)
    assert view.drawn == drawn
    view.close()


@pytest.mark.rare
@pytest.mark.slow
def test_a_view_whose_card_took_its_memory_back_is_drawn_again(browsers: Any, run: Path) -> None:
    view = View(browsers(False), run)
    before, drawn = view.picture(), view.drawn
    view.page.evaluate(LOST_AND_FOUND)
    assert view.drawn > drawn
    np.testing.assert_allclose(view.picture(), before, atol=8)
    view.close()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.rare)])
def test_it_fits_a_phone_and_two_fingers_zoom(scheme: str, browsers: Any, run: Path) -> None:
    phone: dict[str, Any] = {
        "viewport": {"width": 360, "height": 740},
        "has_touch": True,
        "color_scheme": scheme,
    }
    view = View(browsers(False), run, **phone)
    page = view.page
    page.locator("#space").scroll_into_view_if_needed()
    before = view.picture()
    assert max(page.evaluate(BEYOND)) <= 0
    box = page.locator("#space").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    touch = page.context.new_cdp_session(page)
    for apart in (40, 60, 80, 110):
        touch.send(
            "Input.dispatchTouchEvent",
            {
                "type": "touchStart" if apart == 40 else "touchMove",
                "touchPoints": [{"x": x - apart, "y": y, "id": 0}, {"x": x + apart, "y": y, "id": 1}],
            },
        )
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    after = view.picture()
    assert near(after, INSPECTED) > 2 * near(before, INSPECTED)
    assert view.complaints == []
    view.close()


@pytest.mark.slow
def test_of_a_damaged_scene_the_page_shows_a_note_and_all_else(
    browsers: Any, run: Path, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(run, tmp_path / "damaged"))
    (folder / SPACE).write_bytes(b"nothing")
    write_report(folder)
    view = View(browsers(True), folder, 3)
    assert view.page.locator("#space-note").inner_text().startswith("The view in three dimensions is left")
    assert not view.page.locator("#space-body").is_visible()
    assert view.page.locator("#counter").inner_text().startswith("Step 3 of 8")
    assert view.complaints == []
    view.close()


@pytest.mark.rare
@pytest.mark.slow
def test_what_a_scene_says_is_shown_as_text(
    browsers: Any, run: Path, wreck: RunScene, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(run, tmp_path / "hostile"))
    hostile = "</script><script>document.title='owned'</script><img src=x onerror=alert(1)>"
    save(replace(wreck, title=hostile, kinds=(hostile,)), folder / SPACE)
    write_report(folder)
    view = View(browsers(False), folder)
    view.picture()
    assert "owned" not in view.page.title()
    assert view.page.locator("#space-counts").inner_text().startswith("</script>")
    assert view.complaints == []
    view.close()
