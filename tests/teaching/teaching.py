"""The server of a session, and as much of a browser as that needs."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from dream.live.doors import Doors
from dream.live.server import listen
from dream.teaching.pictures import pictures_in
from dream.teaching.server import serve
from dream.teaching.session import Session
from tests.teaching.lessons import save_picture, scene, texture

TOKEN = "a-token-of-some-length"
WAIT_S = 60.0


@dataclass
class TaughtHead:
    session: Session
    port: int


@contextlib.contextmanager
def taught(folder: Path, count: int = 5) -> Iterator[TaughtHead]:
    """A session on pictures of disks, and its page; texture alone."""
    for n in range(count):
        save_picture(folder / f"photos/p{n}.jpg", scene(n, (360, 480))[0])
    session = Session(pictures_in(folder / "photos"), texture(), folder / "out", "shell")
    listening, over = listen("127.0.0.1", 0), threading.Event()
    port = listening.getsockname()[1]
    thread = threading.Thread(
        target=serve, args=(session, Doors("127.0.0.1", TOKEN), listening, over.is_set), daemon=True
    )
    thread.start()
    try:
        yield TaughtHead(session, port)
    finally:
        over.set()
        thread.join(WAIT_S)
        assert not thread.is_alive()
