"""What a dive prints keeps nobody waiting: a terminal that is stopped, a pipe that nobody reads."""

import contextlib
import fcntl
import json
import math
import os
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from dream.commands.console import kept_interrupts
from dream.commands.dive.console import Operator, Reading, Will, console
from dream.commands.dive.terminal import ROOM, _Way
from dream.robots.bluerov2.log import NAME, read_log, read_wire

STOP, GO_ON = b"\x13", b"\x11"
"""Ctrl-S and Ctrl-Q."""
SMALL = 4096
"""Bytes that a pipe holds here."""


@dataclass
class Placed:
    """A way in between, and its two ends."""

    way: _Way
    ours: int
    """Where what is written arrives, and where keys are pressed."""
    keyboard: int
    """What keys arrive at."""
    descriptor: int
    """What is written to."""
    closed: bool = False

    def close(self, seconds: float) -> int:
        """As `_Way.close`, which is done once."""
        self.closed = True
        return self.way.close(time.monotonic() + seconds)

    def write(self, text: str) -> None:
        os.write(self.descriptor, text.encode())

    def read(self, until: str) -> str:
        """What arrives, up to these words."""
        text = ""
        deadline = time.monotonic() + 10.0
        while until not in text:
            comes, _, _ = select.select([self.ours], [], [], max(0.0, deadline - time.monotonic()))
            assert comes, f"{until!r} is not in {text[-200:]!r}"
            text += os.read(self.ours, 1 << 16).decode()
        return text


@contextlib.contextmanager
def placed(ours: int, place: int) -> Iterator[Placed]:
    """Before a place of a pipe or a terminal; the test may close our end."""
    descriptor = os.dup(place)
    there = Placed(_Way([descriptor], tells=True), ours, place, descriptor)
    try:
        yield there
    finally:
        if not there.closed:
            there.close(0.0)
        os.close(descriptor)
        os.close(place)
        with contextlib.suppress(OSError):
            os.close(ours)


@pytest.fixture
def terminal() -> Iterator[Placed]:
    with placed(*os.openpty()) as there:
        yield there


@pytest.fixture
def pipe() -> Iterator[Placed]:
    with placed(*small_pipe()) as there:
        yield there


def small_pipe() -> tuple[int, int]:
    ours, theirs = os.pipe()
    fcntl.fcntl(theirs, fcntl.F_SETPIPE_SZ, SMALL)
    return ours, theirs


def wait(until: Callable[[], object], seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_who_writes_where_nobody_reads_does_not_wait_and_is_told_what_was_lost(pipe: Placed) -> None:
    began = time.monotonic()
    lines = 3 * ROOM // 1000
    for number in range(lines):
        pipe.write(f"{number:06} {'x' * 992}\n")
    assert time.monotonic() - began < 5.0
    assert pipe.way.idle < 5.0
    text = pipe.read("not shown\n")
    *shown, told = text.splitlines()
    numbers = [int(line[:6]) for line in shown if len(line) == 999]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > ROOM // 1000 - 70
    lost = int(told.split()[1])
    assert told == f"dream: {lost} lines were not shown"
    # A line that was cut counts as shown or as lost.
    assert abs(lines - len(numbers) - lost) <= 1
    pipe.write("and on\n")
    assert pipe.read("on\n") == "and on\n"


def test_a_stopped_terminal_is_idle_and_takes_up_where_it_was_stopped(terminal: Placed) -> None:
    terminal.write("before\n")
    assert terminal.read("\n") == "before\r\n"
    os.write(terminal.ours, STOP)
    terminal.write("meanwhile\n")
    wait(lambda: terminal.way.idle > 0.5)
    os.write(terminal.ours, GO_ON)
    assert "meanwhile" in terminal.read("meanwhile")
    wait(lambda: terminal.way.idle < 0.2)


def test_one_that_nothing_is_written_to_is_idle_as_soon_as_it_is_stopped(terminal: Placed) -> None:
    wait(lambda: terminal.way.idle < 0.2)
    os.write(terminal.ours, STOP)
    wait(lambda: terminal.way.idle > 0.5)


def test_where_a_terminal_stood_stands_one_of_its_size(terminal: Placed) -> None:
    assert os.isatty(terminal.descriptor)
    for size in ((40, 132), (24, 70)):
        termios.tcsetwinsize(terminal.keyboard, size)
        wait(lambda size=size: termios.tcgetwinsize(terminal.descriptor) == size)  # type: ignore[misc]


def test_where_a_pipe_was_is_no_terminal(pipe: Placed) -> None:
    assert not os.isatty(pipe.descriptor)
    pipe.write("as it is\n")
    assert pipe.read("\n") == "as it is\n"


def test_one_that_is_gone_hurts_nobody_who_writes(terminal: Placed, pipe: Placed) -> None:
    for there in (terminal, pipe):
        os.close(there.ours)
        there.write("is anybody there\n")
        wait(lambda there=there: there.way.idle == math.inf)  # type: ignore[misc]
        there.write("no\n")


def test_the_end_does_not_wait_for_a_terminal_that_stays_stopped(terminal: Placed) -> None:
    os.write(terminal.ours, STOP)
    wait(lambda: terminal.way.idle > 0.1)
    terminal.write("one\ntwo\n")
    began = time.monotonic()
    assert terminal.close(0.3) == 2
    assert time.monotonic() - began < 1.0
    terminal.write("this leads nowhere\n")


@pytest.mark.parametrize("pause", [0.0, 0.2])
def test_the_end_waits_for_one_who_reads_late(pipe: Placed, pause: float) -> None:
    text = "y" * 3 * SMALL + "\n"
    pipe.write(text)
    got = bytearray()

    def read() -> None:
        while len(got) < len(text):
            time.sleep(pause)
            got.extend(os.read(pipe.ours, SMALL))

    reading = threading.Timer(0.3, read)
    reading.start()
    assert pipe.close(10.0) == 0
    reading.join()
    assert got == text.encode()
    # From here on it is as if nothing had been in between.
    pipe.write("and on\n")
    assert pipe.read("on\n") == "and on\n"


def test_what_fits_into_a_pipe_is_whole_however_late_it_is_read(pipe: Placed) -> None:
    text = "z" * (SMALL - 1) + "\n"
    pipe.write(text)
    wait(lambda: not pipe.way._waiting)
    assert pipe.close(0.1) == 0
    assert pipe.read("\n") == text


WRITES = """
import json, logging, os, subprocess, sys, warnings
from dream.commands.dive import terminal
terminal.PATIENCE = 0.5
old = logging.StreamHandler()
logging.getLogger().addHandler(old)
from rich.console import Console
with terminal.Terminal():
    for number in range(400):
        logging.warning("%d %s", number, 100 * "x")
        print(number, 100 * "y", file=sys.__stderr__)
        warnings.warn(f"{number} " + 100 * "z")
        Console(stderr=True).print(number, 100 * "r")
        os.write(2, b"as C does\\n")
    subprocess.run([sys.executable, "-S", "-c", "print('a child' * 1000)"], check=True)
    print(json.dumps({"whole": 2000 * "x"}))
print("the last word", file=sys.stderr)
"""


def programs(**pipes: int) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", WRITES], **pipes)  # type: ignore[call-overload,no-any-return]


def test_a_program_ends_by_itself_though_nobody_reads_what_it_printed() -> None:
    (ours, out), (ours_too, err) = small_pipe(), small_pipe()
    with programs(stdout=out, stderr=err) as program:
        os.close(out)
        os.close(err)
        try:
            # Its start takes a second or two, the writing none.
            assert program.wait(60.0) == 0
        finally:
            program.kill()
    os.close(ours)
    os.close(ours_too)


def test_what_a_program_printed_is_whole_where_it_is_read() -> None:
    with programs(stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        out, err = program.communicate(timeout=60.0)
    *child, told = out.decode().splitlines()
    assert child == ["a child" * 1000]
    assert json.loads(told) == {"whole": 2000 * "x"}
    lines = err.decode().splitlines()
    assert lines[-1] == "the last word"
    assert sum(line.endswith(100 * "y") for line in lines) == 400


def test_the_console_is_entered_and_left_though_its_terminal_is_stopped(
    terminal: Placed, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.write(terminal.ours, STOP)
    wait(lambda: terminal.way.idle > 0.2)
    monkeypatch.setattr("sys.stdin", os.fdopen(terminal.keyboard, closefd=False))
    monkeypatch.setattr("sys.stderr", os.fdopen(terminal.descriptor, "w", closefd=False))
    before = termios.tcgetattr(terminal.keyboard)
    heard: list[Will] = []
    idle: list[float] = []
    drawn: list[float] = []

    def read() -> list[Reading]:
        drawn.append(time.monotonic())
        return []

    began = time.monotonic()
    way: Any = terminal.way
    with console("dive", read, Operator(heard.append, idle.append), way) as shown:
        assert shown
        assert time.monotonic() - began < 1.0
        # Keys rule, and nobody who sees nothing counts as an operator.
        os.write(terminal.ours, b"e")
        wait(lambda: heard == [Will.END])
        assert min(idle) > 0.2
        assert drawn == []
        os.write(terminal.ours, GO_ON)
        wait(lambda: drawn and idle[-1] < 0.2)
        os.write(terminal.ours, STOP)
        wait(lambda: idle[-1] > 0.3)
        left = time.monotonic()
    assert time.monotonic() - left < 1.5
    assert termios.tcgetattr(terminal.keyboard) == before


def test_ctrl_c_pressed_again_counts_only_where_it_is_meant() -> None:
    meant = False
    sinces: list[float] = []

    def again(since: float) -> bool:
        sinces.append(since)
        return meant

    with kept_interrupts(again):
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        assert sinces[0] < 1.0
        meant = True
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


def neutral(message: Any) -> bool:
    return (message.x, message.y, message.z, message.r) == (0, 0, 500, 0)


@pytest.mark.rare
@pytest.mark.slow
def test_a_vehicle_comes_up_though_the_terminal_of_its_dive_is_stopped_for_ever(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    dialect = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    ours, theirs = os.openpty()
    stopped = threading.Event()

    def show() -> None:
        with contextlib.suppress(OSError):
            while not stopped.is_set():
                os.read(ours, 1 << 16)

    dive = ["dive", "--stand-in", "--last-resort", "surface", "--max-steps", "40", "--out", str(tmp_path)]
    with subprocess.Popen(
        [sys.executable, "-m", "dream", *dive],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    ) as program:
        threading.Thread(target=show, daemon=True).start()
        try:
            wait(lambda: steps(tmp_path) >= 2 or program.poll() is not None, 300.0)
            # The log says when this came, and so what its clock was when the terminal was stopped.
            os.write(ours, b"r")
            stopped_at = time.monotonic()
            os.write(ours, STOP)
            stopped.set()
            assert program.wait(60.0) == 1
            ended_at = time.monotonic()
        finally:
            program.kill()
    folder = tmp_path / (tmp_path / "latest").readlink()
    ((wanted_at, wanted),) = [(m.time, m.message.data) for m in read_log(folder / NAME, ["/operator"])]
    assert json.loads(wanted)["said"] == {"wants": "go"}
    standings = [(m.time, json.loads(m.message.data)["said"]) for m in read_log(folder / NAME, ["/standing"])]
    parser = dialect.MAVLink(None)
    wire = [
        (at, sent, message)
        for at, sent, packet in read_wire(folder / NAME, "mavlink")
        for message in parser.parse_buffer(packet) or ()
    ]
    sticks = [(at, m) for at, sent, m in wire if sent and m.get_type() == "MANUAL_CONTROL"]
    moving = [at - wanted_at for at, m in sticks if not neutral(m)]
    alone = "no sign of life from the operator"
    gone = [at - wanted_at for at, said in standings if said["reason"] == alone and at > wanted_at]
    modes = [
        (at - wanted_at, m.param2)
        for at, sent, m in wire
        if sent and m.get_type() == "COMMAND_LONG" and m.command == 176
    ]
    beats = [m for _, sent, m in wire if not sent and m.get_type() == "HEARTBEAT" and m.autopilot == 3]
    assert gone[0] < 0.5
    assert max(moving) < 0.5
    surfaced = next(at for at, mode in modes if mode == 9.0)
    assert gone[0] + 4.9 < surfaced < gone[0] + 5.5
    assert not beats[-1].base_mode & 128
    # All of it was written, the rest of the terminal was not waited for.
    assert json.loads((folder / "summary.json").read_text())["dive"]["log_lost"] == {}
    assert not caplog.messages
    assert ended_at - stopped_at < 40.0
    os.close(theirs)
    os.close(ours)


def steps(out: Path) -> int:
    """Of the newest run."""
    told = [*out.glob("*/steps.jsonl")]
    return told[0].read_text().count("\n") if told else 0
