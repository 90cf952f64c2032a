"""A server beside a mission: a process of its own, which gives way to the mission and outlives no one.

The two share only a pipe. While the mission holds its end, the page is served; once it lets go, or dies, the
page is served as long as somebody has it open.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from dream import extras
from dream.live.doors import Doors
from dream.live.server import Pages, address, listen, serve

NICER = 5
"""By which the server's process yields to the mission's."""
LINGER_S = 3.0
"""Seconds without a page after which it ends, once the mission is over: one that reloads is back by then."""


def check_installed() -> None:
    """Raise a ValueError where what a server needs is not installed."""
    extras.check_installed("live", "a live page", "fastapi", "uvicorn")


@contextlib.contextmanager
def shown_live(folder: Path) -> Iterator[None]:
    """Serve a run's folder while the block runs, and after it until its last page is closed, or Ctrl-C.

    The address is told on standard error once the server is up; the mission does not wait for that.
    """
    server = subprocess.Popen(
        # Modules that lie in the working directory are none of ours.
        [sys.executable, "-P", "-m", "dream.live.beside", str(folder)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,  # Ctrl-C is for the mission.
    )
    assert server.stdin is not None
    assert server.stdout is not None
    telling = threading.Thread(target=_tell, args=(server,), daemon=True)
    telling.start()
    try:
        yield
        with contextlib.suppress(OSError):
            server.stdin.close()
        with contextlib.suppress(KeyboardInterrupt):
            server.wait()
    finally:
        server.terminate()
        server.wait()
        with contextlib.suppress(OSError):
            server.stdin.close()
        telling.join()
        server.stdout.close()


def _tell(server: subprocess.Popen[str]) -> None:
    assert server.stdout is not None
    for line in server.stdout:
        with contextlib.suppress(OSError, ValueError):
            sys.stderr.write(f"dream: {json.loads(line)}\n")


def main() -> None:
    """The server's process: shows the folder that it is given."""
    with contextlib.suppress(OSError, AttributeError):
        os.nice(NICER)
    mission_over = threading.Event()

    def wait_for_end() -> None:
        while sys.stdin.buffer.read(1):
            pass
        mission_over.set()

    threading.Thread(target=wait_for_end, daemon=True).start()
    told = False

    def over(pages: Pages) -> bool:
        nonlocal told
        if not mission_over.is_set() or (pages.open == 0 and time.monotonic() - pages.left > LINGER_S):
            return mission_over.is_set()
        if pages.open and not told:
            told = True
            _say("still serving the page: close it in the browser, or press Ctrl-C")
        return False

    doors = Doors()
    listening = listen(doors.host, None)
    _say(f"watch it at {address(doors, listening)}")
    with contextlib.suppress(KeyboardInterrupt):
        serve([Path(sys.argv[1])], doors, listening, over)


def _say(line: str) -> None:
    with contextlib.suppress(OSError):
        sys.stdout.write(json.dumps(line) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
