"""`dream worlds` and `dream draw`."""

from __future__ import annotations

import filecmp
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from dream.commands.console import check_picture, open_world, print_json, save_picture
from dream.commands.progress import stage
from dream.options import First
from dream.protocol import DREAM_V2, protocol_named

if TYPE_CHECKING:
    from PIL import Image

    from dream.sim.world import World


@dataclass(frozen=True, slots=True)
class Worlds:
    """List the worlds by name, save one as a folder to edit, make one from a mesh, or check such a folder.

    --from-mesh FILE makes the folder of a world from a mesh of yours (.ply, .obj, .stl), such as
    photogrammetry of a wreck: cut into patches, on a seabed, with bounds and starts around it.

    --check FOLDER says, line by line, what is refused and has to be mended, what was turned (faces that look
    inwards), and what was read in another way than it stands there (polygons that were split, vertices
    without colour). The exit status is 1 where anything is refused. docs/worlds.md says what a folder holds.

    Examples:
        dream worlds --save reef/string --seed 3 --out my-reef
        dream worlds --check my-reef
        dream worlds --from-mesh wreck.ply --up y --scale 1 --target --out my-wreck
    """

    save: First[Annotated[str | None, tyro.conf.arg(metavar="WORLD")]] = None
    """Save the world of this name as a folder."""
    seed: First[int] = 1
    """Which world of that name."""
    out: First[Path] = Path("world")
    """Folder to save it to."""
    check: First[Annotated[Path | None, tyro.conf.arg(metavar="FOLDER")]] = None
    """Check the world in this folder, and say all that has to be mended."""
    from_mesh: First[Annotated[Path | None, tyro.conf.arg(metavar="FILE")]] = None
    """Make a world from the mesh in this file."""
    up: Literal["y", "z"] | None = None
    """Of --from-mesh: which axis is up in the file. Unless given, z, if that does not look wrong."""
    scale: float | None = None
    """Of --from-mesh: metres of one unit of the file. Unless given, 1, if that does not look wrong."""
    target: bool = False
    """Of --from-mesh: it is what is to be explored. Otherwise it is an obstacle, and nothing is."""
    shells: bool = False
    """Of --from-mesh: its patches are shells, which stop neither sight nor vehicle. Otherwise it is hull."""
    name: str | None = None
    """Of --from-mesh: what the world is called. Unless given, as the file."""
    water: str | None = None
    """Of --from-mesh: pool, clear, coastal, green or turbid. Unless given, clear."""
    waters: bool = False
    """List the waters instead, and how far `dream-v2` sees in each."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status: 0, or 1 where what is checked is refused."""
        from dream.sim.files import save_world, world_hash
        from dream.sim.worlds import WORLDS, make_world

        wanted = [
            f"--{option.replace('_', '-')}"
            for option in ("save", "check", "from_mesh", "waters")
            if getattr(self, option)
        ]
        if len(wanted) > 1:
            raise ValueError(f"{wanted[-1]}: expected it alone, got {wanted[0]} with it. Choose one of them")
        of_mesh = ("up", "scale", "target", "shells", "name", "water")
        if self.from_mesh is None and any(getattr(self, option) for option in of_mesh):
            told = ", ".join(f"--{option}" for option in of_mesh)
            raise ValueError(f"{told}: expected --from-mesh FILE with them, got none")
        if self.from_mesh is not None:
            return self._from(self.from_mesh)
        if self.waters:
            return _list_waters(json=self.json)
        if self.check is not None:
            return _checked(self.check, json=self.json)
        if self.save is not None:
            world = make_world(self.save, self.seed)
            _check_new(world, self.out)
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
            print("Reefs from reef/mound on are made for dream-v2, all others for dream-v1.")
            print("reef/string+1y1 is reef/string 1 year on, in the first of its fates; so with all reefs")
            print("made for dream-v1.")
            print("wreck/2+wreck/3 are two wrecks side by side; so with all wrecks.")
            print("wreck/4+reef/patch is a wreck with a reef around it; so with all wrecks and those reefs.")
        return 0

    def _from(self, path: Path) -> int:
        from dream.sim.files import save_world, world_hash
        from dream.sim.from_mesh import world_of
        from dream.sim.mesh_files import read_surface

        with stage(f"reading {path}"):
            surface = read_surface(path)
        with stage(f"cutting {path} into patches"):
            made = world_of(
                surface,
                path.stem if self.name is None else self.name,
                seed=self.seed,
                up=self.up,
                scale=self.scale,
                target=self.target,
                shells=self.shells,
                water=self.water or "clear",
            )
        world, box = made.world, made.world.bounds
        with stage(f"saving {self.out}"):
            _check_new(world, self.out)
            save_world(world, self.out)
        if self.json:
            print_json(
                {
                    "world": world.name,
                    "seed": world.seed,
                    "hash": world_hash(world),
                    "folder": str(self.out),
                    "extents": list(made.extents),
                    "patches": len(world.targets),
                    "findings": list(made.told),
                }
            )
            return 0
        for words in made.told:
            print(f"{path.name}: {words}")
        x, y, z = made.extents
        size = f"{x:.1f} x {y:.1f} x {z:.1f} m in bounds of {box.width:g} x {box.depth:g} m"
        patches = (
            f"{len(world.targets):,} patches" if self.target else "an obstacle; --target makes it a target"
        )
        print(f"saved {world.name} {world.seed}: {size}, {patches}")
        print(f"look at it: dream draw --world {self.out}; fly it with: dream run --world {self.out}")
        return 0


def _list_waters(*, json: bool) -> int:
    """Print every water's attenuation length and ranges; exit status 0."""
    from dream.sim.visual_range import visual_range
    from dream.sim.water import WATERS

    protocol = DREAM_V2
    assert protocol.space is not None
    ranges = {name: visual_range(water, protocol.space, protocol.max_depth) for name, water in WATERS.items()}
    if json:
        rows = [
            {
                "water": name,
                "attenuation_length": WATERS[name].attenuation_length,
                "labels": told.labels,
                "depth": told.depth,
            }
            for name, told in ranges.items()
        ]
        print_json({"protocol": protocol.name, "waters": rows})
        return 0
    print(f"{'water':8}  attenuation length  labels as far as  depth as far as")
    for name, told in ranges.items():
        length = WATERS[name].attenuation_length
        print(f"{name:8}  {length:16.1f} m  {told.labels:14.1f} m  {told.depth:13.1f} m")
    print(f"\nStraight through the water, under {protocol.name}.")
    return 0


def _check_new(world: World, folder: Path) -> None:
    """Raise a ValueError where something would be written over that is not this very world."""
    import tempfile

    from dream.sim.files import save_world

    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if folder.is_dir():
        with tempfile.TemporaryDirectory() as beside:
            save_world(world, beside)
            names = [path.name for path in Path(beside).iterdir()]
            there = [name for name in names if (folder / name).exists()]
            same = filecmp.cmpfiles(beside, folder, there, shallow=False)[0]
        if len(same) == len(there):  # What else lies there stays.
            return
    raise ValueError(
        f"--out: expected a folder that does not exist, or that holds {world.name} {world.seed} as it is "
        f"saved, got {folder}, which holds something else. Choose another, or move that one away"
    )


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
    """Draw a world as a picture: its chart from above, and what the camera sees from two of its starts.

    Examples:
        dream draw --world reef/mixed --seed 3 --out reef.png
    """

    world: First[Annotated[str, tyro.conf.arg(metavar="WORLD")]] = "reef/string"
    """A name from `dream worlds`, or the folder of a saved world."""
    seed: First[int] = 1
    """Which world of that name."""
    out: First[Path | None] = None
    """Picture to write. Unless given, `WORLD-SEED.png`."""
    json: bool = False
    """Print one JSON object and nothing else."""

    def __call__(self) -> int:
        """Exit status 0."""
        from dream.sim.chart import chart
        from dream.sim.files import world_hash

        if self.out is not None:
            check_picture(self.out, "--out")
        with stage(f"opening {self.world} {self.seed}"):
            world = open_world(self.world, self.seed)
        word = re.sub(r"[^\w.+]+", "-", world.name).strip("-")
        out = self.out or Path(f"{word}-{world.seed}.png")
        check_picture(out, "--out")
        with stage(f"drawing {world.name} {world.seed}"):
            save_picture(_portrait(world, chart(world)), out, "--out")
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
