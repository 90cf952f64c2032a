"""The pictures of pages in the documentation, as Chromium shows them.

    python perf/pictures.py mission runs/latest    → docs/mission.png: the report of what `make run` flies
    python perf/pictures.py watch runs             → docs/watching.png: the live page of a folder, best
                                                     taken while a mission flies in it

Each is at most 400 kB. Needs Chromium and what `make test` installs.
"""

from __future__ import annotations

import argparse
import io
import shutil
import threading
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

WIDTH = 1280
SETTLED_MS = 1500


def shot(address: str, height: int) -> bytes:
    """A page in light colours, as a PNG."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        page = browser.new_page(viewport={"width": WIDTH, "height": height}, color_scheme="light")
        page.goto(address)
        page.wait_for_selector("html[data-ready]:not([data-ready='0'])")
        page.wait_for_timeout(SETTLED_MS)
        taken = page.screenshot()
        browser.close()
    buffer = io.BytesIO()
    Image.open(io.BytesIO(taken)).convert("RGB").save(buffer, "png", optimize=True)
    return buffer.getvalue()


def watched(runs: Path) -> bytes:
    """The live page of a folder of runs."""
    from dream.live.doors import Doors
    from dream.live.server import listen, serve

    listening, over = listen("127.0.0.1", 0), threading.Event()
    told = ([runs], Doors(), listening, lambda _: over.is_set())
    serving = threading.Thread(target=serve, args=told)
    serving.start()
    try:
        return shot(f"http://localhost:{listening.getsockname()[1]}/", 1110)
    finally:
        over.set()
        serving.join()


def main() -> None:
    """Take the picture that is asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("mission", "watch"))
    parser.add_argument("of", type=Path)
    parser.add_argument("--step", type=int, default=76, help="of the mission")
    given = parser.parse_args()
    if given.what == "mission":
        page = (given.of.resolve() / "report.html").as_uri()
        path, content = Path("docs/mission.png"), shot(f"{page}#step={given.step}", 1160)
    else:
        path, content = Path("docs/watching.png"), watched(given.of)
    path.write_bytes(content)
    print(f"{path}: {len(content) / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
