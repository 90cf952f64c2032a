"""Imports only point down."""

import ast
from functools import cache
from pathlib import Path

import dream

ROOT = Path(dream.__file__).parent
LAYERS = [
    {
        "arrays",
        "compiling",
        "ending",
        "errors",
        "extras",
        "files",
        "kept_kernels",
        "geometry",
        "names",
        "options",
        "standin",
        "telling",
        "versions",
    },
    {"protocol"},
    {"types", "measurements", "traversal", "vehicle", "lattice", "flies", "scene"},
    {"orders", "own_code"},
    {"perception", "mapping"},
    {"planning", "control", "estimation", "sim"},
    {"robots"},
    {"approach", "course", "homeward"},
    {"mission"},
    {"recording", "evaluation", "report", "live", "survey"},
    {"learning", "teaching"},
    {"commands"},
    {"cli"},
    {"__main__"},
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
APART = LAYERS[5]


@cache
def _import_nodes(path: Path) -> list[tuple[ast.Import | ast.ImportFrom, bool]]:
    """Each import of a file, which is parsed once for all tests; and whether it runs.

    What only a type checker reads does not.
    """
    tree = ast.parse(path.read_text())
    typed = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        for statement in node.body
        for inner in ast.walk(statement)
    }
    return [
        (node, id(node) not in typed)
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
    ]


def _imports(path: Path) -> set[str]:
    """Parts of `dream` that a file imports when it runs."""
    found = set()
    for node, runs in _import_nodes(path):
        if not runs:
            continue
        if isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("dream.")}
        elif (node.module or "").split(".")[0] == "dream":
            parts = (node.module or "").split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names} & set(RANK)
    return found


def test_imports_only_point_down() -> None:
    checked = 0
    for path in ROOT.rglob("*.py"):
        part = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if part == "__init__":
            continue
        for other in _imports(path) - {part}:
            checked += 1
            assert RANK[other] <= RANK[part], f"{path.relative_to(ROOT)} imports {other}, which is above it"
            both_apart = {part, other} <= APART and (part, other) != ("control", "estimation")
            assert not both_apart, f"{path.relative_to(ROOT)} imports {other}, its neighbour"
    assert checked > 20


def test_only_kernels_import_numba() -> None:
    for path in ROOT.rglob("*.py"):
        if "_kernels" not in (path.stem, path.parent.name) and path.stem != "compiling":
            assert "import numba" not in path.read_text(), path
            assert "from numba" not in path.read_text(), path


def test_no_kernel_is_rounded_as_a_processor_likes() -> None:
    kernels = [path for path in ROOT.rglob("*.py") if "_kernels" in (path.stem, path.parent.name)]
    assert len(kernels) > 10
    assert [path for path in kernels if "fastmath" in path.read_text()] == []


CIRCLES = [
    {"dream", "dream.evaluation.machine", "dream.evaluation.runner"},
    {
        f"dream.commands.dive{name}"
        for name in ("", ".flight", ".options", ".predive", ".ready", ".records", ".tank")
    },
    # Options open a line to a model, which goes by them.
    {"dream.planning.vlm.asking.line", "dream.planning.vlm.asking.options"},
    # A step, an observation and a mission have a map; a map is of labels.
    {
        "dream.orders",
        "dream.types",
        *(
            f"dream.mapping.{name}"
            for name in ("_kernels.window", "blocks", "frame", "layers", "occupancy", "prior", "volume")
        ),
    },
]
"""Files that import each other in a circle, what only a type checker reads included. This list may only
shrink: whoever mends one takes it out."""


@cache
def _arrows() -> dict[str, set[str]]:
    """For each module of the package those that it names in an import; a package's `__init__` is one, too."""
    paths = {}
    for path in ROOT.rglob("*.py"):
        parts = ("dream", *path.relative_to(ROOT).with_suffix("").parts)
        paths[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    arrows: dict[str, set[str]] = {name: set() for name in paths}
    for name, path in paths.items():
        for node, _ in _import_nodes(path):
            if isinstance(node, ast.Import):
                arrows[name] |= {alias.name for alias in node.names}
            elif node.module:
                wanted = {f"{node.module}.{alias.name}" for alias in node.names}
                arrows[name] |= {module if module in paths else node.module for module in wanted}
        arrows[name] &= set(paths) - {name}
    return arrows


def _circles(arrows: dict[str, set[str]]) -> list[set[str]]:
    """Groups of two modules or more that lead to each other."""
    leads_to = {name: set(others) for name, others in arrows.items()}
    for between in arrows:
        for name in arrows:
            if between in leads_to[name]:
                leads_to[name] |= leads_to[between]
    groups = {
        frozenset({name} | {other for other in leads_to[name] if name in leads_to[other]}) for name in arrows
    }
    return [set(group) for group in groups if len(group) > 1]


def test_a_circle_of_imports_is_found() -> None:
    arrows = {"a": {"b"}, "b": {"c"}, "c": {"a"}, "d": {"a"}, "e": set[str]()}
    assert _circles(arrows) == [{"a", "b", "c"}]


def test_no_two_files_of_the_map_import_each_other_in_a_circle() -> None:
    inside = {name for name in _arrows() if name.startswith("dream.mapping")}
    assert len(inside) > 20
    assert _circles({name: others & inside for name, others in _arrows().items() if name in inside}) == []


def test_no_circle_of_imports_is_new_and_none_in_the_list_is_gone() -> None:
    found = _circles(_arrows())
    assert [circle for circle in found if circle not in CIRCLES] == []
    assert [circle for circle in CIRCLES if circle not in found] == []


def test_the_loop_imports_no_planner() -> None:
    arrows = _arrows()
    for module in ("dream.mission", "dream.course"):
        assert not [name for name in arrows[module] if name.startswith("dream.planning")], module
    # The way to a leg's area is a search, which planners share.
    ways = {name for name in arrows["dream.approach"] if name.startswith("dream.planning")}
    assert ways == {"dream.planning.travel"}
