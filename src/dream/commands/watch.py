"""`dream watch`: runs in a browser, while they are written and after."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.console import print_json

DEFAULT = Path("runs")
"""Where `dream run` leaves them."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Watch:
    """Show runs in a browser as they are flown: several side by side, and back to any step.

    It only reads the folders. Who is on another machine needs the token in the address that is printed.
    """

    runs: tyro.conf.Positional[tuple[Path, ...]] = (DEFAULT,)
    """Folders of runs, or folders that hold them, whose new ones appear; what is in `runs`
    may still be to come."""
    host: str = "127.0.0.1"
    """Address to listen at. Others can connect at any but this machine's own, and need the token then."""
    port: int | None = None
    """Port to listen at; 8412 unless given, or a free one where that is taken."""
    token_file: Path | None = None
    """File with the token that a page has to bring; where others can connect, one is made unless given."""
    json: bool = False
    """Print the address as one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0, once Ctrl-C ends it."""
        from dream.live.beside import check_installed
        from dream.live.doors import Doors, is_loopback, made_token
        from dream.live.server import address, listen, serve

        check_installed()
        if self.port is not None and not 0 <= self.port <= 65535:
            raise ValueError(f"--port: expected 0 to 65535, got {self.port}")
        if self.token_file is not None:
            token = self.token_file.read_text(encoding="utf-8").strip()
        else:
            token = "" if is_loopback(self.host) else made_token()
        for run in self.runs:
            if not run.is_dir() and DEFAULT not in (run, *run.parents):
                raise ValueError(
                    f"{run}: expected the folder of a run, or one that holds some, got none. What is still "
                    f"to begin is waited for in {DEFAULT} only"
                )
        doors = Doors(self.host, token)
        listening = listen(self.host, self.port)
        opened = address(doors, listening)
        if self.json:
            print_json({"address": opened})
        else:
            print(f"watch at {opened}\nCtrl-C ends it", flush=True)
        for run in self.runs:
            if not run.exists():
                logger.warning("watch: %s is not there yet; it is shown once it is", run)
        with contextlib.suppress(KeyboardInterrupt), contextlib.closing(listening):
            serve(list(self.runs), doors, listening, lambda pages: False)
        return 0
