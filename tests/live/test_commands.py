"""`dream watch` and `dream run --live`, as processes of their own."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

import pytest

from dream.cli import run_command
from dream.extras import missing
from tests.live.runs import Growing

Make = Callable[..., Growing]
needs_server = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("fastapi", "uvicorn")),
    reason="needs the extra live",
)
WAIT_S = 60.0


def started(*arguments: str) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "dream.cli", *arguments]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def given(address: str) -> str:
    with urllib.request.urlopen(address, timeout=10.0) as answer:
        text: str = answer.read().decode()
    return text


def is_gone(address: str) -> bool:
    """Whether nobody listens there within a while."""
    until = time.monotonic() + WAIT_S
    while time.monotonic() < until:
        try:
            given(address)
        except urllib.error.HTTPError:
            pass
        except OSError:
            return True
        time.sleep(0.1)
    return False


@pytest.mark.parametrize("words", [["watch"], ["run", "--live"], ["dive", "--stand-in", "--live"]])
def test_without_what_it_needs_it_says_what_to_install(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.chdir(tmp_path)
    assert run_command(words) == 2
    assert missing("live", "fastapi", "a live page") in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@needs_server
@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--port", "70000"], "--port: expected 0 to 65535"),
        (["--host", "no-such-host.invalid"], "--host, --port: expected a place to listen at"),
        (["--host", "0.0.0.0", "--token-file", "short"], "token: expected at least 16 plain characters"),
        (["--token-file", "none"], "No such file"),
    ],
)
def test_what_cannot_be_served_is_told_in_a_line(
    options: list[str],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short").write_text("s3cret\n")
    assert run_command(["watch", str(tmp_path), *options]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert "s3cret" not in said


@pytest.mark.slow
@needs_server
def test_a_token_is_made_for_others_and_told_once(growing: Make) -> None:
    run = growing().write(2)
    server = started("watch", str(run.folder), "--host", "0.0.0.0", "--port", "0", "--json")
    assert server.stdout is not None
    try:
        address = json.loads(server.stdout.readline())["address"]
        token = re.search(r"\?token=([\w-]{32,})$", address)
        port = re.search(r":(\d+)/", address)
        assert token is not None
        assert port is not None
        with pytest.raises(urllib.error.HTTPError, match="401"):
            given(f"http://127.0.0.1:{port[1]}/events")
        with contextlib.suppress(urllib.error.HTTPError):  # Into the page, by a client that keeps no cookie.
            given(f"http://127.0.0.1:{port[1]}/?token={token[1]}")
    finally:
        server.send_signal(signal.SIGINT)
        told, said = server.communicate(timeout=WAIT_S)
    assert server.returncode == 0
    assert token[1] not in told + said


@pytest.mark.slow
@needs_server
def test_a_mission_is_served_while_it_flies_and_ends_as_ever(tmp_path: Path) -> None:
    mission = started(
        "run",
        "lawnmower",
        "--world",
        "flat/empty",
        "--max-steps",
        "3",
        "--out",
        str(tmp_path),
        "--live",
        "--json",
    )
    assert mission.stderr is not None
    address = re.search(r"http://\S+", mission.stderr.readline())
    assert address is not None
    with contextlib.suppress(OSError):  # Over already, on a fast machine.
        assert "DREAM live" in given(address[0])
    told, _ = mission.communicate(timeout=WAIT_S)
    assert mission.returncode == 0
    assert json.loads(told)["steps"] == 3
    assert is_gone(address[0])


@pytest.mark.slow
@needs_server
def test_what_lies_where_it_is_called_from_is_not_run(growing: Make, tmp_path: Path) -> None:
    run = growing().write(1)
    (tmp_path / "uvicorn.py").write_text("open('run by mistake', 'w').close()")
    code = (
        "import sys, time; from pathlib import Path; from dream.live.beside import shown_live\n"
        "with shown_live(Path(sys.argv[1])):\n"
        "    time.sleep(600)"
    )
    # As the installed command, which has the folder of the command first and not the working directory.
    words = [sys.executable, "-P", "-c", code, str(run.folder)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as mission:
        try:
            assert mission.stderr is not None
            address = re.search(r"http://\S+", mission.stderr.readline())
            assert address is not None
            assert "DREAM live" in given(address[0])
        finally:
            mission.kill()
    assert not (tmp_path / "run by mistake").exists()
    assert is_gone(address[0])


@pytest.mark.rare
@pytest.mark.slow
@needs_server
def test_a_server_outlives_no_mission(growing: Make) -> None:
    run = growing().write(1)
    code = (
        "import sys, time; from pathlib import Path; from dream.live.beside import shown_live\n"
        "with shown_live(Path(sys.argv[1])):\n"
        "    time.sleep(600)"
    )
    mission = subprocess.Popen(
        [sys.executable, "-c", code, str(run.folder)], stderr=subprocess.PIPE, text=True
    )
    assert mission.stderr is not None
    address = re.search(r"http://\S+", mission.stderr.readline())
    assert address is not None
    assert "DREAM live" in given(address[0])
    os.kill(mission.pid, signal.SIGKILL)
    mission.wait()
    mission.stderr.close()
    assert is_gone(address[0])
