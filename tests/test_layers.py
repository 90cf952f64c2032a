"""Imports only point down."""

import ast
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
        "geometry",
        "names",
        "options",
        "standin",
        "telling",
        "versions",
    },
    {"protocol"},
    {"types", "measurements", "traversal", "vehicle"},
    {"orders", "own_code"},
    {"perception", "mapping"},
    {"planning", "control", "estimation", "sim"},
    {"robots"},
    {"approach", "course"},
    {"mission"},
    {"recording", "evaluation", "report", "live", "survey"},
    {"learning"},
    {"commands"},
    {"cli"},
    {"__main__"},
]
RANK = {name: rank for rank, names in enumerate(LAYERS) for name in names}
APART = LAYERS[5]


def _imports(path: Path) -> set[str]:
    """Parts of `dream` that a file imports when it runs; what only a type checker reads does not count."""
    tree = ast.parse(path.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body = [ast.Pass()]
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "dream":
            parts = (node.module or "").split(".")
            found |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names} & set(RANK)
        elif isinstance(node, ast.Import):
            found |= {a.name.split(".")[1] for a in node.names if a.name.startswith("dream.")}
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


EACH_OTHER = {
    ("dream", "dream.evaluation.runner"),
    ("dream.commands.dive", "dream.commands.dive.options"),
    ("dream.commands.dive", "dream.commands.dive.ready"),
    ("dream.mapping.prior", "dream.types"),
    ("dream.orders", "dream.types"),
    ("dream.planning._kernels.search", "dream.planning.travel"),
}
"""Pairs of modules that import each other. The list may only shrink."""


def _modules() -> dict[str, set[str]]:
    """The modules of the package that each imports, for a type checker too."""
    files = {}
    for path in ROOT.rglob("*.py"):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        files[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    found: dict[str, set[str]] = {}
    for module, path in files.items():
        found[module] = set()
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "dream":
                names = {f"{node.module}.{alias.name}" for alias in node.names}
                found[module] |= {name if name in files else str(node.module) for name in names}
            elif isinstance(node, ast.Import):
                found[module] |= {alias.name for alias in node.names if alias.name in files}
    return found


def test_no_more_modules_import_each_other() -> None:
    found = _modules()
    pairs = {(a, b) for a, others in found.items() for b in others if a < b and a in found.get(b, ())}
    assert pairs <= EACH_OTHER, f"these import each other: {pairs - EACH_OTHER}"


def test_the_loop_imports_no_planner() -> None:
    found = _modules()
    for module in ("dream.mission", "dream.course"):
        assert not [name for name in found[module] if name.startswith("dream.planning")], module
    # The way to a leg's area is a search, which planners share.
    ways = {name for name in found["dream.approach"] if name.startswith("dream.planning")}
    assert ways == {"dream.planning.travel"}
