"""What a three-dimensional picture of a run shows, as plain arrays: made, kept, drawn in a page, handed on.

It knows no simulator, map or recording. Positions are metres in the world, east, north and up.
"""

from dream.scene.building import HeightGrid, Targets, made, mapped
from dream.scene.encoding import encoded
from dream.scene.files import SPACE, load, save
from dream.scene.parts import NEVER, Path, RunScene, SceneState, SceneSurface, Voxels

__all__ = [
    "NEVER",
    "SPACE",
    "HeightGrid",
    "Path",
    "RunScene",
    "SceneState",
    "SceneSurface",
    "Targets",
    "Voxels",
    "encoded",
    "load",
    "made",
    "mapped",
    "save",
]
