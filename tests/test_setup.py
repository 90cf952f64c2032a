"""What `make setup` does and says, with programs that note their words in the place of Python and uv."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
PYTHON = """#!/bin/sh
echo /usr/bin/python3
"""
UV = """#!/bin/sh
[ "$1" = --version ] && exit 0
echo "$@" >> "$NOTED"
eval "${MEANWHILE:-}"
mkdir -p .venv/bin && cp .tools/bin/python .venv/bin/python
"""
"""It installs a Python that can do nothing, once it has done what it was told to do meanwhile."""
OF_ALL = ("sync", "--quiet", "--locked", "--inexact", "--no-default-groups", "--python", "/usr/bin/python3")
"""Words of every request."""
SLEEP = """#!/bin/sh
exec /bin/sleep 0.1
"""

pytestmark = pytest.mark.skipif(shutil.which("sh") is None, reason="needs sh")


class Clone:
    """A clone with an installer in it, and what that installer was asked for."""

    def __init__(self, root: Path) -> None:
        self.root, self.noted = root, root / "noted"
        for name in ("scripts/setup.sh", "pyproject.toml"):
            (root / name).parent.mkdir(exist_ok=True)
            shutil.copyfile(REPOSITORY / name, root / name)
        (root / "uv.lock").touch()
        self.change("pyproject.toml", "uv.lock", seconds=-10.0)
        for name, text in (("python", PYTHON), ("uv", UV), ("sleep", SLEEP)):
            program = root / ".tools/bin" / name
            program.parent.mkdir(parents=True, exist_ok=True)
            program.write_text(text)
            program.chmod(0o755)

    def change(self, *names: str, seconds: float) -> None:
        for name in names:
            os.utime(self.root / name, (time.time() + seconds, time.time() + seconds))

    def begin(self, *sets: str, meanwhile: str = "") -> subprocess.Popen[str]:
        path = f"{self.root}/.tools/bin:{os.environ['PATH']}"
        return subprocess.Popen(
            ["sh", str(self.root / "scripts/setup.sh"), *sets],
            env={**os.environ, "PATH": path, "NOTED": str(self.noted), "MEANWHILE": meanwhile},
            stderr=subprocess.PIPE,
            text=True,
        )

    def set_up(self, *sets: str, meanwhile: str = "") -> tuple[int, str]:
        process = self.begin(*sets, meanwhile=meanwhile)
        return process.wait(), process.communicate()[1]

    def asked(self) -> list[str]:
        """Words of the newest request beside those of all."""
        if not self.noted.exists():
            return []
        words = self.noted.read_text().splitlines()[-1].split()
        self.noted.unlink()
        of_all = [
            "sync",
            "--quiet",
            "--locked",
            "--inexact",
            "--no-default-groups",
            "--python",
            "/usr/bin/python3",
        ]
        assert [word for word in of_all if word not in words] == []
        return [word for word in words if word not in of_all]


@pytest.fixture
def clone(tmp_path: Path) -> Clone:
    return Clone(tmp_path)


def test_what_is_there_stays_and_is_not_asked_for_again(clone: Clone) -> None:
    assert clone.set_up()[0] == 0
    assert clone.asked() == []
    assert not clone.noted.exists()
    assert clone.set_up("vlm", "live")[0] == 0
    assert clone.asked() == ["--extra", "live", "--extra", "vlm"]
    assert clone.set_up("dev")[0] == 0
    assert clone.asked() == ["--group", "dev", "--extra", "live", "--extra", "vlm"]
    for sets in ((), ("live",), ("dev", "vlm")):
        assert clone.set_up(*sets) == (0, "")
    assert not clone.noted.exists()


def test_after_a_change_all_that_is_there_is_asked_for(clone: Clone) -> None:
    clone.set_up("rov")
    for name in ("uv.lock", "pyproject.toml"):
        clone.noted.unlink()
        clone.change(name, seconds=1.0)
        clone.set_up()
        assert clone.asked() == ["--extra", "rov"]
        clone.change(name, seconds=-10.0)
        clone.set_up("rov")
        assert not clone.noted.exists()
        clone.noted.touch()


def test_an_environment_whose_python_is_gone_is_built_again(clone: Clone) -> None:
    clone.set_up()
    clone.noted.unlink()
    (clone.root / ".venv/bin/python").unlink()
    assert clone.set_up()[0] == 0
    assert clone.noted.exists()


def test_a_name_that_is_no_extra_is_refused(clone: Clone) -> None:
    status, said = clone.set_up("vlm", "vml")
    assert status == 2
    assert said.startswith("dream: EXTRAS: expected some of ray, vlm, rov, ")
    assert said.endswith(", got vml\n")
    assert not clone.noted.exists()


def test_it_says_at_once_what_it_does_and_then_every_ten_seconds(clone: Clone) -> None:
    status, said = clone.set_up("vlm", meanwhile="/bin/sleep 0.5")
    doing = "dream: setting up: loading and installing packages in .venv (base vlm)"
    assert status == 0
    assert said.splitlines()[:3] == [f"{doing} ...", f"{doing}, 10 s", f"{doing}, 20 s"]


def test_a_failure_is_told_with_what_to_set_and_the_next_try_repairs(clone: Clone) -> None:
    status, said = clone.set_up(meanwhile="echo 'invalid peer certificate: UnknownIssuer' >&2; exit 2")
    assert status == 1
    assert "invalid peer certificate: UnknownIssuer" in said
    assert "export SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt" in said
    assert clone.set_up()[0] == 0
    assert clone.asked() == ["--reinstall"]
    clone.set_up("vlm")
    assert clone.asked() == ["--extra", "vlm"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_one_that_was_ended_is_repaired_by_the_next(clone: Clone, number: signal.Signals) -> None:
    process = clone.begin(meanwhile="echo $$ > began; /bin/sleep 0.5; exit 1")
    until = time.monotonic() + 20.0
    while not (clone.root / "began").exists() and time.monotonic() < until:
        time.sleep(0.02)
    process.send_signal(number)
    assert process.wait() != 0
    process.communicate()
    assert clone.set_up()[0] == 0
    assert "--reinstall" in clone.asked()


def test_two_at_once_do_not_repair_each_other(clone: Clone) -> None:
    first = clone.begin(meanwhile="touch began; /bin/sleep 0.5")
    until = time.monotonic() + 20.0
    while not (clone.root / "began").exists() and time.monotonic() < until:
        time.sleep(0.02)
    status, said = clone.set_up()
    assert (status, first.wait()) == (0, 0)
    first.communicate()
    assert said.startswith(f"dream: waiting for the set-up of process {first.pid} ")
    assert len(clone.noted.read_text().splitlines()) == 1
