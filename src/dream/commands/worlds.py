"""`dream worlds` and `dream draw`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from dream.commands.console import check_picture, open_world, print_json
from dream.protocol import protocol_named

if TYPE_CHECKING:
    from PIL import Image

    from dream.sim.world import World


@dataclass(frozen=True, slots=True)
class Worlds:
    """List the worlds that can be named, save one as a folder to edit, or check such a folder.

    --check FOLDER reads all of it and says, line by line, what is refused and has to be mended, what was
    turned (faces that looked inwards), and what was taken in another way than it stands there (polygons
    split, vertices without colour). It ends with status 1 where anything is refused. docs/worlds.md says what
    a folder holds.
    """

    save: str | None = None
    """Save this world instead of listing."""
    check: Path | None = None
    """Check the world in this folder instead, and say all that is amiss at once."""
    seed: int = 1
    """Which world of that name."""
    out: Path = Path("world")
    """Folder to save to."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status: 0, or 1 where what is checked is refused."""
        from dream.sim.files import save_world, world_hash
        from dream.sim.worlds import WORLDS, make_world

        if self.check is not None:
            if self.save is not None:
                raise ValueError("--check: expected a folder alone, got --save with it. Choose one of them")
            return _checked(self.check, json=self.json)
        if self.save is not None:
            world = make_world(self.save, self.seed)
            save_world(world, self.out)
            record = {
                "world": world.name,
                "seed": world.seed,
                "hash": world_hash(world),
                "folder": str(self.out),
            }
            if self.json:
                print_json(record)
            else:
                print(f"saved {world.name} {world.seed}; fly it with: dream run --world {self.out}")
        elif self.json:
            print_json({"worlds": list(WORLDS)})
        else:
            print("\n".join(WORLDS))
            print("\nAny seed makes another of each.")
            print("reef/string+1y1 is reef/string 1 year on, in the first of its fates; so with all reefs.")
        return 0


def _checked(folder: Path, *, json: bool) -> int:
    """Say what becomes of each part of the world in a folder; the exit status."""
    from dream.sim.files import examine, world_hash
    from dream.sim.worlds import check_folder

    if not folder.is_dir():
        check_folder(folder)
    examined = examine(folder)
    world, said = examined.world, examined.said
    if json:
        findings = [{"what": one.what, "file": one.file, "words": one.words} for one in said]
        print_json(
            {
                "folder": str(folder),
                "fit": world is not None,
                "hash": None if world is None else world_hash(world),
                "findings": findings,
            }
        )
        return 0 if world is not None else 1
    for one in said:
        print(f"{one.what:8} {one}")
    if world is None:
        refused = sum(one.what == "refused" for one in said)
        print(f"{folder}: refused, {refused} thing{'s' * (refused > 1)} to mend")
        return 1
    count = (
        f"meshes: {len(world.meshes)}, individuals: {len(world.targets)}, obstacles: {len(world.obstacles)}"
    )
    print(f"{folder}: fit to fly; {count}. Look at it: dream draw --world {folder}")
    return 0


@dataclass(frozen=True, slots=True)
class Draw:
    """Draw a world as a picture: its chart from above, and what the camera sees from two of its starts."""

    world: str = "reef/string"
    """A name from `dream worlds`, or a folder that holds a saved world."""
    seed: int = 1
    """Which world of that name."""
    out: Path | None = None
    """Picture to write; `WORLD-SEED.png` unless given."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.sim.chart import chart
        from dream.sim.files import world_hash

        if self.out is not None:
            check_picture(self.out, "--out")
        world = open_world(self.world, self.seed)
        word = re.sub(r"[^\w.+]+", "-", world.name).strip("-")
        out = self.out or Path(f"{word}-{world.seed}.png")
        check_picture(out, "--out")
        _portrait(world, chart(world)).save(out)
        if self.json:
            print_json(
                {"world": world.name, "seed": world.seed, "hash": world_hash(world), "picture": str(out)}
            )
        else:
            counts = f"{len(world.targets)} individuals, {len(world.obstacles)} obstacles"
            print(f"{world.name} {world.seed}: {counts} → {out}")
        return 0


def _portrait(world: World, above: Image.Image) -> Image.Image:
    """The chart, and beside it what the camera sees from the first two starts, as a model is shown it."""
    from PIL import Image

    from dream.geometry import SE3
    from dream.sim.render import Renderer

    protocol, renderer = protocol_named(world.protocol), Renderer(world)
    camera = protocol.camera.scaled(2.0)
    picture = Image.new("RGB", (above.width + camera.width, max(above.height, 2 * camera.height)), "white")
    picture.paste(above, (0, 0))
    for k, start in enumerate(world.starts[:2]):
        seabed = float(world.terrain.height(start.x, start.y))
        T_world_base = SE3.level(start.x, start.y, seabed + protocol.altitude, start.yaw)
        frame = renderer.render(camera, T_world_base @ protocol.T_base_camera)
        picture.paste(Image.fromarray(frame.rgb), (above.width, k * camera.height))
    return picture
