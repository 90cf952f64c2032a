"""The page to fly at, in a real browser: keys become steps."""

from __future__ import annotations

import math
from collections.abc import Iterator

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")
pytest.importorskip("playwright")
from playwright.sync_api import Browser, Page, expect, sync_playwright

from dream.live import cockpit
from dream.protocol import DREAM_V1, DREAM_V2_TRUE
from dream.sim.worlds import make_world
from tests.live.flying import TOKEN, Flying, flown
from tests.programs import CHROMIUM, do_without

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
def complaints() -> list[str]:
    return []


@pytest.fixture
def page(browser: Browser, complaints: list[str], monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    monkeypatch.setattr(cockpit, "LINGER_S", 0.2)
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    page = context.new_page()
    page.set_default_timeout(60_000)
    expect.set_options(timeout=60_000)
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    yield page
    context.close()


def address(flying: Flying) -> str:
    return f"http://localhost:{flying.port}/?token={TOKEN}"


def my_turn(page: Page, flown: int, of: int) -> None:
    expect(page.locator("#counter")).to_have_text(f"Step {flown} of {of}")
    expect(page.locator("#state")).to_have_text("Your turn")


@pytest.mark.rare
def test_keys_put_steps_together_and_the_mission_flies_them(page: Page, complaints: list[str]) -> None:
    with flown(make_world("flat/empty", 1), DREAM_V1, 8) as flying:
        page.goto(address(flying))
        my_turn(page, 3, 8)
        next_step = page.locator("#next")
        for key in ("ArrowLeft", "a", "w", "ArrowUp"):
            page.keyboard.press(key)
        expect(next_step).to_have_text("turn 60° left, 2 m ahead")
        page.keyboard.press("s")
        page.keyboard.press("d")
        expect(next_step).to_have_text("turn 30° left, 1 m ahead")
        page.keyboard.press("Shift+ArrowRight")
        expect(next_step).to_have_text("turn 60° right, 1 m ahead")
        page.keyboard.press("Escape")
        page.keyboard.press("Enter")  # Nothing is put together: no step is spent by mistake.
        expect(page.locator("#refused")).to_contain_text("Nothing is put together yet")
        page.keyboard.press("Shift+A")
        page.keyboard.press("Shift+W")
        expect(page.locator("#ahead path")).to_have_count(2)
        page.keyboard.press("Enter")
        my_turn(page, 4, 8)
        expect(page.locator("#last")).to_contain_text("Turn 90° left, then advance 2 m")
        page.reload()  # Whoever comes back goes on.
        my_turn(page, 4, 8)
        page.keyboard.press("m")
        page.keyboard.press("ArrowUp")
        my_turn(page, 5, 8)
        page.keyboard.press("h")
        my_turn(page, 6, 8)
        page.keyboard.press("c")
        expect(page.locator("#sure")).to_be_visible()
        page.keyboard.press("n")
        expect(page.locator("#sure")).to_be_hidden()
        my_turn(page, 6, 8)
        page.keyboard.press("c")
        page.keyboard.press("y")
        my_turn(page, 7, 8)
        expect(page.locator("#last")).to_contain_text("Not complete")
        page.get_by_role("button", name="turn right").click()
        expect(page.locator("#state")).to_have_text("Over")
        decided = [(round(math.degrees(s.decision.turn)), s.decision.advance) for s in flying.steps[4:]]
        assert decided == [(90, 2.0), (0, 1.0), (0, 0.0), (0, 0.0), (-30, 0.0)]
        flying.helm.end(("12.0% of the individuals were seen.",))
        expect(page.locator("#say")).to_contain_text(
            "All steps are spent. 12.0% of the individuals were seen."
        )
        assert complaints == []


@pytest.mark.rare
def test_in_space_it_climbs_and_tilts_and_fits_a_phone(page: Page, complaints: list[str]) -> None:
    with flown(make_world("flat/empty", 1), DREAM_V2_TRUE, 6) as flying:
        page.set_viewport_size({"width": 390, "height": 844})
        page.goto(address(flying))
        my_turn(page, 3, 6)
        for key in ("r", "Shift+R", "f", "g"):
            page.keyboard.press(key)
        expect(page.locator("#next")).to_have_text("climb 0.5 m, camera 45° down")
        page.keyboard.press("t")
        expect(page.locator("#next")).to_have_text("climb 0.5 m")
        page.keyboard.press("Shift+G")
        page.get_by_role("button", name="Go").click()
        my_turn(page, 4, 6)
        expect(page.locator("#where")).to_contain_text("45° down")
        for tab in ("Level", "Upright"):
            page.get_by_role("button", name=tab).click()
            expect(page.locator("#known")).to_have_attribute("alt", tab)
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        helm = page.locator(".helm").bounding_box()
        assert helm is not None
        assert helm["y"] + helm["height"] <= 845
        climbed = flying.steps[4].decision
        assert (climbed.climb, round(math.degrees(climbed.tilt or 0.0))) == (0.5, 45)
        assert complaints == []


@pytest.mark.rare
def test_a_second_browser_only_watches(page: Page, browser: Browser) -> None:
    with flown(make_world("flat/empty", 1), DREAM_V1, 6) as flying:
        page.goto(address(flying))
        my_turn(page, 3, 6)
        other = browser.new_context().new_page()
        other.goto(address(flying))
        expect(other.locator("#say")).to_contain_text("Another page is at the helm")
        expect(other.locator("#go")).to_be_disabled()
        other.keyboard.press("m")
        other.keyboard.press("ArrowUp")
        page.keyboard.press("ArrowLeft")
        page.keyboard.press("Enter")
        my_turn(page, 4, 6)
        expect(other.locator("#counter")).to_have_text("Step 4 of 6")
        assert flying.steps[4].decision.advance == 0.0
        other.context.close()
