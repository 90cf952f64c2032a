"""A short turn of the fuzzing of every reader; `python -m tests.fuzz` is the long one."""

from __future__ import annotations

import itertools
import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests import fuzz
from tests.fuzz import KINDS, Fuzzed, Kind

INPUTS = 40


@pytest.mark.parametrize("name", KINDS)
def test_what_is_nearly_right_is_taken_or_refused_by_an_error_of_ours(name: str, tmp_path: Path) -> None:
    fuzzed = Fuzzed(name, tmp_path)
    tried = itertools.islice(fuzzed.inputs(39), INPUTS)
    assert [finding.error for data in tried if (finding := fuzzed.try_(data)) is not None] == []


def test_inputs_are_the_same_for_the_same_seed_and_differ_from_what_they_began_as(tmp_path: Path) -> None:
    fuzzed = Fuzzed("site", tmp_path)
    one, same, other = (list(itertools.islice(fuzzed.inputs(seed), 50)) for seed in (1, 1, 2))
    assert one == same != other
    assert len(set(one) - set(fuzzed.seeds)) > 45


def broken(data: bytes, folder: Path) -> None:
    """A reader that does every wrong thing, by its input's first byte."""
    if data[:1] == b"1":
        raise KeyError("what of it")
    if data[:1] == b"2":
        time.sleep(60.0)
    if data[:1] == b"3":
        os.kill(os.getpid(), signal.SIGKILL)
    raise ValueError("refused")


@pytest.mark.parametrize(
    ("seed", "error"),
    [(b"1", "KeyError: \"'what of it'\""), (b"2", "Hung: 'longer than 0.3 s'"), (b"3", "died of SIGKILL")],
)
def test_wrong_errors_hangs_and_deaths_are_found_and_kept(
    seed: bytes,
    error: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(fuzz, "LIMIT_S", 0.3)
    # By a clock that counts looks at it, so that a busy machine tries as many inputs.
    ticks = itertools.count()
    monkeypatch.setattr(fuzz, "time", SimpleNamespace(monotonic=lambda: float(next(ticks))))
    monkeypatch.setattr(fuzz, "mutated", lambda seeds, rng: rng.choice([seed, b"refused"]))
    monkeypatch.setattr(fuzz, "KINDS", {"odd": lambda: Kind(lambda _: [b"fine"], lambda *_: None)})
    fuzzed = Fuzzed("odd", tmp_path / "odd")
    fuzzed.kind = Kind(lambda _: [], broken)
    monkeypatch.setattr(fuzz, "Fuzzed", lambda name, folder: fuzzed)
    assert fuzz._fuzz(["odd"], tmp_path, 8.0, 0, tmp_path / "kept") == 1
    assert error in capsys.readouterr().out
    assert [path.read_bytes() for path in (tmp_path / "kept").iterdir()] == [seed]
