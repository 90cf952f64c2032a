"""The network that comes with DREAM is the one that its card tells of, and is flown as it was chosen."""

from __future__ import annotations

import hashlib
import json

from dream.learning.export import MOST_BYTES
from dream.learning.network import MOST_PARAMETERS
from dream.perception.representation import CLOSEST, HEIGHT, WIDTH
from dream.planning.baselines.uivnav import SHIPPED, TURNS_DEG, UivNav

CARD = json.loads(SHIPPED.with_suffix(".json").read_text(encoding="utf-8"))


def test_the_card_tells_of_this_file() -> None:
    model = SHIPPED.read_bytes()
    assert hashlib.sha256(model).hexdigest() == CARD["sha256"]
    assert len(model) == CARD["bytes"] < MOST_BYTES
    assert CARD["parameters"] < MOST_PARAMETERS
    assert CARD["input"]["shape"] == ["n", 2, HEIGHT, WIDTH]
    assert CARD["input"]["closest"] == CLOSEST
    assert tuple(CARD["turns_deg"]) == TURNS_DEG


def test_it_is_flown_as_it_was_chosen() -> None:
    assert UivNav().temperature == CARD["temperature"]
    rows = CARD["trials"]["rows"]
    chosen = max((name for name in rows if name.startswith("student")), key=lambda name: rows[name]["share"])
    assert chosen.endswith(f"at {CARD['temperature']:g}")


def test_it_saw_more_than_the_blind_on_reefs_that_nothing_was_learned_from() -> None:
    rows = CARD["trials"]["rows"]
    best = max(
        (row for name, row in rows.items() if name.startswith("student")), key=lambda row: row["share"]
    )
    for blind in ("random", "lawnmower"):
        assert best["targets_per_metre"] > rows[blind]["targets_per_metre"]
