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
    """The vehicle, under a protocol in which it swims, such as dream-v1-nav."""

    vehicle: Literal["heavy", "bluerov2"] = "heavy"
    """A BlueROV2 Heavy with eight thrusters, or a BlueROV2 with six."""
    current: float = 0.1
    """Mean speed of the current, m/s."""
    gust: float = 0.03
    """How much the current varies, m/s."""
    dvl: Literal["standard", "performance"] = "standard"
    """Model of the DVL A50: the scale of its speeds errs by 1 %, or by 0.1 %."""
    dvl_losses: float = 0.0
    """Share of the time in which the DVL does not see the bottom, 0 to 1; each time lasts 3 s."""
    anchoring: bool = True
    """Do not correct the position by ground that is seen again."""
    fault: Annotated[str | None, tyro.conf.arg(metavar="WHAT@SECONDS")] = None
    """What fails, and when: a thruster as in dead:3@40, weak:1@40 or jammed:2@40, or the battery, lamp, depth
    sensor or camera as in sag@40, lamp@40, gauge@40 or camera@40."""

    def chosen(self, protocol: SurveyProtocol) -> Swimming | None:
        """None under a protocol by which nothing swims; a ValueError where something was chosen for it."""
        if not protocol.swims:
            if self != Swim():
                raise ValueError(
                    "--vehicle, --current, --gust, --dvl, --dvl-losses, --no-anchoring, --fault: expected a "
                    f"protocol by which a vehicle swims with them, got {protocol.name}. "
                    "Say --protocol dream-v2-nav"
                )
            return None
        from dream.robots import Anchoring, Motion, Swimming
        from dream.sim.sensors import DVL_A50, DVL_A50_PERFORMANCE, Bursts
        from dream.sim.vehicle import BLUEROV2, BLUEROV2_HEAVY
        from dream.vehicle import read_fault

        motion = Motion(
            vehicle={"heavy": BLUEROV2_HEAVY, "bluerov2": BLUEROV2}[self.vehicle],
            current=self.current,
            gust=self.gust,
            dvl={"standard": DVL_A50, "performance": DVL_A50_PERFORMANCE}[self.dvl],
            dvl_bursts=Bursts(share=self.dvl_losses),
            fault=None if self.fault is None else read_fault(self.fault),
        )
        return Swimming(motion, Anchoring() if self.anchoring else None)
