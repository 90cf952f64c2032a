"""Frames per CPU-second of the renderer, beside named peers on the same scenes, in one run.

    make perf          or: python perf/render.py --scene reef --poses 40

CPU time counts all threads of the process, so that a peer that uses many gains nothing. The median is over
poses; each pose takes the least of its rounds, since other programs only ever add time.
"""

from __future__ import annotations

import argparse
import math
import os
import platform
import time
from collections.abc import Callable

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "LP_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402

from dream.geometry import SE3, Camera  # noqa: E402
from dream.protocol import DREAM_V1  # noqa: E402
from dream.sim.render import Renderer  # noqa: E402
from dream.sim.world import Instances, World  # noqa: E402
from dream.sim.worlds import make_world  # noqa: E402
from peers import PEERS, Peer, soup_of  # noqa: E402


def crowded(count: int = 5000) -> World:
    """The reef of `reef/patch` with `count` clumps: as many as the densest beds would give."""
    base = make_world("reef/patch", 1)
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(base.targets), size=count)
    old = base.targets
    position = old.position[chosen].astype(np.float64)
    position[:, :2] += rng.normal(0.0, 1.2, (count, 2))
    position[:, 2] = base.terrain.height(position[:, 0], position[:, 1])
    targets = Instances(
        old.mesh[chosen],
        position.astype(np.float32),
        old.wxyz[chosen],
        old.scale[chosen],
        old.tint[chosen],
        old.group[chosen],
    )
    return World(
        name="crowded",
        seed=base.seed,
        protocol=base.protocol,
        bounds=base.bounds,
        starts=base.starts,
        terrain=base.terrain,
        meshes=base.meshes,
        targets=targets,
        hull=np.zeros(len(targets), np.bool_),
        obstacles=base.obstacles,
        water=base.water,
    )


SCENES: dict[str, Callable[[], World]] = {
    "reef": lambda: make_world("reef/string", 1),
    "crowded": crowded,
    "wreck": lambda: make_world("wreck/1", 1),
}


def poses_over(world: World, count: int) -> list[SE3]:
    """Poses at the survey's altitude that look at targets from 1 to 8 m."""
    rng = np.random.default_rng(0)
    poses = []
    for _ in range(count):
        x, y, _ = world.targets.position[rng.integers(len(world.targets))].astype(float)
        yaw, away = rng.uniform(-math.pi, math.pi), rng.uniform(1.0, 8.0)
        x, y = x - away * math.cos(yaw), y - away * math.sin(yaw)
        z = float(world.terrain.height(x, y)) + DREAM_V1.altitude
        poses.append(SE3.level(x, y, z, yaw) @ DREAM_V1.T_base_camera)
    return poses


def cpu_ms(draw: Callable[[Camera, SE3], object], camera: Camera, poses: list[SE3], rounds: int) -> float:
    """CPU milliseconds a frame, median over poses."""
    draw(camera, poses[0])
    taken = np.empty((rounds, len(poses)))
    for r in range(rounds):
        for p, pose in enumerate(poses):
            start = time.process_time()
            draw(camera, pose)
            taken[r, p] = time.process_time() - start
    return float(np.median(taken.min(axis=0)) * 1e3)


def contenders(world: World) -> tuple[list[Peer], list[str]]:
    """Ourselves, the peers that are there, and a sentence for each that is not."""
    renderer = Renderer(world)
    ready = [Peer("dream", renderer.measure, renderer.render, "texture, caustics, water, ids")]
    missing = []
    soup = soup_of(world)
    for name, make in PEERS.items():
        try:
            peer = make(world, soup)
            # A peer without a display fails only when it first draws.
            peer.measure(Camera.from_fov(64, 48, 1.5), poses_over(world, 1)[0])
            ready.append(peer)
        except ImportError as error:
            missing.append(f"{name}: not installed ({error})")
        except Exception as error:  # noqa: BLE001 - whatever keeps a peer from starting must not stop the rest
            missing.append(f"{name}: does not start here ({type(error).__name__}: {error})")
    return ready, missing


def main() -> None:
    """Print one table a scene."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--scene", choices=SCENES, nargs="*", default=["reef", "crowded"])
    parser.add_argument("--poses", type=int, default=24)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    machine = platform.processor() or platform.machine()
    print(f"{machine}, Python {platform.python_version()}, {os.cpu_count()} CPUs")
    for scene in arguments.scene:
        world = SCENES[scene]()
        peers, missing = contenders(world)
        poses = poses_over(world, arguments.poses)
        print(f"\n{scene}: {world.name}, {len(world.targets)} targets, water {world.water.name}")
        print(f"{'':24} {'size':>9} {'RGB + depth + labels':>31} {'depth + labels':>31}")
        columns = f"{'CPU ms':>9} {'frames/CPU-s':>13} {'ours':>7}"
        print(f"{'':24} {'px':>9} {columns} {columns}")
        for camera in (DREAM_V1.camera, DREAM_V1.camera.scaled(2)):
            ours: tuple[float, float] | None = None
            for peer in peers:
                drawn = cpu_ms(peer.draw, camera, poses, arguments.rounds)
                measured = cpu_ms(peer.measure, camera, poses, arguments.rounds)
                ours = ours or (drawn, measured)
                print(
                    f"{peer.name:24} {camera.width:>4} x {camera.height:<3}"
                    f"{drawn:>9.2f} {1e3 / drawn:>13.1f} {drawn / ours[0]:>6.1f}x"
                    f"{measured:>9.2f} {1e3 / measured:>13.1f} {measured / ours[1]:>6.1f}x"
                )
        for line in missing:
            print(line)
        for peer in peers:
            print(f"  {peer.name}: {peer.does}")
    print("\nours: how many times as fast as that row dream is, in the same run.")


if __name__ == "__main__":
    main()
