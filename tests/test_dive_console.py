"""The operator's console: keys rule, and a terminal that is gone is no operator."""

import os
import threading
import time
from types import SimpleNamespace

import pytest
from rich.console import Console

from dream.commands.dive.console import KEYS, Operator, Reading, Will, _watch, page


@pytest.mark.parametrize(
    "keys, heard",
    [("p", [Will.PAUSE]), ("xhR", [Will.HOLD, Will.GO]), ("er", [Will.END]), ("sp", [Will.SURFACE])],
)
def test_keys_say_what_the_operator_wants_and_an_end_is_for_good(keys: str, heard: list[Will]) -> None:
    wishes: list[Will] = []
    operator = Operator(wishes.append, lambda idle: None)
    for key in keys:
        operator.press(key)
    assert wishes == heard
    assert operator.will is heard[-1]


def test_the_page_names_every_key_and_marks_what_is_wrong() -> None:
    console = Console(width=100, record=True, force_terminal=True)
    console.print(
        page("dive", [Reading("battery", "13.1 V", well=False), Reading("depth", "0.9 m")], Will.HOLD)
    )
    text = console.export_text(clear=False)
    assert all(f"{key} {what}"[:8] in text for key, what in KEYS.items())
    assert "the operator wants: hold" in text
    assert "\x1b[1;31m13.1 V" in console.export_text(styles=True)


def test_an_operator_whose_terminal_is_gone_is_not_alive() -> None:
    ours, theirs = os.openpty()
    heard: list[Will] = []
    signs: list[float] = []
    operator = Operator(heard.append, signs.append)
    over = threading.Event()
    terminal = SimpleNamespace(idle=0.0)
    watching = threading.Thread(target=_watch, args=("dive", list, operator, theirs, terminal, over))
    watching.start()
    try:
        os.write(ours, b"h\n")
        deadline = time.monotonic() + 5.0
        while not (heard and len(signs) > 3) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert heard == [Will.HOLD]
        os.close(ours)
        watching.join(timeout=5.0)
        assert not watching.is_alive()
    finally:
        over.set()
        watching.join(timeout=5.0)
        os.close(theirs)
