from __future__ import annotations

import ast
import importlib
import inspect
import math
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

import dream.sim
from dream.sim import sampling
from dream.sim.files import world_hash
from dream.sim.worlds import make_world
from tests.sim.made import made

MAKERS = ["worlds", "terrain", "reefs", "reef_shapes", "boulders", "meshes", "pool"]
"""What makes worlds, beside the wrecks."""
INEXACT = {
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "asin", "acos", "atan", "atan2"),
    *("exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "power", "pow", "float_power", "cbrt"),
    *("sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh"),
    *("dot", "matmul", "inner", "vdot", "tensordot", "einsum", "linalg", "quantile", "percentile"),
    *("integers", "normal", "standard_normal", "uniform", "choice", "permutation", "shuffle"),
}
"""Differs with the processor, the mathematical library or the version of NumPy."""


def sources() -> list[Path]:
    folder = Path(dream.sim.__path__[0])
    return [folder / f"{name}.py" for name in MAKERS] + sorted((folder / "wrecks").glob("*.py"))


def inexact(tree: ast.AST) -> list[str]:
    """What a module calls that is not the same everywhere, with its line."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in INEXACT:
            found.append(f"{node.attr} {node.lineno}")
        if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.MatMult, ast.Pow)):
            found.append(f"{type(node.op).__name__} {node.lineno}")
    return found


@pytest.mark.parametrize("path", sources(), ids=lambda path: path.stem)
def test_nothing_that_makes_worlds_calls_what_differs_between_machines(path: Path) -> None:
    assert inexact(ast.parse(path.read_text(encoding="utf-8"))) == []


def test_what_differs_between_machines_is_recognised() -> None:
    # `random` alone is drawn from; sines and powers are there to be wrapped.
    wrapped = {entry.split()[0] for entry in inexact(ast.parse(inspect.getsource(sampling)))}
    assert wrapped == {"sin", "cos", "exp", "log", "power"}
    assert inexact(ast.parse("a @ b")) == ["MatMult 1"]
    assert inexact(ast.parse("np.linalg.norm(c)\n")) == ["linalg 1"]
    assert inexact(ast.parse("c ** 0.3")) == ["Pow 1"]


class Other:
    """A mathematical library whose sines and powers are off by up to two units in the last place."""

    def __init__(self, library: ModuleType) -> None:
        self.library = library
        self.rng = np.random.default_rng(0)
        self.calls = 0

    def __getattr__(self, name: str) -> Any:
        function = getattr(self.library, name)
        if name not in ("sin", "cos", "exp", "power"):
            return function

        def off(*arguments: Any) -> Any:
            self.calls += 1
            exact = np.asarray(function(*arguments), np.float64)
            shifted = exact + self.rng.integers(-2, 3, exact.shape) * np.spacing(exact)
            return shifted if exact.ndim else float(shifted)

        return off


def test_the_other_library_is_off_by_one_or_two_units_in_the_last_place() -> None:
    angles = np.linspace(0.1, 3.0, 1000)
    units = np.abs(Other(np).sin(angles) - np.sin(angles)) / np.spacing(np.sin(angles))
    assert set(np.unique(np.rint(units)).tolist()) >= {0.0, 1.0, 2.0}
    assert units.max() <= 4.0


@pytest.mark.few(3)
@pytest.mark.parametrize(
    "name", [pytest.param("wreck/2", marks=pytest.mark.slow), "wreck/3", "reef/patch", "reef/K", "pool/arc"]
)
def test_a_world_does_not_depend_on_the_last_digits_of_a_library(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrays, scalars = Other(np), Other(math)
    monkeypatch.setattr(sampling, "np", arrays)
    monkeypatch.setattr(sampling, "math", scalars)
    again = make_world(name, 1)
    assert arrays.calls + scalars.calls > 10
    assert world_hash(again) == world_hash(made(name))


@pytest.mark.rare
def test_a_world_does_not_depend_on_the_processor() -> None:
    # NumPy and its linear algebra then take the paths of the oldest processor that they support.
    core = importlib.import_module("numpy._core._multiarray_umath")
    features = [name for name in core.__cpu_dispatch__ if core.__cpu_features__[name]]
    names = ["wreck/4", "wreck/5", "reef/patch"]
    script = (
        "from dream.sim.worlds import make_world\nfrom dream.sim.files import world_hash\n"
        f"for name in {names}: print(world_hash(make_world(name, 1)))"
    )
    old = {"NPY_DISABLE_CPU_FEATURES": " ".join(features), "OPENBLAS_CORETYPE": "Prescott"}
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        env=os.environ | old,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == [world_hash(made(name)) for name in names]


vectors = st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3)


@given(st.lists(vectors, min_size=1, max_size=5), st.lists(vectors, min_size=1, max_size=4))
def test_products_and_lengths_are_those_of_linear_algebra(a: list[list[float]], b: list[list[float]]) -> None:
    points, rows = np.array(a), np.array(b)
    np.testing.assert_allclose(sampling.products(points, rows), points @ rows.T, atol=1e-6)
    np.testing.assert_allclose(sampling.length(points), np.linalg.norm(points, axis=1), rtol=1e-12)


def test_normal_numbers_have_the_moments_of_the_normal_distribution() -> None:
    count = 300_000
    drawn = sampling.normals(np.random.default_rng(0), (count,))
    for power, moment, variance in ((1, 0.0, 1.0), (2, 1.0, 2.0), (3, 0.0, 15.0), (4, 3.0, 96.0)):
        assert abs((drawn**power).mean() - moment) < 4.0 * math.sqrt(variance / count)
    assert abs((drawn[::2] * drawn[1::2]).mean()) < 4.0 / math.sqrt(count / 2)
    assert abs((drawn[: count // 2] * drawn[count // 2 :]).mean()) < 4.0 / math.sqrt(count / 2)


@pytest.mark.parametrize("shape", [(), (0,), (1,), (7,), (3, 5), (2, 3, 4)])
def test_normal_numbers_come_in_the_shape_that_was_asked_for(shape: tuple[int, ...]) -> None:
    assert sampling.normals(np.random.default_rng(0), shape).shape == np.empty(shape).shape


@pytest.mark.parametrize("mean", [0.0, 0.3, 2.0, 40.0])
def test_rare_things_happen_as_often_as_poisson_says(mean: float) -> None:
    rng, draws = np.random.default_rng(0), 4000
    counts = np.array([sampling.poisson(rng, mean) for _ in range(draws)])
    assert abs(counts.mean() - mean) <= 4.0 * math.sqrt(mean / draws)
    assert abs(counts.var() - mean) <= 4.0 * math.sqrt((mean + 2.0 * mean * mean) / draws)
    assert abs((counts == 0).mean() - math.exp(-mean)) <= 4.0 * math.sqrt(math.exp(-mean) / draws)


@given(st.floats(-100.0, 100.0), st.floats(0.0, 5.0))
def test_functions_are_rounded_to_a_billionth(x: float, exponent: float) -> None:
    def close(value: npt.NDArray[np.float64], exact: float) -> None:
        assert abs(float(value) - exact) <= 0.5001e-9
        assert float(value) == round(float(value), 9)

    close(sampling.sine(x), math.sin(x))
    close(sampling.cosine(x), math.cos(x))
    close(sampling.exponential(-abs(x)), math.exp(-abs(x)))
    close(sampling.power(abs(x) / 100.0, exponent), (abs(x) / 100.0) ** exponent)
