"""The page in a real browser, beside a run that grows under it."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("fastapi")
pytest.importorskip("uvicorn")
pytest.importorskip("playwright")
from playwright.sync_api import Browser, Page, expect, sync_playwright

from dream.live import server
from dream.live.doors import Doors
from dream.live.folders import Watched
from dream.live.server import listen, serve
from tests.live.runs import STEPS, Growing
from tests.live.test_space import put
from tests.programs import CHROMIUM, do_without

pytestmark = pytest.mark.slow
Make = Callable[..., Growing]
HOSTILE = "</p><script>document.title='owned'</script><img src=x onerror=alert(1)>"
TOKEN = "a-token-of-some-length"


class Shown:
    """A server that can be stopped and started again at the same place."""

    def __init__(self, *places: Path, doors: Doors | None = None) -> None:
        self.places = list(places)
        self.doors = doors or Doors()
        self.port = 0
        self.start()

    def start(self) -> None:
        listening = listen("127.0.0.1", self.port)
        self.port = listening.getsockname()[1]
        self.end = threading.Event()
        told = (self.places, self.doors, listening, lambda pages: self.end.is_set())
        self.thread = threading.Thread(target=serve, args=told)
        self.thread.start()

    def stop(self) -> None:
        self.end.set()
        self.thread.join()

    @property
    def address(self) -> str:
        return f"http://localhost:{self.port}/"


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
def page(browser: Browser, complaints: list[str]) -> Iterator[Page]:
    context = browser.new_context(viewport={"width": 1400, "height": 900})
    page = context.new_page()
    page.set_default_timeout(20_000)
    expect.set_options(timeout=20_000)
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    yield page
    context.close()


@pytest.fixture
def show(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Shown]]:
    monkeypatch.setattr(server, "LOOK_S", 0.05)
    shown: list[Shown] = []

    def started(*places: Path, **options: Any) -> Shown:
        shown.append(Shown(*places, **options))
        return shown[-1]

    yield started
    for one in shown:
        one.stop()


def counter(page: Page, step: int, of: int) -> None:
    expect(page.locator("#counter")).to_contain_text(f"Step {step} of {of} ")


def painted(page: Page, canvas: str) -> int:
    """How many colours a picture has."""
    script = """(id) => {
      const canvas = document.getElementById(id);
      const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      return new Set(new Uint32Array(data.buffer)).size;
    }"""
    colours: int = page.evaluate(script, canvas)
    return colours


def test_a_mission_is_followed_and_can_be_gone_back_in(
    page: Page, complaints: list[str], show: Callable[..., Shown], growing: Make
) -> None:
    run = growing(words=HOSTILE, planner=HOSTILE).write(3)
    shown = show(run.folder)
    page.goto(shown.address)
    counter(page, 2, 2)
    expect(page.locator("#badge")).to_have_text("Under way")
    expect(page.locator("#how")).to_contain_text("</p><script>")
    expect(page.locator("#reasoning")).to_contain_text("Turn 30° left")
    page.wait_for_timeout(300)
    assert min(painted(page, canvas) for canvas in ("map", "rgb", "depth", "labels")) >= 3
    run.write()
    counter(page, 3, 3)
    page.keyboard.press("Home")
    counter(page, 0, 3)
    page.keyboard.press("ArrowRight")
    counter(page, 1, 3)
    run.write()
    counter(page, 1, 4)  # Whoever looks back is not torn away.
    page.wait_for_url("**/#run=*&step=1")
    page.reload()
    counter(page, 1, 4)
    page.get_by_role("button", name="Live").click()
    counter(page, 4, 4)
    run.write()
    counter(page, 5, 5)
    run.end(ended="cap", t_stop=None, success=False)
    expect(page.locator("#badge")).to_have_text("Out of steps")
    assert complaints == []
    assert page.title() != "owned"


def test_a_page_that_was_out_of_sight_for_an_hour_keeps_up(
    page: Page, complaints: list[str], show: Callable[..., Shown], growing: Make
) -> None:
    # No frame is drawn of a page that nobody sees: all that was asked for comes when it is looked at again.
    page.add_init_script("""
      let slept = 0;
      const clock = performance.now.bind(performance), frame = requestAnimationFrame.bind(window);
      performance.now = () => clock() + slept;
      window.requestAnimationFrame = (drawn) => frame((time) => { slept += 3.6e6; drawn(time); });
    """)
    run = growing().write(3)
    page.goto(show(run.folder).address)
    counter(page, 2, 2)
    run.write()
    counter(page, 3, 3)
    run.write()
    counter(page, 4, 4)
    assert not complaints


@pytest.mark.rare
def test_a_scene_grows_with_its_run_and_goes_with_it(
    page: Page, complaints: list[str], show: Callable[..., Shown], growing: Make
) -> None:
    flat, deep = growing("flat").write(2), growing("deep", world="wreck/1").write(3)
    shown = show(flat.folder, deep.folder)
    page.goto(shown.address)
    counter(page, 1, 1)
    expect(page.locator("#space-panel")).to_be_hidden()
    page.locator(".card", has_text="wreck/1").click()
    counter(page, 2, 2)
    expect(page.locator("#space-panel")).to_be_hidden()
    put(deep, 3)
    expect(page.locator("#space-counts")).to_have_text("ball: 1 of 2 inspected, 1 seen")
    page.locator("#space-view").scroll_into_view_if_needed()
    expect(page.locator("#space")).to_have_attribute("data-drawn", re.compile("[1-9]"))
    page.keyboard.press("ArrowLeft")
    counter(page, 1, 2)
    expect(page.locator("#space-counts")).to_have_text("ball: 0 of 2 inspected, 0 seen")
    page.keyboard.press("End")
    (deep.folder / "space.npz").write_bytes(b"nothing")
    expect(page.locator("#space-note")).to_contain_text("space.npz: expected a scene")
    put(deep, 3)
    expect(page.locator("#space-note")).to_be_hidden()
    page.locator(".card", has_text="reef/string").click()
    expect(page.locator("#space-panel")).to_be_hidden()
    assert [line for line in complaints if "WebGL" not in line] == []


@pytest.mark.rare
def test_a_lost_connection_is_told_and_made_up_for(
    page: Page, show: Callable[..., Shown], growing: Make
) -> None:
    run = growing().write(2)
    shown = show(run.folder)
    page.goto(shown.address)
    counter(page, 1, 1)
    shown.stop()
    expect(page.locator("#lost")).to_contain_text("No connection; trying again. The newest step shown is")
    expect(page.locator("#link")).to_have_text("not connected")
    run.write(3)
    shown.start()
    counter(page, 4, 4)
    expect(page.locator("#lost")).to_be_hidden()
    # Without a gap, and nothing twice: going back passes each step once.
    for step in (3, 2, 1, 0):
        page.keyboard.press("ArrowLeft")
        counter(page, step, 4)


@pytest.mark.rare
def test_a_connection_that_nobody_answers_is_given_up(
    page: Page, show: Callable[..., Shown], growing: Make
) -> None:
    run = growing().write(2)
    shown = show(run.folder)
    page.goto(shown.address)
    counter(page, 1, 1)
    shown.stop()
    silent = listen("127.0.0.1", shown.port)
    silent.settimeout(20.0)
    connection, _ = silent.accept()
    silent.close()
    run.write(3)
    shown.start()
    with connection:
        counter(page, 4, 4)
    expect(page.locator("#lost")).to_be_hidden()


@pytest.mark.rare
def test_a_server_that_still_reads_is_waited_for(
    page: Page, show: Callable[..., Shown], growing: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Longer than a connection that nobody answers is waited for."""
    look = Watched.look

    def slow(watched: Watched) -> None:
        time.sleep(0.0 if len(list(watched)) else 9.0)
        look(watched)

    monkeypatch.setattr(Watched, "look", slow)
    run = growing().write(2)
    page.goto(show(run.folder).address)
    counter(page, 1, 1)


@pytest.mark.rare
def test_missions_stand_side_by_side_and_new_ones_appear(
    page: Page, complaints: list[str], show: Callable[..., Shown], growing: Make
) -> None:
    one = growing("one").write(2)
    shown = show(one.folder.parent)
    page.goto(shown.address)
    counter(page, 1, 1)
    expect(page.locator("#missions")).to_be_hidden()
    other = growing("two", planner="lawnmower", seed=8).write(4)
    cards = page.locator(".card")
    expect(cards).to_have_count(2)
    counter(page, 1, 1)  # The one that was open stays.
    page.locator(".card", has_text="lawnmower").press("Enter")
    counter(page, 3, 3)
    expect(page.locator("#how")).to_contain_text("lawnmower")
    other.write()
    one.write(2)
    counter(page, 4, 4)
    expect(page.locator(".card", has_text="sixsteps")).to_contain_text("step 3")
    page.reload()
    expect(page.locator("#how")).to_contain_text("lawnmower")
    counter(page, 4, 4)
    page.locator(".card", has_text="sixsteps").click()
    counter(page, 3, 3)
    expect(page.locator("#reasoning")).to_contain_text("Turn 30° left")
    assert complaints == []


def test_on_a_phone_it_fits_and_with_a_token_it_opens(
    page: Page, complaints: list[str], show: Callable[..., Shown], growing: Make
) -> None:
    for name in ("one", "two", "three"):
        run = growing(name).write(STEPS)
        run.end(ended="done")
    shown = show(run.folder.parent, doors=Doors("127.0.0.1", TOKEN))
    page.set_viewport_size({"width": 360, "height": 740})
    refused = page.goto(shown.address)
    assert refused is not None
    assert refused.status == 401
    page.goto(f"{shown.address}?token={TOKEN}")
    expect(page.locator("#counter")).to_contain_text(f"Step {STEPS - 1}")
    assert TOKEN not in page.url
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    player = page.locator("#player").bounding_box()
    assert player is not None
    assert player["y"] + player["height"] <= 741
    for _ in range(40):  # Every control can be reached by keyboard, and shows that it was.
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "back":
            break
    page.keyboard.press("Enter")
    expect(page.locator("#counter")).to_contain_text(f"Step {STEPS - 2}")
    assert [said for said in complaints if "401" not in said] == []
