"""Options of the commands that fly a vehicle which swims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from dream.protocol import SurveyProtocol
    from dream.robots import Swimming


@dataclass(frozen=True, slots=True)
class Swim:
    """The vehicle, under a protocol by which it has to swim, such as dream-v1-nav."""

    vehicle: Literal["heavy", "bluerov2"] = "heavy"
    """A BlueROV2 Heavy with eight thrusters, or a BlueROV2 with six."""
    current: float = 0.1
    """m/s of the mean current."""
    gust: float = 0.03
    """m/s by which it varies."""
    dvl: Literal["standard", "performance"] = "standard"
    """Version of the DVL A50: 1 % or 0.1 % of scale."""
    dvl_losses: float = 0.0
    """Share of the time in which the DVL loses the bottom, in bursts of 3 s."""
    anchoring: Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: it is; this turns it off)")] = True
    """Whether the position is corrected by ground that is seen again."""

    def chosen(self, protocol: SurveyProtocol) -> Swimming | None:
        """None under a protocol by which nothing swims; a ValueError where something was chosen for it."""
        if not protocol.swims:
            if self != Swim():
                raise ValueError(
                    "--vehicle, --current, --gust, --dvl, --dvl-losses, --no-anchoring: expected a protocol "
                    f"by which a vehicle swims with them, got {protocol.name}. Say --protocol dream-v1-nav"
                )
            return None
        from dream.robots import Anchoring, Motion, Swimming
        from dream.sim.sensors import DVL_A50, DVL_A50_PERFORMANCE, Bursts
        from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY

        motion = Motion(
            vehicle={"heavy": BLUEROV2_HEAVY, "bluerov2": BLUEROV2}[self.vehicle],
            current=self.current,
            gust=self.gust,
            dvl={"standard": DVL_A50, "performance": DVL_A50_PERFORMANCE}[self.dvl],
            dvl_bursts=Bursts(share=self.dvl_losses),
        )
        return Swimming(motion, Anchoring() if self.anchoring else None)
