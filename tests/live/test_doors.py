from __future__ import annotations

import socket

import pytest

from dream.live.doors import Doors, is_loopback, made_token

TOKEN = "0123456789abcdef"


@pytest.mark.parametrize(
    "header",
    ["localhost", "localhost:8412", "LOCALHOST:1", "127.0.0.1:8412", "127.8.9.1", "[::1]:8412", "[::1]"],
)
def test_at_a_loopback_address_this_machine_is_answered(header: str) -> None:
    assert Doors().answers_to(header)


@pytest.mark.parametrize(
    "header",
    ["", "evil.example", "evil.example:8412", "localhost.evil.example", "127.0.0.1.evil.example:8412",
     "192.168.2.1:8412", "[fe80::1]:8412", "0.0.0.0", "localhost@evil.example", "1270.0.1"],
)  # fmt: skip
def test_another_name_that_leads_here_is_not_answered(header: str) -> None:
    assert not Doors().answers_to(header)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.2.1", "boat", "::"])
def test_where_others_can_connect_no_name_of_another_server_is_answered(host: str) -> None:
    doors = Doors(host, TOKEN)
    assert doors.answers_to("192.168.2.1:8412")
    assert doors.answers_to(f"{socket.gethostname()}:8412")
    assert doors.answers_to("boat:8412") == (host == "boat")
    assert not doors.answers_to("evil.example:8412")


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.2.1", "example.org", "::"])
def test_where_others_can_connect_a_token_is_demanded(host: str) -> None:
    assert not is_loopback(host)
    with pytest.raises(ValueError, match="expected one where others can connect"):
        Doors(host)


@pytest.mark.parametrize(
    "token", ["short", "x" * 15, "é" * 20, *(f"{'x' * 10}{mark}{'y' * 10}" for mark in ' \n\t;,"\\\x7f')]
)
def test_a_poor_token_is_refused_and_not_told(token: str) -> None:
    with pytest.raises(ValueError, match="16 plain characters") as refused:
        Doors("0.0.0.0", token)
    assert token not in str(refused.value)


def test_only_the_token_is_the_token() -> None:
    doors = Doors("0.0.0.0", TOKEN)
    assert doors.knows(TOKEN)
    assert not any(map(doors.knows, ("", TOKEN[:-1], TOKEN + "0", TOKEN.upper(), "é")))


def test_made_tokens_differ_and_are_long() -> None:
    tokens = {made_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32
