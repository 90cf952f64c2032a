"""A Gaussian field of targets against the same worked out with dense matrices of all squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dream.geometry import Bounds
from dream.planning.target_field import MOST, TargetField, prior
from dream.protocol import DREAM_V1, POOL_V1, SurveyProtocol
from dream.types import Mission
from tests.mapping.analytic import AREA, map_with
from tests.planning.flights import all_but

SMALL = Bounds(0.0, 0.0, 6.0, 5.0)
KNOWN = np.array([3, 4, 9, 17, 22, 28])
Array = np.ndarray[Any, Any]


def field(area: Bounds = SMALL, protocol: SurveyProtocol = DREAM_V1) -> TargetField:
    return TargetField(Mission(protocol, area, 200), distance=6.0, mean=0.1, deviation=0.3)


def dense(squares: TargetField) -> Array:
    """(n, n) covariance before anything is known, with its scale."""
    precision = prior(squares.shape, 6.0)[0].toarray()
    covariance = np.linalg.inv(precision)
    scaled: Array = covariance * 0.3**2 / np.diag(covariance).mean()
    return scaled


def log_det(matrix: Array) -> float:
    return float(np.linalg.slogdet(matrix)[1])


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (4, 3), (5, 6)])
def test_the_covariance_is_the_inverse_of_the_precision(shape: tuple[int, int]) -> None:
    precision, covariance = prior(shape, 5.0)
    np.testing.assert_allclose(precision.toarray() @ covariance, np.eye(shape[0] * shape[1]), atol=1e-9)


def test_what_is_known_pins_the_rest_as_in_the_dense_closed_form() -> None:
    squares, whole = field(), dense(field())
    squares.share[KNOWN] = np.linspace(0.0, 1.0, len(KNOWN))
    for some in (KNOWN[:2], KNOWN[2:]):
        squares.condition(some)
    rest = np.setdiff1d(np.arange(len(whole)), KNOWN)
    gain = whole[np.ix_(rest, KNOWN)] @ np.linalg.inv(whole[np.ix_(KNOWN, KNOWN)])
    left = whole[np.ix_(rest, rest)] - gain @ whole[np.ix_(KNOWN, rest)]
    np.testing.assert_allclose(squares.variances[rest], np.diag(left), atol=1e-12)
    np.testing.assert_allclose(squares.expected[rest], 0.1 + gain @ (squares.share[KNOWN] - 0.1), atol=1e-12)
    assert (squares.variances[KNOWN] == 0.0).all()
    np.testing.assert_array_equal(squares.expected[KNOWN], squares.share[KNOWN])


@pytest.mark.parametrize("known", [KNOWN[:0], KNOWN])
def test_mutual_information_is_that_of_the_dense_closed_form(known: Array) -> None:
    squares, whole = field(), dense(field())
    squares.condition(known)
    rest = np.setdiff1d(np.arange(len(whole)), known)
    left = whole[np.ix_(rest, rest)]
    if len(known):
        cross = whole[np.ix_(rest, known)]
        left = left - cross @ np.linalg.solve(whole[np.ix_(known, known)], cross.T)
    rng = np.random.default_rng(0)
    for size in (1, 2, 7, len(rest) - 3):
        some = np.sort(rng.choice(len(rest), size, replace=False))
        others = np.setdiff1d(np.arange(len(rest)), some)
        parts = log_det(left[np.ix_(some, some)]) + log_det(left[np.ix_(others, others)])
        expected = 0.5 * (parts - log_det(left))
        assert expected > 1e-3
        assert squares.information(rest[some]) == pytest.approx(expected, rel=1e-6)
        assert squares.information(rest[others]) == pytest.approx(expected, rel=1e-6)
        assert squares.of_one()[rest[some]].sum() >= expected - 1e-9


def test_what_is_known_tells_nothing_and_neither_does_everything() -> None:
    squares = field()
    squares.condition(KNOWN)
    rest = np.setdiff1d(np.arange(30), KNOWN)
    assert squares.information(KNOWN) == 0.0
    assert squares.information(rest[:0]) == 0.0
    assert squares.information(rest) == pytest.approx(0.0, abs=1e-9)
    some = rest[:4]
    assert squares.information(np.concatenate([some, KNOWN])) == squares.information(some)
    assert (squares.of_one()[KNOWN] == 0.0).all()


def test_it_learns_the_share_of_what_was_seen_and_no_square_before_half_of_it_was() -> None:
    squares = field(AREA)
    explored = ~all_but(np.s_[:40, :40])
    explored[40:42, :40] = True
    explored[44:45, :40] = True
    target = np.zeros_like(explored)
    target[:4, :2] = True
    squares.learn(map_with(explored=explored, target=target))
    known = squares.known.reshape(squares.shape)
    assert known[:10, :10].all()
    assert known[10, :10].all()
    assert not known[11:].any()
    expected = squares.expected.reshape(squares.shape)
    assert expected[0, 0] == 0.5
    assert (expected[5:10, :10] == 0.0).all()
    beside, far = expected[5, 10], expected[20, 20]
    assert 0.0 <= abs(beside) < 0.05 < far == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize(
    ("area", "protocol"),
    [
        (Bounds(0.0, 0.0, 300.0, 40.0), DREAM_V1),
        (Bounds(-51.0, -51.0, 51.0, 51.0), DREAM_V1),
        (SMALL, POOL_V1),
    ],
)
def test_it_has_no_more_squares_than_it_may_and_covers_the_area(
    area: Bounds, protocol: SurveyProtocol
) -> None:
    squares = field(area, protocol)
    assert squares.shape[0] * squares.shape[1] <= MOST
    shares = squares.on_cells(np.ones(len(squares.known)))
    assert (shares == 1.0).all()
    assert squares.on_squares(shares).sum() == shares.size
