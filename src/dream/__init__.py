"""DREAM: an underwater robot that finds and maps a habitat without knowing where it is.

`__all__` is the interface for other programs; docs/python.md shows it in use and says what is promised.
A name is imported when it is first asked for, so that `import dream` costs milliseconds.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dream.kept_kernels import drop_outdated

if TYPE_CHECKING:
    from dream.course import Pilot, Planner
    from dream.evaluation.results import read_results
    from dream.evaluation.runner import fly_mission, simulate
    from dream.geometry import SE2, SE3, Bounds, Camera, camera_mount
    from dream.mapping.frontiers import frontiers
    from dream.mapping.gain import gain
    from dream.mapping.occupancy import OccupancyMap
    from dream.planning import PLANNERS
    from dream.protocol import protocol_named
    from dream.recording import read_config, read_steps, read_summary
    from dream.sim.files import load_world, save_world
    from dream.sim.water import water_named
    from dream.sim.world import World
    from dream.sim.worlds import make_world
    from dream.types import Decision, Label, Mission, Observation, Reasoning, Step

__version__ = "0.1.0"

# Before any of them is loaded.
drop_outdated(Path(__file__).parent)

__all__ = [
    "PLANNERS",
    "SE2",
    "SE3",
    "Bounds",
    "Camera",
    "Decision",
    "Label",
    "Mission",
    "Observation",
    "OccupancyMap",
    "Pilot",
    "Planner",
    "Reasoning",
    "Step",
    "World",
    "camera_mount",
    "fly_mission",
    "frontiers",
    "gain",
    "load_world",
    "make_world",
    "protocol_named",
    "read_config",
    "read_results",
    "read_steps",
    "read_summary",
    "save_world",
    "simulate",
    "water_named",
]

_WHERE = {
    "course": ("Pilot", "Planner"),
    "evaluation.results": ("read_results",),
    "evaluation.runner": ("fly_mission", "simulate"),
    "geometry": ("SE2", "SE3", "Bounds", "Camera", "camera_mount"),
    "mapping.frontiers": ("frontiers",),
    "mapping.gain": ("gain",),
    "mapping.occupancy": ("OccupancyMap",),
    "planning": ("PLANNERS",),
    "protocol": ("protocol_named",),
    "recording": ("read_config", "read_steps", "read_summary"),
    "sim.files": ("load_world", "save_world"),
    "sim.water": ("water_named",),
    "sim.world": ("World",),
    "sim.worlds": ("make_world",),
    "types": ("Decision", "Label", "Mission", "Observation", "Reasoning", "Step"),
}

# A checker of types must not see it: it would take every name for one of ours.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """A name of `__all__`, from the module that it lives in."""
        for module, names in _WHERE.items():
            if name in names:
                globals()[name] = value = getattr(import_module(f"dream.{module}"), name)
                return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        """What a prompt offers."""
        return sorted({*globals(), *__all__})
