"""The planner that steers by sight alone."""

from __future__ import annotations

import hashlib
import json
import math
import re
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper

from dream.evaluation.runner import simulate
from dream.extras import missing
from dream.geometry import SE3
from dream.planning import UivNav
from dream.planning.baselines import uivnav
from dream.planning.baselines.uivnav import TURNS_DEG, opened
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.sim.world import World
from dream.types import Decision, Label, Mission, Observation
from tests.perception.models import constant, save
from tests.planning.flights import observed_at
from tests.planning.policies import always, linear, symmetrical, toward_the_target


class Nowhere:
    """A map that nobody may look at."""

    def __getattr__(self, name: str) -> Any:
        raise AssertionError(f"read {name} of the map")


def decided(planner: UivNav, *seen: Observation, protocol: SurveyProtocol = DREAM_V1) -> list[Decision]:
    """What one pilot says to these observations in turn."""
    pilot = planner.begin(Mission(protocol, None, 200))  # type: ignore[arg-type]
    return [pilot.decide(observation, Nowhere()) for observation in seen]  # type: ignore[arg-type]


def with_target(columns: slice) -> Observation:
    """Seabed at 3 m with target in some columns."""
    blank = observed_at(0.0, 0.0, 0.0)
    labels = np.full_like(blank.labels, Label.SEABED)
    labels[150:200, columns] = Label.TARGET
    return replace(blank, depth=np.full_like(blank.depth, 3.0), labels=labels)


def anything(seed: int) -> Observation:
    """A frame of noise."""
    rng = np.random.default_rng(seed)
    blank = observed_at(0.0, 0.0, 0.0)
    depth = rng.uniform(0.2, 20.0, blank.depth.shape).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = np.nan
    return replace(blank, depth=depth, labels=rng.integers(0, 4, depth.shape).astype(np.uint8))


def test_it_turns_to_where_the_target_is(tmp_path: Path) -> None:
    planner = UivNav(temperature=0.0, weights=str(toward_the_target(tmp_path / "m.onnx")))
    seen = [with_target(slice(at, at + 20)) for at in (0, 60, 105, 150, 195, 240, 300)]
    turns = [round(math.degrees(decision.turn)) for decision in decided(planner, *seen)]
    assert turns == [90, 60, 30, 0, -30, -60, -90], "what is at the left of a picture is to the left"


def test_in_a_mirrored_world_it_turns_the_other_way(tmp_path: Path) -> None:
    planner = UivNav(temperature=0.0, weights=str(symmetrical(tmp_path / "m.onnx")))
    turned = 0.0
    for seed in range(12):
        seen = anything(seed)
        mirrored = replace(seen, depth=seen.depth[:, ::-1], labels=seen.labels[:, ::-1])
        (one,), (other,) = decided(planner, seen), decided(planner, mirrored)
        assert other.turn == pytest.approx(-one.turn)
        turned += abs(one.turn)
    assert turned > 0.0


def test_it_neither_reads_the_map_nor_knows_where_it_is_nor_sees_colours(tmp_path: Path) -> None:
    planner = UivNav(weights=str(symmetrical(tmp_path / "m.onnx")))
    for seed in range(6):
        seen = anything(seed)
        elsewhere = replace(
            seen,
            time=99.0,
            rgb=np.full_like(seen.rgb, 200),
            T_world_base=SE3.level(7.0, -3.0, -8.0, 2.0),
        )
        assert decided(planner, seen) == decided(planner, elsewhere)


@pytest.mark.parametrize("protocol", [DREAM_V1, POOL_V1], ids=lambda protocol: protocol.name)
def test_it_never_stops_and_its_moves_are_moves_of_the_protocol(
    protocol: SurveyProtocol, tmp_path: Path
) -> None:
    planner = UivNav(temperature=10.0, weights=str(always(tmp_path / "m.onnx", np.zeros(7))))
    blind = observed_at(0.0, 0.0, 0.0)
    decisions = decided(planner, *[blind] * 60, *map(anything, range(10)), protocol=protocol)
    assert {decision.advance for decision in decisions} == {max(protocol.advances)}
    assert not any(decision.done for decision in decisions)
    assert {round(math.degrees(decision.turn)) for decision in decisions} == set(TURNS_DEG)
    for decision in decisions:
        assert min(abs(decision.turn - turn) for turn in protocol.turn_angles) < 1e-9
        assert f"for {max(protocol.advances):g} m" in decision.reasoning.action


def test_a_turn_that_the_protocol_lacks_becomes_the_nearest(tmp_path: Path) -> None:
    coarse = replace(DREAM_V1, name="coarse", headings=4, turns=(0, 1, -1, 2))
    turns = []
    for k in range(7):
        planner = UivNav(temperature=0.0, weights=str(always(tmp_path / "m.onnx", np.eye(7)[k])))
        (decision,) = decided(planner, anything(0), protocol=coarse)
        turns.append(round(math.degrees(decision.turn)))
    assert turns == [-90, -90, 0, 0, 0, 90, 90]


@pytest.mark.rare
def test_it_draws_as_often_as_the_network_says(tmp_path: Path) -> None:
    shares = np.array([0.05, 0.05, 0.1, 0.5, 0.2, 0.05, 0.05])
    path = str(always(tmp_path / "m.onnx", np.log(shares)))
    same = [observed_at(float(k), 0.0, 0.0) for k in range(250)]
    for temperature, expected in ((1.0, shares), (0.5, shares**2 / (shares**2).sum())):
        drawn = Counter(d.turn for d in decided(UivNav(temperature=temperature, weights=path), *same))
        found = np.array([drawn[math.radians(turn)] for turn in TURNS_DEG]) / len(same)
        # Four standard deviations of a share.
        assert (np.abs(found - expected) < 4.0 * np.sqrt(expected / len(same))).all(), temperature
    assert {d.turn for d in decided(UivNav(temperature=0.0, weights=path), *same[:20])} == {0.0}


def test_frames_that_are_alike_are_not_answered_alike_for_ever_but_as_the_seed_says(tmp_path: Path) -> None:
    path = str(always(tmp_path / "m.onnx", np.zeros(7)))
    same = [anything(1)] * 12
    first = decided(UivNav(temperature=1.0, weights=path), *same)
    assert len({decision.turn for decision in first}) > 2
    assert decided(UivNav(temperature=1.0, weights=path), *same) == first
    assert decided(UivNav(temperature=1.0, weights=path, walk_seed=1), *same) != first


def test_straight_on_that_got_it_nowhere_is_not_tried_again_at_once(tmp_path: Path) -> None:
    path = str(always(tmp_path / "m.onnx", [0.0, 0.0, 2.0, 9.0, 0.0, 0.0, 0.0]))
    here, farther = observed_at(0.0, 0.0, 0.0), observed_at(1.0, 0.0, 0.0)
    turned = observed_at(1.0, 0.0, -math.pi / 6.0)
    seen = [here, farther, farther, turned, turned, turned]
    turns = [round(math.degrees(d.turn)) for d in decided(UivNav(temperature=0.0, weights=path), *seen)]
    assert turns == [0, 0, -30, 0, -30, 0]


def test_depth_counts_in_the_protocol_s_altitude(tmp_path: Path) -> None:
    weights = np.zeros((2, 72, 96, 7))
    weights[0, 0, 0, 6] = 1.0
    # Left where nearness exceeds 60 of 255, as at 2.1 m and 2 m of altitude, and at 0.63 m in the tank.
    path = linear(tmp_path / "m.onnx", weights, [0.0] * 3 + [60.0 / 255.0] + [0.0] * 3)
    planner = UivNav(temperature=0.0, weights=str(path))
    blank = observed_at(0.0, 0.0, 0.0)
    labels = np.full_like(blank.labels, Label.SEABED)

    def turn(depth: float, protocol: SurveyProtocol) -> float:
        seen = replace(blank, depth=np.full_like(blank.depth, depth), labels=labels)
        return decided(planner, seen, protocol=protocol)[0].turn

    assert turn(2.0, DREAM_V1) > 0.0
    assert turn(2.3, DREAM_V1) == 0.0
    assert turn(0.6, POOL_V1) > 0.0
    assert turn(0.69, POOL_V1) == 0.0


def test_a_mission_ends_at_the_cap(empty_world: World, tmp_path: Path) -> None:
    planner = UivNav(weights=str(symmetrical(tmp_path / "m.onnx")))
    *_, last = simulate(empty_world, planner, DREAM_V1, max_steps=12)
    assert (last.ended, last.index) == ("cap", 12)


# ------------------------------------------------------------------------------------ what is not let in


def refused(path: Path | str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        UivNav(weights=str(path)).begin(Mission(DREAM_V1, None, 200))  # type: ignore[arg-type]


def test_a_network_for_other_pictures_is_refused(tmp_path: Path) -> None:
    wrong = r"expected an input of \(n, 2, 72, 96\), got .* Was it trained on `perception.represent`\?"
    refused(linear(tmp_path / "a.onnx", np.zeros((3, 72, 96, 7))), wrong)
    refused(linear(tmp_path / "b.onnx", np.zeros((2, 96, 72, 7))), wrong)


def test_a_network_with_other_answers_is_refused(tmp_path: Path) -> None:
    refused(always(tmp_path / "a.onnx", np.zeros(6)), r"expected \(n, 7\) logits.*got \(1, 6\)")
    refused(always(tmp_path / "b.onnx", [0.0] * 6 + [np.nan]), "expected finite numbers in logits")
    twice = [helper.make_node("Identity", ["images"], [name]) for name in ("one", "two")]
    shape: list[int | str] = [1, 2, 72, 96]
    both = save(tmp_path / "c.onnx", twice, {}, shape, {"one": shape, "two": shape})
    refused(both, "expected one output, got one, two")


def test_a_network_that_fails_only_on_some_pictures_is_found_out(tmp_path: Path) -> None:
    # The logarithm of a picture without anything in it is not finite.
    nodes = [
        helper.make_node("Flatten", ["images"], ["flat"]),
        helper.make_node("MatMul", ["flat", "weights"], ["sums"]),
        helper.make_node("Log", ["sums"], ["logits"]),
    ]
    path = save(
        tmp_path / "m.onnx",
        nodes,
        {"weights": np.ones((2 * 72 * 96, 7))},
        [1, 2, 72, 96],
        {"logits": [1, 7]},
    )
    refused(path, "expected finite numbers in logits")


def test_files_that_are_no_network_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    good = symmetrical(tmp_path / "m.onnx")
    refused(tmp_path / "none.onnx", "expected a readable file")
    cut = tmp_path / "cut.onnx"
    cut.write_bytes(good.read_bytes()[:-100])
    refused(cut, r"Is it truncated\?")
    noise = tmp_path / "noise.onnx"
    noise.write_bytes(np.random.default_rng(0).bytes(5000))
    refused(noise, "model: ")
    depth = constant(tmp_path / "depth.onnx", np.ones((2, 2)))
    refused(depth, r"expected an input of \(n, 2, 72, 96\)")
    monkeypatch.setattr(uivnav, "MOST_BYTES", 100_000)
    refused(good, "expected at most 0 MiB, got more")


def test_an_input_of_bytes_is_refused(tmp_path: Path) -> None:
    cast = helper.make_node("Cast", ["images"], ["y"], to=TensorProto.FLOAT)
    shape: list[int | str] = [1, 2, 72, 96]
    refused(save(tmp_path / "m.onnx", [cast], {}, shape, {"y": shape}, kind=TensorProto.UINT8), "tensor")


def test_the_network_that_comes_with_it_must_be_the_one_of_its_card(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = symmetrical(tmp_path / "m.onnx")
    card = good.with_suffix(".json")
    monkeypatch.setattr(uivnav, "SHIPPED", good)
    with pytest.raises(ValueError, match=r"card: expected the network's sha256 in .*m\.json"):
        opened()
    for text in ("", "[]", '{"seeds": 1}'):
        card.write_text(text)
        with pytest.raises(ValueError, match="card: expected the network's sha256"):
            opened()
    card.write_text(json.dumps({"sha256": hashlib.sha256(good.read_bytes()).hexdigest()}))
    opened()
    symmetrical(good, seed=1)
    with pytest.raises(ValueError, match=r"model: expected .* with SHA-256 .* Was it replaced or damaged\?"):
        opened()


def test_the_network_that_comes_with_it_is_small_and_knows_no_left_from_right() -> None:
    card = json.loads(uivnav.SHIPPED.with_suffix(".json").read_text())
    assert uivnav.SHIPPED.stat().st_size < 3_000_000
    assert UivNav().temperature == card["temperature"], "drawn as freely as it was tried out"
    policy = opened()
    for seed in range(4):
        picture = np.random.default_rng(seed).integers(0, 256, (2, 72, 96), dtype=np.uint8)
        there, mirrored = policy.logits(picture), policy.logits(picture[:, :, ::-1])
        np.testing.assert_allclose(mirrored[::-1], there, atol=1e-4)
        assert np.ptp(there) > 0.01


def test_without_onnx_runtime_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    refused(symmetrical(tmp_path / "m.onnx"), re.escape(missing("learned", "onnxruntime", "model")))
