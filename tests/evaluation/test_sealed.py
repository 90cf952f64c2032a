"""A sealed test: what a key makes, what is published of it, and what stays unknown."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chisquare

from dream.cli import run_command
from dream.evaluation import figures
from dream.evaluation import sealed as module
from dream.evaluation.anytime import anytime_interval
from dream.evaluation.comparison import compare, difference, no_difference, paired
from dream.evaluation.report import markdown
from dream.evaluation.results import read_manifest, read_results
from dream.evaluation.sealed import (
    LAST_BLOCK,
    MOST_BLOCKS,
    SEED_BITS,
    WORLDS_OF_BLOCK,
    SealingKey,
    commitment_to,
    new_key,
    read_blocks,
    read_key,
    sealed,
    write_blocks,
)
from dream.evaluation.suites import SEALED_FAMILIES, SEALED_PROTOCOL, SEALED_STEPS, SUITES, Case
from dream.protocol import DREAM_V2
from dream.sim.habitats.arena import MOST_STEPS
from dream.sim.worlds import WORLDS, make_world
from tests.engines import InProcess
from tests.evaluation.benches import Made, flown, write_bench

KEY = SealingKey(bytes(range(32)))
OTHER = SealingKey(bytes(32))
GOLDEN_CASES = (
    Case("reef/holes", 500194444148107),
    Case("reef/border", 283659770470732),
    Case("wreck/1+wreck/3", 505817790925883),
)
GOLDEN_COMMITMENT = "e2073b46f54afb144894baa030ce42172e0cc62392f910ddf47f4d345bb635c2"
Run = Callable[..., int]


# ---- what a key makes ----


def test_a_key_makes_the_same_worlds_for_ever() -> None:
    first = KEY.block(0).cases()
    assert first == SealingKey(KEY.secret).block(0).cases()
    assert len(first) == WORLDS_OF_BLOCK
    # Written down once: another derivation would make every published commitment worthless.
    assert first[:3] == GOLDEN_CASES
    assert KEY.block(0).commitment() == GOLDEN_COMMITMENT


def test_keys_and_blocks_share_no_world_with_each_other_or_with_any_suite() -> None:
    drawn = [key.block(number).cases() for key in (KEY, OTHER) for number in range(20)]
    seeds = [case.seed for cases in drawn for case in cases]
    assert len(set(seeds)) == len(seeds)
    assert {case.seed for cases in SUITES.values() for case in cases}.isdisjoint(seeds)
    assert all(2**SEED_BITS <= seed < 2 ** (SEED_BITS + 1) for seed in seeds)
    # The same number in a program that counts in doubles, or shows 15 digits.
    assert all(int(float(seed)) == seed and len(str(seed)) == 15 for seed in seeds)
    assert max(case.seed for cases in SUITES.values() for case in cases) < 2**32


def test_worlds_are_drawn_from_all_families_alike() -> None:
    drawn = [case.world for number in range(100) for case in KEY.block(number).cases()]
    count = Counter(drawn)
    families = [sum(count[world] for world in family) for family in SEALED_FAMILIES]
    assert sum(families) == len(drawn)
    assert chisquare(families).pvalue > 1e-3
    for family in SEALED_FAMILIES:
        assert len(family) == 1 or chisquare([count[world] for world in family]).pvalue > 1e-3
    assert {part for world in count for part in world.split("+")} <= set(WORLDS)
    # Neither does the place in a block say anything of the family.
    assert len({KEY.block(number).cases()[0].world for number in range(60)}) > 6


def test_a_world_can_be_made() -> None:
    case = KEY.block(0).cases()[0]
    assert make_world(case.world, case.seed).seed == case.seed


def test_a_commitment_binds_every_world_its_order_the_block_and_the_key() -> None:
    block = KEY.block(3)
    cases = block.cases()
    assert commitment_to(cases, block) == block.commitment()
    changed = [
        (replace(cases[0], seed=cases[0].seed + 1), *cases[1:]),
        (replace(cases[0], world="reef/none"), *cases[1:]),
        (replace(cases[0], start=1), *cases[1:]),
        (cases[1], cases[0], *cases[2:]),
        cases[:-1],
        (*cases, Case("reef/L", 1)),
    ]
    others = [commitment_to(each, block) for each in changed]
    others += [
        commitment_to(cases, replace(block, number=4)),
        commitment_to(cases, replace(block, key=OTHER.name)),
        commitment_to(cases, replace(block, secret=bytes(32))),
        OTHER.block(3).commitment(),
    ]
    assert len({block.commitment(), *others}) == len(others) + 1


def test_a_commitment_can_be_computed_without_this_package() -> None:
    block = KEY.block(2)
    told = re.fullmatch(r"block (\d+) of (\w+): (\w+)\n", block.written())
    assert told is not None
    lines = ["dream sealed 1", f"key {told[2]}", f"block {told[1]}", f"secret {told[3]}"]
    lines += [f"{case.world} {case.seed} {case.start}" for case in block.cases()]
    assert hashlib.sha256(("\n".join(lines) + "\n").encode()).hexdigest() == block.commitment()


def test_nothing_that_is_shown_of_a_key_holds_its_secret() -> None:
    shown = [repr(KEY), repr(KEY.block(0)), KEY.name, json.dumps(sealed([KEY.block(0)]).as_dict())]
    for text in shown:
        for secret in (KEY.secret, KEY.block(0).secret):
            assert secret.hex() not in text
            assert repr(secret)[2:-1] not in text


# ---- files ----


def test_a_key_is_kept_for_its_owner_alone_and_never_written_over(tmp_path: Path) -> None:
    path = tmp_path / "key"
    key = new_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_key(path) == key
    assert new_key(tmp_path / "another").secret != key.secret
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match="never written over"):
        new_key(path)
    with pytest.raises(FileExistsError, match="never written over"):
        write_blocks(path, [KEY.block(0)])
    assert path.read_bytes() == before
    with pytest.raises(OSError, match="expected a place that can be written"):
        new_key(tmp_path / "nowhere" / "key")


def _kept(path: Path, content: bytes, mode: int = 0o600) -> Path:
    path.write_bytes(content)
    path.chmod(mode)
    return path


def test_opened_blocks_stand_for_themselves(tmp_path: Path) -> None:
    path = tmp_path / "blocks"
    write_blocks(path, [KEY.block(4), KEY.block(5)])
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_blocks(path, None) == (KEY.block(4), KEY.block(5))
    assert read_blocks(path, range(5, 6)) == (KEY.block(5),)
    assert KEY.secret.hex() not in path.read_text()
    assert KEY.block(6).secret.hex() not in path.read_text()
    with pytest.raises(ValueError, match=r"--blocks: expected some of 4\.\.5, which .* holds, got 6"):
        read_blocks(path, range(5, 7))
    with pytest.raises(ValueError, match="expected the key itself, got some blocks"):
        read_key(path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "64 hexadecimal digits, got 0 characters"),
        (b"12ab" * 15 + b"777", "64 hexadecimal digits, got 63 characters, all such digits"),
        (b"12ab" * 16 + b"7", "64 hexadecimal digits, got 65 characters"),
        (b"12ab" * 15 + b"77xx", "64 hexadecimal digits, got of which some are no such digits"),
        (b"\xff\xfe" * 32, "got something that is no text"),
        (b"a" * 100_000, "expected at most"),
        (KEY.block(0).written().encode() + b"12ab\n", "line 2: expected block N of HEX"),
        ((KEY.block(0).written() + KEY.block(2).written()).encode(), "one after the other"),
        ((KEY.block(0).written() + OTHER.block(1).written()).encode(), "blocks of one key"),
    ],
)
def test_what_is_no_key_is_refused_without_a_word_of_it(tmp_path: Path, content: bytes, said: str) -> None:
    with pytest.raises(ValueError, match=said) as refused:
        read_blocks(_kept(tmp_path / "key", content), None)
    assert "12ab" not in str(refused.value)
    assert KEY.block(0).secret.hex() not in str(refused.value)
    assert refused.value.__cause__ is None


@pytest.mark.skipif(os.name != "posix", reason="files have modes where others may be kept out by them")
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o644])
def test_a_key_that_others_may_read_is_refused_with_what_to_do(tmp_path: Path, mode: int) -> None:
    path = _kept(tmp_path / "key", KEY.secret.hex().encode(), mode)
    with pytest.raises(ValueError, match=f"got mode {mode:04o}.*chmod 600 "):
        read_key(path)
    path.chmod(0o400)
    assert read_key(path) == KEY


# ---- flying ----


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """`dream bench sealed` on two small worlds a block, in this process and without pictures."""
    monkeypatch.setattr("dream.evaluation.engines.Processes", InProcess)
    monkeypatch.setattr("dream.evaluation.figures.pictures", lambda *_: [])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "SEALED_FAMILIES", (("flat/empty",),))
    monkeypatch.setattr(module, "WORLDS_OF_BLOCK", 2)
    _kept(tmp_path / "key", KEY.secret.hex().encode())
    _kept(tmp_path / "other", OTHER.secret.hex().encode())

    def bench(*options: str, key: str = "key") -> int:
        quick = ["--planners", "random", "--max-steps", "3", "--jobs", "1", "--protocol", "dream-v1"]
        return run_command(["bench", "sealed", "--key", key, *quick, *options])

    return bench


def _told(capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def test_a_sealed_test_is_flown_goes_on_and_keeps_its_secret(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = [KEY.block(number) for number in range(3)]
    public = [block.commitment() for block in blocks]
    assert run("--json", "--commitment", public[0], "--keep-runs") == 0
    first = _told(capsys)
    folder = Path(first["out"])
    assert folder == Path("bench") / f"sealed-{KEY.name[:8]}"
    assert first["sealed"] == {"key": KEY.name, "blocks": {"0": public[0]}}
    assert [(each["world"], each["seed"]) for each in first["missions"]] == [
        (case.world, case.seed) for case in blocks[0].cases()
    ]
    kept = (folder / "results.csv").read_bytes()
    # The same folder goes on, and the next blocks join it in the order in which they were drawn.
    assert run("--blocks", "0..2", "--commitment", *public[:2], public[2].upper()) == 0
    printed = capsys.readouterr()
    assert "anytime-valid 95 % intervals" in printed.out
    assert "--blocks 3" in printed.out
    manifest = read_manifest(folder)
    assert manifest["sealed"] == {"key": KEY.name, "blocks": dict(zip("012", public, strict=True))}
    assert manifest["cases"] == [case.as_dict() for block in blocks for case in block.cases()]
    assert (folder / "results.csv").read_bytes().startswith(kept)
    page = (folder / "report.html").read_text()
    assert "anytime-valid 95 % intervals" in page
    assert all(commitment in page for commitment in public)
    assert "dream bench sealed --key FILE --blocks 0..2 --planners random" in page
    assert "Wilson" not in page
    # No secret stands in any file or line.
    files = [path for path in folder.rglob("*") if path.is_file()]
    assert len(files) > 10
    everything = [path.read_bytes() for path in files]
    everything += [each.encode() for each in (*printed, json.dumps(first))]
    for secret in (KEY.secret, *(block.secret for block in blocks)):
        for content in everything:
            assert secret not in content
            assert secret.hex().encode() not in content.lower()


def test_what_does_not_match_is_refused_before_anything_flies(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    public = KEY.block(0).commitment()
    for options, said in [
        (("--commitment", OTHER.block(0).commitment()), "got " + public),
        (("--commitment", KEY.block(1).commitment()), "other worlds than those that were committed to"),
        (("--commitment", public, "--blocks", "0..1"), "expected 2, one for each of the blocks 0..1, got 1"),
        (("--commitment", "12"), "expected 64 hexadecimal digits, got 12"),
        (("--blocks", "x"), "--blocks: expected a number up to"),
        (("--blocks", "3..1"), "--blocks: expected the lower number first"),
        (
            ("--blocks", f"0..{MOST_BLOCKS}"),
            f"--blocks: expected at most {MOST_BLOCKS}, got {MOST_BLOCKS + 1}",
        ),
        (("--blocks", str(LAST_BLOCK + 1)), "--blocks: expected a number up to"),
        (("--world", "reef/L"), "expected none beside sealed"),
    ]:
        assert run(*options) == 2, options
        assert said in " ".join(capsys.readouterr().err.split())
    assert run(key="nowhere") == 2
    assert "nowhere: expected a file with a key, got none" in capsys.readouterr().err
    assert not (tmp_path / "bench").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["sealed"], "--key: expected the file with the key of the sealed test, got none"),
        (["paper", "--key", "key"], "--key: expected the suite sealed with it, got paper"),
        (["--blocks", "1"], "--blocks: expected the suite sealed with it, got paper"),
        (["dev", "--commitment", "1"], "--commitment: expected the suite sealed with it, got dev"),
    ],
)
def test_options_of_a_sealed_test_go_with_it_alone(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["bench", *options]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.usefixtures("run")
def test_all_blocks_are_flown_by_the_same_rules_whichever_world_comes_first(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert DREAM_V2.name == SEALED_PROTOCOL
    monkeypatch.setattr("dream.evaluation.suites.SEALED_PROTOCOL", "dream-v2-true")
    # No world is made for that one.
    assert run_command(["bench", "sealed", "--key", "key", "--planners", "random"]) == 2
    assert "as dream-v2-true does" in capsys.readouterr().err


@pytest.mark.rare
def test_a_folder_holds_one_key_the_next_blocks_and_nothing_else(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ("--out", "here")
    assert run(*out, "--blocks", "3") == 0
    before = {path: path.read_bytes() for path in Path("here").rglob("*") if path.is_file()}
    ordinary = ["bench", "--world", "flat/empty", "--planners", "random", "--max-steps", "3", "--jobs", "1"]
    ordinary += ["--protocol", "dream-v1"]

    def refused(status: int, said: str) -> None:
        assert status == 2
        assert said in " ".join(capsys.readouterr().err.split())

    refused(run(*out, "--blocks", "4", key="other"), "key of the sealed test: expected")
    refused(run(*out, "--blocks", "5"), "expected block 4 after 3, which are in it, got 5")
    refused(run(*out, "--blocks", "2"), "expected block 4 after 3, which are in it, got 2")
    refused(run_command([*ordinary, *out]), "expected worlds of a sealed test, as in it, got others")
    assert {path: path.read_bytes() for path in Path("here").rglob("*") if path.is_file()} == before
    assert run(*out, "--blocks", "3..4") == 0
    assert run_command([*ordinary, "--out", "plain"]) == 0
    refused(run("--out", "plain"), "expected worlds of others, as in it, got a sealed test")


def test_the_keeper_opens_a_block_others_check_it_and_the_next_stays_shut(
    run: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seal = ["seal"]
    assert run_command([*seal, "new", "mine", "--blocks", "0..1", "--json"]) == 0
    told = _told(capsys)
    secret = Path("mine").read_text().strip()
    assert run_command([*seal, "open", "mine", "--blocks", "0", "--out", "block"]) == 0
    assert run_command([*seal, "show", "block", "--json"]) == 0
    shown = capsys.readouterr().out
    assert secret not in shown
    assert told["blocks"]["0"] in shown
    assert run("--out", "flown", "--commitment", told["blocks"]["0"], key="block") == 0
    assert run("--out", "flown", "--blocks", "1", key="block") == 2
    check = [*seal, "check", "flown", "block", "--commitment"]
    assert run_command([*check, told["blocks"]["0"]]) == 0
    assert run_command([*check, told["blocks"]["1"]]) == 2
    assert run_command([*seal, "check", "flown", "mine"]) == 0
    capsys.readouterr()
    assert run_command([*seal, "check", "flown", "other"]) == 2
    assert "flown: key: expected" in capsys.readouterr().err
    # A world that was exchanged afterwards shows.
    path = Path("flown/manifest.json")
    manifest = json.loads(path.read_text())
    manifest["cases"] = manifest["cases"][::-1]
    path.write_text(json.dumps(manifest))
    assert run_command([*seal, "check", "flown", "block"]) == 2
    assert "flown: cases: expected the 2 of block in their order, got others" in capsys.readouterr().err


# ---- what its report says ----


def _made(tmp_path: Path, *, missing: int | None = None) -> Path:
    cases = KEY.block(0).cases()[:20]
    missions = [
        flown(case, planner, Made(pace + 3.0 * k, stops_at=round(pace + 3.0 * k) + 9))
        for k, case in enumerate(cases)
        for planner, pace in (("belief", 40.0), ("lawnmower", 90.0))
        if k != missing or planner != "belief"
    ]
    told = sealed([KEY.block(0)]).as_dict()
    return write_bench(
        tmp_path / "bench", missions, cases, ["belief", "lawnmower"], suite="sealed", sealed=told
    )


def test_its_numbers_have_intervals_that_hold_at_every_look(tmp_path: Path) -> None:
    comparison = compare(read_results(_made(tmp_path)))
    assert comparison.sealed
    cases = comparison.cases
    times = [float(row.t98 or 0) for _, row in comparison.flown("belief", cases)]
    # Whatever caps the worlds so far had: the next may have more.
    assert float(SEALED_STEPS) == MOST_STEPS
    assert comparison.horizon < SEALED_STEPS
    limits = comparison.time_limits
    assert limits == (0.0, float(SEALED_STEPS))
    found = comparison.estimate("belief", cases, comparison.time("t98"), limits=limits)
    assert found == anytime_interval(np.array(times), limits)
    assert comparison.success("belief", cases) == anytime_interval(np.ones(20), (0.0, 1.0))
    ours, theirs, _ = paired(comparison, "belief", "lawnmower", cases)
    apart = difference(comparison, "belief", "lawnmower", cases)
    assert apart == anytime_interval(ours - theirs, (-200.0, 200.0))
    # Both say the same of whether there is a difference.
    assert (apart.high < 0.0) == (no_difference(comparison, ours, theirs) < 0.05)


def test_a_missing_mission_ends_what_is_told_of_its_planner(tmp_path: Path) -> None:
    comparison = compare(read_results(_made(tmp_path, missing=7)))
    assert comparison.success("belief", comparison.cases).count == 7
    assert comparison.success("lawnmower", comparison.cases).count == 20
    assert difference(comparison, "belief", "lawnmower", comparison.cases).count == 7


def test_its_pages_name_the_intervals_and_other_pages_do_not(tmp_path: Path) -> None:
    folder = _made(tmp_path)

    def told() -> str:
        results = read_results(folder)
        comparison = compare(results)
        captions = [picture.says for picture in figures.pictures(results, comparison)]
        return "\n".join([markdown(results, comparison), *captions])

    text = told()
    assert "anytime-valid 95 % intervals" in text
    for other in ("Wilson", "stratified", "pointwise 95 %", "exchange test"):
        assert other not in text
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "sealed": None}))
    text = told()
    for other in ("Wilson", "stratified", "pointwise 95 %", "exchange test"):
        assert other in text
    assert "anytime" not in text


@pytest.mark.parametrize(
    "told",
    [
        {"key": "short", "blocks": {"0": "a" * 64}},
        {"key": "a" * 64, "blocks": {"x": "a" * 64}},
        {"key": "a" * 64, "blocks": {"0": "<b>"}},
        {"blocks": {}},
    ],
)
def test_a_damaged_seal_is_refused(tmp_path: Path, told: dict[str, Any]) -> None:
    folder = _made(tmp_path)
    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps({**manifest, "sealed": told}))
    with pytest.raises(ValueError, match=r"manifest.json: sealed"):
        read_manifest(folder)
