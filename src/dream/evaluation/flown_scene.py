"""What a mission in space leaves to look at: what was mapped, what there was, and where the vehicle went."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from dream import scene
from dream.protocol import SurveyProtocol
from dream.recording import RecordedStep

if TYPE_CHECKING:
    from dream.evaluation.metrics import Scorer
    from dream.mapping.volume import Volume
    from dream.sim.world import World

KINDS = ("oysters", "hull")
"""Kinds of target, in the order of `World.hull`."""


def write_scene(
    folder: Path,
    volume: Volume,
    steps: Sequence[RecordedStep],
    world: World,
    scorer: Scorer,
) -> None:
    """Write `space.npz`, and `volume.png` with what was mapped of it, into the folder of a run.

    Args:
        folder: Of the run.
        volume: What was mapped.
        steps: Where the vehicle went.
        world: Where it was flown.
        scorer: Who was given all of its steps so far.

    Raises:
        OSError: It cannot be written.
    """
    from dream.mapping.space_drawing import draw_oblique

    shown = _scene(volume, steps, world, scorer)
    scene.save(shown, folder / scene.SPACE)
    if len(shown.voxels.positions):
        draw_oblique(volume, path=shown.path.positions).save(folder / "volume.png")


def _scene(volume: Volume, steps: Sequence[RecordedStep], world: World, scorer: Scorer) -> scene.RunScene:
    protocol, bounds, surface = volume.protocol, world.bounds, volume.surface()
    low = min(float(surface.middles[:, 2].min(initial=0.0)), float(world.terrain.heights.min()))
    targets, obstacles, seabed = _there_was(world, scorer)
    camera = protocol.camera
    return scene.made(
        title=f"{world.name} {world.seed}",
        bounds=[[bounds.x_min, bounds.y_min, low], [bounds.x_max, bounds.y_max, 0.0]],
        water=0.0,
        field_of_view=(
            camera.horizontal_fov,
            2.0 * math.atan(0.5 * camera.height / camera.fy),
        ),
        targets=targets,
        obstacles=obstacles,
        seabed=seabed,
        voxels=scene.mapped(
            volume.cell,
            surface.middles,
            surface.target > 0.5,
            np.zeros(len(surface.middles), np.int64),
            np.where(surface.sides > 0, 0, -1),
        ),
        path=_path(steps, protocol),
    )


def _there_was(
    world: World, scorer: Scorer
) -> tuple[scene.Targets, npt.NDArray[np.float64], scene.HeightGrid]:
    from dream.sim.visibility import triangles_of

    triangles, first = triangles_of(world.meshes, world.targets)
    others, _ = triangles_of(world.meshes, world.obstacles)
    targets = scene.Targets(
        triangles=triangles,
        owner=np.repeat(np.arange(len(world.targets)), np.diff(first)),
        kinds=KINDS,
        kind=world.hull.astype(np.uint8),
        seen_at=scorer.first_at_any_angle,
        inspected_at=scorer.first_found,
    )
    terrain = world.terrain
    return targets, others, scene.HeightGrid(terrain.heights, terrain.x0, terrain.y0, terrain.spacing)


def _path(steps: Sequence[RecordedStep], protocol: SurveyProtocol) -> scene.Path:
    where = [step.pose if step.truth is None else step.truth for step in steps]
    z = [pose.z or 0.0 for pose in where]
    told = protocol.camera_pitch
    tilts = [told := told if step.guarded.tilt is None else step.guarded.tilt for step in steps]
    return scene.Path(
        np.array([step.step for step in steps], np.int32),
        np.column_stack([[p.x for p in where], [p.y for p in where], z]).astype(np.float32).reshape(-1, 3),
        np.array([p.yaw for p in where], np.float32),
        np.array(tilts, np.float32),
        np.array([step.collided for step in steps], np.bool_),
    )
