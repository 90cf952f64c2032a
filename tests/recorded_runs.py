"""A mission without a simulator: a flat seabed with round reefs and one boulder, seen in closed form.

The images, the map and the steps are real; no planner decides and nothing is in the way.
"""

from __future__ import annotations

import errno
import json
import math
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dream.geometry import SE2, SE3, Bounds
from dream.mapping import OccupancyMap
from dream.planning.vlm import pictures
from dream.protocol import DREAM_V1
from dream.types import LOOK_AROUND, Arrival, Decision, Exchange, Guarded, Label, Observation, Reasoning, Step

SEABED = -10.0
REEFS = ((6.0, 1.0, 2.0), (8.5, 5.0, 1.8), (-5.0, 7.0, 2.6), (-9.0, -3.0, 1.7), (2.0, -9.0, 2.2))
"""x, y and radius of each."""
BOULDER = np.array([3.5, 4.5, -9.2])
BOULDER_RADIUS = 1.3


def painted_observation(index: int, pose: SE2, rng: np.random.Generator) -> Observation:
    """What a camera over that seabed sees, under blue-green water."""
    camera = DREAM_V1.camera
    T_world_base = SE3.level(pose.x, pose.y, SEABED + DREAM_V1.altitude, pose.yaw)
    T_world_camera = T_world_base @ DREAM_V1.T_base_camera
    rays = (
        camera.back_project(np.ones((camera.height, camera.width)), T_world_camera)
        - T_world_camera.translation
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        ground = np.where(rays[..., 2] < 0.0, -DREAM_V1.altitude / rays[..., 2], np.inf)
        offset = T_world_camera.translation - BOULDER
        a, b = (rays**2).sum(-1), rays @ offset
        rock = (-b - np.sqrt(b * b - a * (offset @ offset - BOULDER_RADIUS**2))) / a
    rock = np.where(rock > 0.0, rock, np.inf)
    depth = np.minimum(ground, rock)
    depth[depth > DREAM_V1.max_depth] = np.nan
    p_world = T_world_camera.translation + rays * np.nan_to_num(depth, nan=0.0)[..., None]
    x, y = p_world[..., 0], p_world[..., 1]
    labels = np.where(np.isfinite(depth), Label.SEABED, Label.WATER).astype(np.uint8)
    ripple = np.sin(9.0 * x) * np.cos(8.0 * y + 2.0 * np.sin(3.0 * x))
    for reef_x, reef_y, radius in REEFS:
        shells = (np.hypot(x - reef_x, y - reef_y) < radius) & (ripple > 0.15) & (labels == Label.SEABED)
        labels[shells] = Label.TARGET
    labels[np.isfinite(depth) & (rock < ground)] = Label.OBSTACLE
    albedo = np.array([[0.3, 0.4, 0.45], [0.66, 0.62, 0.52], [0.92, 0.88, 0.80], [0.36, 0.34, 0.31]])[labels]
    albedo *= 1.0 + 0.10 * ripple[..., None] + rng.normal(0.0, 0.05, (camera.height, camera.width, 1))
    distance = (np.nan_to_num(depth, nan=60.0) * np.sqrt(a))[..., None]
    light = albedo * np.exp(-distance * np.array([0.30, 0.07, 0.06]))
    light += np.array([0.02, 0.24, 0.34]) * (1.0 - np.exp(-distance * np.array([0.4, 0.12, 0.10])))
    return Observation(
        time=4.0 * index,
        rgb=np.clip(255.0 * np.sqrt(np.clip(light, 0.0, 1.0)), 0, 255).astype(np.uint8),
        depth=depth.astype(np.float32),
        labels=labels,
        camera=camera,
        T_world_base=T_world_base,
        T_base_camera=DREAM_V1.T_base_camera,
    )


def painted_mission(count: int, *, said: str = "") -> Iterator[Step]:
    """`count` steps along a spiral; every reasoning field ends with `said`."""
    rng = np.random.default_rng(7)
    occupancy = OccupancyMap(Bounds(-20.0, -20.0, 20.0, 20.0), DREAM_V1)
    before = SE2(0.0, 0.0, 0.0)
    for index in range(count):
        angle = 0.11 * index
        pose = SE2(
            0.09 * index * math.cos(angle),
            0.09 * index * math.sin(angle),
            math.remainder(angle + 1.5, math.tau),
        )
        observation = painted_observation(index, pose, rng)
        occupancy.integrate(
            observation.depth, observation.labels, observation.camera, observation.T_world_camera
        )
        last = index == count - 1
        reasoning = Reasoning(
            distribution=f"Target cells form {1 + index // 12} regions, the largest 6.2 m east of me. {said}",
            target_area=f"I am at the edge of the eastern region; {3.5 * index:.0f} m² are mapped. {said}",
            completion=f"Its northern side is open over 4.5 m, so the region is not complete. {said}",
            next_target=f"The open edge 3.0 m north-east is next: 2.8 m to go, 11 m² to gain. {said}",
            safety=f"The nearest solid cell is 1.9 m to the left; a straight move clears it by 0.8 m. {said}",
            action=f"Turn 30° left and advance 2 m. {said}",
        )
        asked = (
            Decision(done=True, reasoning=reasoning)
            if last
            else Decision(math.pi / 6, 2.0, reasoning=reasoning)
        )
        if index == 0:
            asked = Decision()
        shortened = index % 9 == 5 and not last
        carried_out = Decision(math.pi / 6, 1.0) if shortened else asked
        yield Step(
            index=index,
            decision=asked,
            guarded=Guarded(carried_out, "solid ground 1.4 m ahead" if shortened else ""),
            arrival=Arrival(
                pose,
                collided=index == 31,
                distance=pose.distance(before),
                clearance=math.inf if index < 3 else 1.25,
            ),
            observation=observation,
            occupancy=occupancy,
            open_region="6 m² at (4.5, −2.0) could still be seen" if index == 40 else "",
            ended="done" if last else "",
            planner_s=0.004 + 0.001 * (index % 5),
        )
        before = pose


def painted_coverage(step: Step) -> dict[str, Any]:
    """A curve that saturates."""
    share = 1.0 - math.exp(-step.index / 22.0)
    return {"coverage": {"instances": min(1.0, 1.02 * share), "clusters": share**2, "area": 0.97 * share}}


def exchange(**changes: Any) -> Exchange:
    """A question that was answered at once; `changes` overwrite it."""
    values: dict[str, Any] = {
        "prompt": "dream 1, legend 1, oysters 1",
        "model": "openai:painted",
        "question": "You are the planner of an underwater robot.\n\n[map]\n\nThe robot is at x = 1 m.",
        "pictures": {},
        "replies": ('{"direction": "left", "turn_deg": 30, "step_m": 2, "done": false}',),
        "fallback": "",
        "requests": 1,
        "tokens_in": 2500,
        "tokens_out": 210,
        "cost_usd": 0.0075,
        "seconds": 3.25,
        "expected": {"properties": {"turn_deg": {"enum": [0, 30, 60, 90, 180]}}},
    }
    return Exchange(**(values | changes))


def painted_pictures(step: Step) -> dict[str, bytes]:
    """What a planner that asks a model shows it."""
    shown = pictures.map_picture(step.occupancy, step.arrival.pose, np.empty((0, 2)))
    return {**pictures.camera_pictures(step.observation), "map": pictures.png(shown)}


def asking_mission(count: int, *, said: str = "") -> Iterator[Step]:
    """The same mission flown by a planner that asks a model; some replies do not count."""
    for step in painted_mission(count, said=said):
        if step.index <= LOOK_AROUND:
            yield step
            continue
        reasoning = step.decision.reasoning
        reply = {name: getattr(reasoning, name) for name in type(reasoning).__slots__}
        good = json.dumps({**reply, "direction": "left", "turn_deg": 30, "step_m": 2, "done": False})
        overruled = f"overruled: place 7, which costs 5.2 steps, 2.0 are allowed{said}"
        outcome = "followed" if step.index % 2 else overruled
        asked = exchange(pictures=painted_pictures(step), replies=(good,), outcome=outcome)
        if step.index % 5 == 0:
            lacks = ("no JSON object", "step_m: Field required; up" + said)
            why = f"invalid: {lacks[-1]}, asked twice"
            bad = ("I would turn left. " + said, '{"direction": "up"}')
            asked = replace(
                asked, replies=bad, lacks=lacks, fallback=why, outcome="", requests=2, cost_usd=None
            )
        decision = replace(step.decision, exchanges=(asked,), waited=12.0 * asked.requests)
        yield replace(step, decision=decision)


CONFIG: dict[str, Any] = {
    "version": "0.1.0",
    "commit": "18b7f94",
    "protocol": "dream-v1",
    "bounds": {"x_min": -20.0, "y_min": -20.0, "x_max": 20.0, "y_max": 20.0},
    "world": "reef/string",
    "seed": 3,
    "planner": "sixsteps",
    "max_steps": None,
    "began": "2026-11-21T06:01:09Z",
}

SUMMARY: dict[str, Any] = {
    "protocol": "dream-v1",
    "world": "reef/string",
    "seed": 3,
    "world_hash": "9f2c51a07be3d846",
    "planner": "sixsteps",
    "ended": "done",
    "steps": 119,
    "t_stop": 119,
    "t_claimed": 40,
    "t90": 48,
    "t95": 60,
    "t98": 73,
    "t100": 87,
    "coverage": {"instances": 1.0, "clusters": 0.991, "area": 0.966},
    "collisions": 0,
    "distance_m": 171.4,
    "turns": 62,
    "min_clearance_m": 0.42,
    "planner_ms": {"p50": 6.1, "p99": 8.0},
    "wall_s": 21.7,
    "vlm": None,
    "success": True,
}


class Disk:
    """The disk that runs are written to, which may be full."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.full = False
        for owner, name in ((Image.Image, "save"), (Path, "write_text"), (OccupancyMap, "save")):
            monkeypatch.setattr(owner, name, self._until_full(getattr(owner, name)))

    def _until_full(self, write: Any) -> Any:
        def writes(*arguments: Any, **options: Any) -> Any:
            path = next((one for one in arguments[:2] if isinstance(one, Path)), None)
            if not self.full or path is None:
                return write(*arguments, **options)
            path.write_bytes(b"as much as there was room for")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        return writes
