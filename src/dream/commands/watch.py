"""`dream watch`: runs in a browser, while they are written and after."""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass
from pathlib import Path

import tyro

from dream.commands.console import print_json
from dream.options import First

DEFAULT = Path("runs")
"""Where `dream run` leaves them."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Watch:
    """Show runs in a browser while they are flown and after: several side by side, at any step.

    It only reads the folders. From another machine the token is needed that stands in the printed address.

    Examples:
        dream watch
        dream watch runs/latest
    """

    runs: tyro.conf.Positional[tuple[Path, ...]] = (DEFAULT,)
    """Folders of runs, or folders that hold runs. New runs in them appear."""
    host: First[str] = "127.0.0.1"
    """Address at which to listen. 0.0.0.0 lets other machines connect; they need the token."""
    port: First[int | None] = None
    """Port at which to listen. Unless given, 8412, or a free one where that is taken."""
    token_file: First[Path | None] = None
    """File with the token that a browser has to give. Unless given, a token is made where others can
    connect."""
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
                    f"{run}: expected a folder that exists, or one below {DEFAULT}, which may still come; "
                    "got none"
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
