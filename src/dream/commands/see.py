"""What pictures are made labels and depth by, in a simulated world."""

from __future__ import annotations

from typing import Literal

from dream import extras
from dream.protocol import DREAM_V2, DREAM_V2_SEEN

See = Literal["told", "learned"]
"""`told` by the simulator, with the errors that the protocol declares; `learned`, by a network."""


def protocol_seen(name: str | None, see: See) -> str | None:
    """The name of the protocol under which it is flown; None for that of the world.

    Raises:
        ValueError: There is none for sight like that, or what runs the network is not installed.
    """
    if see == "learned" and name not in (None, DREAM_V2.name, DREAM_V2_SEEN.name):
        raise ValueError(f"--see: expected --protocol {DREAM_V2.name} with learned, got {name}")
    if see == "learned" or name == DREAM_V2_SEEN.name:
        extras.check_installed("learned", f"--protocol {DREAM_V2_SEEN.name}", "onnxruntime")
        return DREAM_V2_SEEN.name
    return name
