"""A mission gives the same bytes on every processor, as far as one processor can act as others.

Each setting is a process of its own, since a processor is looked at when a program begins. Run as a program,
this file writes what it finds: `python -m tests.test_any_processor FOLDER`.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dream.cli import run_command
from dream.geometry import SE3, Camera
from dream.protocol import PROTOCOLS
from dream.sim.files import world_hash
from dream.sim.render import Renderer
from dream.sim.worlds import make_world

pytestmark = [pytest.mark.slow, pytest.mark.rare]

ROOT = Path(__file__).parent.parent
WORLDS = ("flat/empty", "reef/string", "reef/K", "wreck/1", "pool/arc")
CAMERA = Camera.from_fov(160, 120, math.radians(90.0))
MISSIONS = (("belief", "reef/string"), ("belief", "pool/arc"))
STEPS = 8


def beyond_the_least() -> str:
    """What NumPy computes with here and need not: other processors lack it, and round otherwise."""
    core: Any = importlib.import_module("numpy._core._multiarray_umath")
    return " ".join(name for name in core.__cpu_dispatch__ if core.__cpu_features__.get(name))


OTHERS = {
    "numba": {"NUMBA_CPU_NAME": "generic"},
    "numpy": {"NPY_DISABLE_CPU_FEATURES": beyond_the_least()},
    "blas": {"OPENBLAS_CORETYPE": "Nehalem"},
    "libm": {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"},
}
"""What makes each of the libraries that compute take a lesser processor for granted."""


def look(name: str) -> dict[str, str]:
    """Hash of a world and of three views of it."""
    world = make_world(name, 1)
    found = {f"{name} itself": world_hash(world)}
    renderer, protocol, start = Renderer(world), PROTOCOLS[world.protocol], world.starts[0]
    z = float(world.terrain.height(start.x, start.y)) + protocol.altitude
    for turn in range(3):
        pose = SE3.level(start.x, start.y, z, start.yaw + 2.0 * turn) @ protocol.T_base_camera
        frame = renderer.render(CAMERA, pose)
        for image in ("rgb", "depth", "labels", "ids"):
            found[f"{name}, view {turn}: {image}"] = _hash(getattr(frame, image).tobytes())
    return found


def fly(planner: str, world: str, folder: Path) -> dict[str, str]:
    """Hash of every file of a short mission that its times are not in, and of its steps without them."""
    out = folder / f"{planner}_{world.replace('/', '-')}"
    options = ["--world", world, "--max-steps", str(STEPS), "--keep-observations", "--out", str(out)]
    assert run_command(["run", planner, *options, "--json"]) == 0
    found = {}
    for path in sorted((out / "latest").rglob("*")):
        if path.suffix in (".png", ".npz"):
            found[f"{out.name}: {path.relative_to(out / 'latest')}"] = _hash(path.read_bytes())
    for line in (out / "latest/steps.jsonl").read_text().splitlines():
        step = json.loads(line)
        del step["planner_ms"]
        found[f"{out.name}: step {step['step']}"] = _hash(json.dumps(step).encode())
    return found


def _hash(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _under(setting: dict[str, str], folder: Path) -> dict[str, str]:
    environment = {**os.environ, **setting, "PYTHONWARNINGS": "ignore"}
    command = [sys.executable, "-m", "tests.test_any_processor", str(folder)]
    subprocess.run(command, cwd=ROOT, env=environment, check=True, stdout=subprocess.DEVNULL)
    found: dict[str, str] = json.loads((folder / "found.json").read_text())
    return found


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return _under({}, tmp_path_factory.mktemp("here"))


def test_all_of_it_is_compared(here: dict[str, str]) -> None:
    assert sum("view" in name for name in here) == len(WORLDS) * 12
    for planner, world in MISSIONS:
        names = {name.partition(": ")[2] for name in here if name.startswith(f"{planner}_{world[:4]}")}
        assert "map.npz" in names
        for step in range(STEPS + 1):
            shown = f"{step:04d}"
            assert {f"step {step}", f"frames/{shown}_rgb.png", f"observations/{shown}.npz"} <= names


@pytest.mark.parametrize("library", OTHERS)
def test_another_processor_gives_the_same_bytes(library: str, here: dict[str, str], tmp_path: Path) -> None:
    there = _under(OTHERS[library], tmp_path)
    assert [name for name in here if there.get(name) != here[name]] == []
    assert there.keys() == here.keys()


if __name__ == "__main__":
    into = Path(sys.argv[1])
    seen = {what: digest for name in WORLDS for what, digest in look(name).items()}
    for case in MISSIONS:
        seen |= fly(*case, into)
    (into / "found.json").write_text(json.dumps(seen))
