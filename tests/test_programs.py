"""A test that lacks a program is skipped, and fails where the machine is said to have all of them."""

from __future__ import annotations

import pytest

from tests.programs import VARIABLE, do_without


def test_a_test_that_lacks_a_program_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(pytest.skip.Exception, match="needs a browser"):
        do_without("needs a browser")


def test_where_no_program_should_lack_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "1")
    with pytest.raises(pytest.fail.Exception, match=r"DREAM_NO_SKIPS=1: expected .* needs a browser"):
        do_without("needs a browser")
