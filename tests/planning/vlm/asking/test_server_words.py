"""What a server says is read: a subject that it never takes, or a fault of the moment."""

from __future__ import annotations

import pytest

from dream.planning.vlm.asking.server_words import (
    ADDRESS,
    CONTEXT,
    FORMAT,
    MODEL,
    MOST_SAID,
    PICTURE,
    never,
    said,
)


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        ("image input is not supported", PICTURE),
        ("At most 0 image(s) may be provided", PICTURE),
        ("maximum context length is 8192 tokens", CONTEXT),
        ("response_format json_schema is not supported", FORMAT),
        ("failed to parse grammar", FORMAT),
        ("model 'x' not found, try pulling it first", MODEL),
        ("Unexpected endpoint or method", ADDRESS),
        # A subject alone says nothing, and so does what may pass.
        ("the image shows three", ""),
        ("image input is not supported at this time", ""),
        ("model 'x' not found while loading", ""),
        ("Something went wrong", ""),
        ("", ""),
    ],
)
def test_only_a_subject_that_is_said_to_fail_for_good_is_never_taken(words: str, kind: str) -> None:
    assert never(words) == kind


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ({"error": {"message": "no"}}, "no"),
        ({"error": "no"}, "no"),
        ({"message": "no"}, "no"),
        ({"detail": [{"msg": "no"}]}, "no"),
        ([{"error": {"message": "no"}}], "no"),
        ("no\n way ", "no way"),
        ("<html>no</html>", ""),
        ({"error": {"code": 3}}, ""),
        ([], ""),
        (None, ""),
        (4, ""),
    ],
)
def test_the_words_of_a_body_are_found_where_servers_put_them(body: object, words: str) -> None:
    assert said(body) == words


def test_no_more_is_said_than_may_be() -> None:
    assert len(said("x " * 4000)) == MOST_SAID
