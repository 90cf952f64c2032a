"""Nothing that was read reaches the terminal as a command to it, and no line of an error is long."""

from __future__ import annotations

import io
import logging
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from rich.text import Text

import dream
from dream import telling
from dream.cli import _fail, _Telling, run_command
from dream.recording import record, write_config, write_summary
from dream.survey import files
from dream.survey.archive import open_archive
from tests.recorded_runs import CONFIG, SUMMARY, painted_mission
from tests.survey.scenes import SITE, reef

HOSTILE = {
    "colour": "\x1b[31mred",
    "title": "\x1b]0;owned\x07",
    "clipboard": "\x1b]52;c;b3duZWQ=\x1b\\",
    "link": "\x1b]8;;http://elsewhere\x1b\\reef\x1b]8;;\x1b\\",
    "control of eight bits": "\x9b2J\x9d0;owned\x9c",
    "over the line": "fine\rdream: all is well",
    "up and away": "\x1b[2A\x1b[K\b\b\v\f",
    "turned round": "reef\u202egpj.\u2066exe\u2069",
    "other lines": "a\u2028b\u2029c\x85d",
    "half of a pair": "\udc9b\ud800",
    "tags": "a\U000e0041b\ufeff",
}


def commands_in(text: str) -> list[str]:
    """What of a text a terminal might take for a command."""
    return [letter for letter in text if not (letter.isprintable() or letter in "\n\t")]


@pytest.mark.parametrize("kind", HOSTILE)
def test_what_cannot_be_printed_is_shown_as_it_would_be_written(kind: str) -> None:
    for said in (
        telling.cleaned(HOSTILE[kind]),
        telling.one_line(HOSTILE[kind]),
        telling.in_lines(HOSTILE[kind]),
    ):
        assert not commands_in(said)
        said.encode()
    assert telling.cleaned("\x1b[2J") == "\\x1b[2J"


def test_words_of_people_stay_as_they_are() -> None:
    for said in (
        "Île d'Yeu 🪸 −3 °C",
        "\u0646\u0645\u06cc\u200c\u062e\u0648\u0627\u0647\u0645",
        "20\u00a0m",
        "a\tb",
    ):
        assert telling.cleaned(said) == said


@pytest.mark.parametrize("length", [2001, 5000, 100_000])
def test_a_long_line_is_cut_and_says_how_much_is_left_out(length: int) -> None:
    said = telling.one_line("x" * length + " Try another")
    assert len(said) <= telling.MOST
    assert said.endswith("Try another")
    (left,) = re.findall(r"\((\d+) characters left out\)", said)
    assert length + 12 - len(said) <= int(left) <= length
    # What becomes longer when it is shown is cut all the same.
    assert len(telling.one_line("\x1b" * length)) <= telling.MOST


def test_a_trace_is_told_in_its_lines_and_not_for_ever() -> None:
    said = telling.in_lines("\n".join(["  File x", "    \x1b[31mred", *["more"] * 10_000, "the last"]))
    assert said.count("\n") <= telling.MOST_LINES + 1
    assert said.startswith("  File x\n    \\x1b[31mred\n")
    assert "lines left out" in said
    assert said.endswith("the last")


@pytest.mark.parametrize("kind", HOSTILE)
def test_an_error_and_a_log_are_told_cleaned_and_bounded(
    kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    _fail(f"site: got {HOSTILE[kind]}" + "y" * 50_000, 2)
    record = logging.LogRecord("dream", 30, "", 1, "%s%s", (HOSTILE[kind], "y" * 50_000), None)
    _Telling().emit(record)
    said = capsys.readouterr().err
    assert not commands_in(said)
    assert len(said) < 5000
    assert said.count("\n") <= 3


def drawn(draw: Any) -> str:
    """What a terminal gets."""
    stream = io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "stderr", stream)
        console = telling.rich_console(stderr=True, width=100)
        console._force_terminal, console._color_system = True, None
        draw(console)
    return stream.getvalue()


@pytest.mark.parametrize("kind", HOSTILE)
def test_what_is_drawn_is_drawn_and_its_words_are_words(kind: str) -> None:
    name = HOSTILE[kind]

    def table(console: Console) -> None:
        found = Table(title=name)
        found.add_column(name)
        found.add_row(":smile: [/] [link=http://a\x1b]52;c;x\x07]there[/link]")
        found.add_row(name)
        console.print(found, name, Text(name), sep=name)

    said = drawn(table)
    assert not commands_in(said)
    assert ":smile: [/] [link=" in said

    def progress(console: Console) -> None:
        with Progress(console=console, auto_refresh=False) as bar:
            bar.add_task("measuring", total=2)
            sys.stderr.write(f"{name}\n")

    # What rich draws with is there, and nothing of what it was given.
    said = drawn(progress)
    for mine in ("\x1b[?25l", "\x1b[?25h", "\x1b[1A", "\x1b[2K", "\r"):
        said = said.replace(mine, "")
    assert not commands_in(said)


def test_text_through_the_streams_of_a_command_is_cleaned_and_what_is_drawn_is_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = sys.stdout
    with telling.clean_streams():
        sys.stderr.write("\x1b]0;owned\x07\n")
        sys.stdout.writelines(["a\x9bb\n"])
        assert sys.stdout.encoding == out.encoding
        telling.rich_console().print("plain")
    assert sys.stdout is out
    assert capsys.readouterr() == ("a\\x9bb\nplain\n", "\\x1b]0;owned\\x07\n")


BAD = "\x1b]0;owned\x07\x9b31m\u202e[/]"


@pytest.fixture(scope="module")
def hostile_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a run that can be read, and whose names are commands."""
    folder = tmp_path_factory.mktemp("hostile") / "run"
    folder.mkdir()
    names = dict.fromkeys(("version", "commit", "protocol", "world", "planner"), BAD)
    write_config(folder, {**CONFIG, **names})
    for _ in record(painted_mission(3), folder):
        pass
    write_summary(folder, {**SUMMARY, "steps": 3, "protocol": BAD, "world": BAD, "planner": BAD})
    return folder


@pytest.mark.parametrize(
    "command",
    [
        "report {}",
        "replay {}",
        "survey show {}",
        "survey add {}",
        "export {} --out x",
        "run --mission {}/config.json",
    ],
)
def test_the_names_in_a_folder_are_no_commands(
    command: str,
    hostile_run: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    run_command(command.format(hostile_run).split())
    said = "".join(capsys.readouterr())
    assert said.strip()
    assert not commands_in(said)
    assert len(said) < 2 * telling.MOST


@pytest.mark.parametrize("name", ["config.json", "summary.json", "steps.jsonl"])
def test_whatever_the_files_of_a_run_say_a_command_ends_in_clean_words(
    name: str, hostile_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A short fuzz, seeded."""
    folder = tmp_path / "run"
    shutil.copytree(hostile_run, folder)
    whole = (folder / name).read_bytes()
    rng = np.random.default_rng(39)
    pieces = (
        b'"',
        b"{",
        b"\x00",
        b"\xff\x1b[2J",
        b"1e999",
        b"-",
        b"null",
        b"[" * 300,
        b"\\ud800",
        b"y" * 9000,
    )
    failed = 0
    for _ in range(12):
        content = bytearray(whole)
        for _ in range(int(rng.integers(1, 3))):
            at = int(rng.integers(len(content)))
            content[at : at + int(rng.integers(0, 12))] = pieces[int(rng.integers(len(pieces)))]
        (folder / name).write_bytes(bytes(content))
        failed += run_command(["report", str(folder)]) == 2
        said = "".join(capsys.readouterr())
        assert said.strip()
        assert not commands_in(said)
        assert len(said) < 2 * telling.MOST
    assert failed > 0


@pytest.mark.parametrize("kind", ["title", "control of eight bits", "turned round"])
def test_the_names_in_an_archive_are_no_commands(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from dataclasses import replace

    where, survey = (
        tmp_path / "reef.gpkg",
        reef(replace(SITE, name=f"Reef {HOSTILE[kind]} [/]"), HOSTILE[kind]),
    )
    with open_archive(str(where), begin=True) as archive:
        archive.add(survey)
    files.write(survey, tmp_path / "one.survey.npz")
    for command in (
        "list",
        "show 1",
        "list --site nosuch",
        f"show {tmp_path / 'one.survey.npz'}",
        "remove 1",
    ):
        run_command(["survey", *command.split(), "--archive", str(where)])
        said = "".join(capsys.readouterr())
        assert said.strip()
        assert not commands_in(said)


def test_nobody_else_makes_a_console() -> None:
    root = Path(dream.__file__).parent
    found = [
        str(path.relative_to(root))
        for path in sorted(root.rglob("*.py"))
        if re.search(
            r"(?<![\w.])Console\(|rich\.print|\bCaptured?Console\(", path.read_text(encoding="utf-8")
        )
        and path.name != "telling.py"
    ]
    assert found == []
