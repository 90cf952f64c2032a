"""The page to teach on, in a real browser: strokes become labels, and a model."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")
pytest.importorskip("playwright")
from playwright.sync_api import Browser, Page, expect, sync_playwright

from dream.perception import LearnedLabels
from dream.types import Label
from tests.programs import CHROMIUM, do_without
from tests.teaching.lessons import scene
from tests.teaching.teaching import TOKEN, TaughtHead, taught
from tests.teaching.test_session import dots

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    if CHROMIUM is None:
        do_without("needs Chromium to open the page with: apt-get install chromium")
    with sync_playwright() as playwright:
        quiet = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--disable-background-networking"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=quiet)
        yield browser
        browser.close()


@pytest.fixture
def lesson(tmp_path: Path) -> Iterator[TaughtHead]:
    with taught(tmp_path) as found:
        yield found


@pytest.fixture
def complaints() -> list[str]:
    return []


@pytest.fixture
def page(browser: Browser, complaints: list[str], lesson: TaughtHead) -> Iterator[Page]:
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    page.set_default_timeout(60_000)
    expect.set_options(timeout=60_000)
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"http://localhost:{lesson.port}/?token={TOKEN}")
    expect(page.locator("#thumbs li img.plain")).to_have_count(5)
    yield page
    context.close()


def look_at(page: Page, number: int) -> None:
    page.locator("#thumbs button").nth(number).click()
    expect(page.locator("#name")).to_have_text(f"p{number}")
    expect(page.locator("#shown")).to_have_attribute("src", f"/pictures/{number}/shown")


def drag(page: Page, points: list[tuple[float, float]]) -> None:
    """With the mouse, along shares of the picture that is shown."""
    box = page.locator("#stack").bounding_box()
    assert box is not None
    on = [(box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in points]
    page.mouse.move(*on[0])
    page.mouse.down()
    for point in on[1:]:
        page.mouse.move(*point)
    page.mouse.up()


def mark(page: Page, number: int) -> None:
    """Six strokes, as a person draws them."""
    look_at(page, number)
    for key, target in (("t", True), ("n", False)):
        page.keyboard.press(key)
        places = [stroke.points[0] for stroke in dots(number, target=target, every=12)]
        for x, y in places[:: max(1, len(places) // 3)][:3]:
            drag(page, [(x - 0.004, y), (x + 0.004, y)])


@pytest.mark.rare
def test_strokes_become_labels_a_figure_and_a_model(
    page: Page, lesson: TaughtHead, complaints: list[str], tmp_path: Path
) -> None:
    expect(page.locator("#state")).to_have_text("mark")
    expect(page.locator("#say")).to_have_text("Next: mark some shell, with a few strokes.")
    expect(page.locator("#save")).to_be_disabled()
    mark(page, 0)
    expect(page.locator("#labels")).to_be_visible()
    expect(page.locator("#thumbs img.over")).to_have_count(5)
    expect(page.locator("#figure")).to_have_text("not measured")
    expect(page.locator("#meaning")).to_contain_text("target is marked in 1 of at least 3 pictures")
    expect(page.locator(".tag.next")).to_have_count(1)
    mark(page, 1)
    mark(page, 2)
    expect(page.locator("#figure")).to_contain_text("IoU ")
    expect(page.locator("#thumbs .tag").first).to_contain_text("IoU ")
    expect(page.locator("#count")).to_have_text("3 of 5 marked")
    page.locator("#save").click()
    model = tmp_path / "out/shell.onnx"
    expect(page.locator("#line")).to_have_text(f"dream dive --labels {model}")
    rgb, inside = scene(9, (360, 480))
    found = LearnedLabels(model).segment(rgb)[0] == Label.TARGET
    assert (found & inside).sum() / (found | inside).sum() > 0.8
    page.reload()  # Whoever comes back goes on.
    expect(page.locator("#count")).to_have_text("3 of 5 marked")
    expect(page.locator("#figure")).to_contain_text("IoU ")
    assert complaints == []


@pytest.mark.rare
def test_keys_choose_tools_pictures_and_take_back(
    page: Page, lesson: TaughtHead, complaints: list[str]
) -> None:
    marks = lesson.session.folder / "marks/p1.png"
    page.keyboard.press("ArrowRight")
    expect(page.locator("#name")).to_have_text("p1")
    page.keyboard.press("x")
    expect(page.locator('[data-tool="box"]')).to_have_attribute("aria-pressed", "true")
    drag(page, [(0.1, 0.1), (0.3, 0.2), (0.5, 0.5)])
    expect(page.locator("#marks")).to_be_visible()
    expect(page.locator("#back")).to_be_enabled()
    assert marks.is_file()
    page.keyboard.press("m")
    expect(page.locator("#marks")).to_be_hidden()
    page.keyboard.press("Control+z")
    expect(page.locator("#back")).to_be_disabled()
    assert not marks.exists()
    page.keyboard.press("b")
    page.keyboard.press("]")
    drag(page, [(0.2, 0.2), (0.4, 0.4)])
    expect(page.locator("#clear")).to_be_enabled()
    page.locator("#clear").click()
    expect(page.locator("#clear")).to_be_disabled()
    assert not marks.exists()
    before = page.locator("#stack").bounding_box()
    page.mouse.wheel(0, -400)
    page.keyboard.press("0")
    assert page.locator("#stack").bounding_box() == before
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#name")).to_have_text("p0")
    assert complaints == []


@pytest.mark.rare
def test_it_fits_a_phone_and_says_when_the_server_is_gone(page: Page, lesson: TaughtHead) -> None:
    page.set_viewport_size({"width": 390, "height": 844})
    expect(page.locator("#stack")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    foot = page.locator(".foot").bounding_box()
    assert foot is not None
    assert foot["y"] + foot["height"] <= 844.5
    page.context.set_offline(True)
    expect(page.locator("#state")).to_have_text("no connection")
    page.context.set_offline(False)
    expect(page.locator("#state")).to_have_text("mark")
